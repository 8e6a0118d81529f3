"""A released dataset: a folder of Object Files with an index."""

import csv
import math
import operator
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError, quoted, shortened
from objectfolder.io import file_digest
from objectfolder.objectfile.file import Device, ObjectFile

INDEX = "objects.csv"  #: in a release's folder
OBJECTS = "objects"  #: folder of the Object Files


@dataclass(frozen=True, kw_only=True)
class IndexEntry:
    """What the index says of one object; a column per field. Unknown figures are None."""

    key: str
    path: str  #: of the Object File, from the release's folder
    category: str  #: such as kitchen or tools; empty if unknown
    material: str
    size: float  #: longest side, metres
    split: str  #: train, val or test, of benchmarks on unseen objects
    modes: int
    lowest_hz: float | None
    vision_psnr: float | None  #: dB, on held-out views
    gain_error: float | None  #: relative, on held-out points
    touch_psnr: float | None  #: dB, on held-out contacts
    bytes: int
    sha256: str
    licence: str  #: of the mesh that the object was made from, and so of the Object File
    source: str  #: of the mesh


#: Type of each column of the index, in order: str, int or float.
COLUMNS: dict[str, type] = {
    field.name: (get_args(field.type) or (field.type,))[0] for field in fields(IndexEntry)
}
#: Columns that may be empty, since the figure may be unknown.
_OPTIONAL = frozenset(field.name for field in fields(IndexEntry) if NoneType in get_args(field.type))


class Dataset(Sequence[ObjectFile]):
    """Object Files of a release, which ``objectfolder release`` writes; each is read when it is asked for.

    A map-style dataset of torch, that processes of a ``DataLoader`` share without copying files. Items are
    Object Files, which do not stack: give ``batch_size=None`` or a ``collate_fn`` that queries them. Nothing
    is kept: keep an Object File yourself while you query it.

    Parameters
    ----------
    folder : path
        Of the release.
    device : str or torch.device, optional
        Where nets are evaluated.

    Attributes
    ----------
    entries : tuple of IndexEntry
        What the index says, in its order.

    Raises
    ------
    ObjectFolderError
        If the folder is not a release, or its index is damaged.

    Examples
    --------
    >>> dataset = Dataset("release")
    >>> steel = dataset.filter(material="steel", split="train")
    >>> bell = dataset["bell"]
    >>> small = dataset[[entry.size < 0.1 for entry in dataset.entries]]
    """

    def __init__(self, folder: str | Path, device: Device = "cpu"):
        self.folder, self.device = Path(folder), device
        self.entries = self._released = read_index(self.folder / INDEX)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the objects."""
        return tuple(entry.key for entry in self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, which: Any) -> Any:
        """Read an object by number or key; return a dataset of a slice, a list or array of these, or a mask.

        Raises
        ------
        IndexError
            If there is no object of a number, or a mask is of another length.
        TypeError
            If it is none of these.
        ObjectFolderError
            If there is no object of a key, or its file is missing or damaged.
        """
        if isinstance(which, slice):
            return self._with(self.entries[which])
        if isinstance(which, np.ndarray | torch.Tensor):
            which = which.tolist()
        if isinstance(which, list):
            return self._with(self._several(which))
        path = self.path(which)
        if not path.is_file():
            raise ObjectFolderError(f"{path} is missing, though the index names it; download it again")
        return ObjectFile.load(path, self.device)

    def __iter__(self) -> Iterator[ObjectFile]:
        return (self[number] for number in range(len(self)))

    def __contains__(self, item: object) -> bool:
        return _key(item) in self.keys

    def index(self, value: ObjectFile | str, start: int = 0, stop: int | None = None) -> int:
        """Return the number of an object, given by itself or its key; no file is read.

        Raises
        ------
        ObjectFolderError
            A ValueError, if it is not in the dataset, or not from ``start`` to ``stop``.
        """
        key = _key(value)
        try:
            return self.keys.index(key, start, sys.maxsize if stop is None else stop)
        except ValueError:
            raise self._unknown(key) from None

    def count(self, value: ObjectFile | str) -> int:
        """Return how often the dataset holds an object, given by itself or its key; no file is read."""
        return self.keys.count(_key(value))

    def __repr__(self) -> str:
        return f"Dataset({str(self.folder)!r}): {len(self)} objects"

    def entry(self, which: int | str) -> IndexEntry:
        """Return what the index says of an object, by number or key."""
        if isinstance(which, str):
            found = [entry for entry in self.entries if entry.key == which]
            if not found:
                raise self._unknown(which)
            return found[0]
        try:
            number = operator.index(which)
        except TypeError:
            raise TypeError(
                f"{self.folder}: a dataset is not indexed by {quoted(which)}; expected a number, a key, a "
                "slice, or a list or array of numbers, keys or truth values"
            ) from None
        if not -len(self) <= number < len(self):
            raise IndexError(f"{self.folder}: no object {number}; the dataset has {len(self)}, from 0 on")
        return self.entries[number]

    def path(self, which: int | str) -> Path:
        """Return the path of an Object File, by number or key."""
        return self.folder / self.entry(which).path

    def filter(
        self,
        category: str | Collection[str] | None = None,
        material: str | Collection[str] | None = None,
        split: str | Collection[str] | None = None,
    ) -> "Dataset":
        """Return the objects of some categories, materials and splits; None: of all.

        Raises
        ------
        ObjectFolderError
            If no object of the release has one of the values: it is probably misspelt.

        Notes
        -----
        A mask chooses by anything else: ``dataset[[entry.size < 0.1 for entry in dataset.entries]]``.
        """
        kept = self.entries
        for name, values in (("category", category), ("material", material), ("split", split)):
            if values is None:
                continue
            listed = values if isinstance(values, Collection) and not isinstance(values, str) else [values]
            if not all(isinstance(value, str) for value in listed):
                raise ObjectFolderError(
                    f"{name} is {quoted(values)}, expected a text or several; by anything else choose with a "
                    "mask, such as dataset[[entry.size < 0.1 for entry in dataset.entries]]"
                )
            wanted = set(listed)
            known = {getattr(entry, name) for entry in self._released}
            if unknown := sorted(wanted - known):
                raise ObjectFolderError(
                    f"{self.folder}: no object of {name} {quoted(unknown[0])}, expected one of "
                    f"{', '.join(sorted(filter(None, known)))}"
                )
            kept = tuple(entry for entry in kept if getattr(entry, name) in wanted)
        return self._with(kept)

    def verify(self) -> None:
        """Compare every Object File with its digest in the index.

        Raises
        ------
        ObjectFolderError
            If one is missing or differs; the message names all of them.
        """
        wrong = [
            entry.key
            for entry in self.entries
            if not (path := self.folder / entry.path).is_file() or file_digest(path) != entry.sha256
        ]
        if wrong:
            raise ObjectFolderError(
                f"{self.folder}: missing, or not as released: {', '.join(wrong)}; download them again"
            )

    def _several(self, which: list[Any]) -> tuple[IndexEntry, ...]:
        if which and all(isinstance(held, bool | np.bool_) for held in which):
            if len(which) != len(self):
                raise IndexError(
                    f"{self.folder}: a mask of {len(which)} objects; the dataset has {len(self)}"
                )
            return tuple(entry for entry, held in zip(self.entries, which) if held)
        return tuple(self.entry(each) for each in which)

    def _unknown(self, key: object) -> ObjectFolderError:
        held = shortened(", ".join(self.keys), 200)
        return ObjectFolderError(f"{self.folder}: no object {quoted(key)}; it has {held}")

    def _with(self, entries: tuple[IndexEntry, ...]) -> "Dataset":
        part = object.__new__(type(self))
        part.folder, part.device, part.entries, part._released = (
            self.folder,
            self.device,
            entries,
            self._released,
        )
        return part


def _key(item: object) -> Any:
    """Return the key of an Object File; anything else as it is."""
    return item.key if isinstance(item, ObjectFile) else item


def read_index(path: Path) -> tuple[IndexEntry, ...]:
    """Read the index of a release.

    Raises
    ------
    ObjectFolderError
        If it is missing or damaged, or names a file outside the release.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.DictReader(stream, strict=True))
    except OSError as error:
        raise ObjectFolderError(
            f"{path.parent} is not a release: cannot read {path}: {error.strerror}; "
            "`objectfolder release DIR` writes one"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ObjectFolderError(f"{path} is damaged: {error}") from error
    entries = tuple(_entry(row, f"{path}, object {number}") for number, row in enumerate(rows, 1))
    keys = [entry.key for entry in entries]
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ObjectFolderError(f"{path} is damaged: {twice} is listed twice")
    return entries


def _entry(row: dict[str, Any], place: str) -> IndexEntry:
    # Columns of newer versions are left alone.
    if missing := [name for name in COLUMNS if row.get(name) is None]:
        raise ObjectFolderError(f"{place}: lacks {', '.join(missing)}")
    values = {name: _value(row[name], name, kind, place) for name, kind in COLUMNS.items()}
    path = Path(values["path"])
    if path.is_absolute() or ".." in path.parts:
        raise ObjectFolderError(f"{place}: path is {quoted(values['path'])}, expected one in the release")
    return IndexEntry(**values)


def _value(text: str, name: str, kind: type, place: str) -> Any:
    if kind is str:
        return text
    if not text and name in _OPTIONAL:
        return None
    try:
        number = kind(text)
        finite = math.isfinite(number)
    except (ValueError, OverflowError):
        finite = False
    if not finite:
        raise ObjectFolderError(f"{place}: {name} is {quoted(text)}, expected a number")
    return number
