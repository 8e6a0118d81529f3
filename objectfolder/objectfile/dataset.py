"""A released dataset: a folder of Object Files with an index."""

import csv
import operator
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path, PurePosixPath
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import torch

from objectfolder.base.arrays import MAX_BYTES
from objectfolder.base.checks import is_web_address
from objectfolder.base.errors import ObjectFolderError, plural, quoted, shortened
from objectfolder.base.io import content_hint, file_digest
from objectfolder.base.text import from_csv, visible
from objectfolder.objectfile.file import Device, ObjectFile
from objectfolder.stored.header import NAMES, checked_name

if TYPE_CHECKING:
    from objectfolder.objectfile.online import HubRelease, WebRelease

INDEX = "objects.csv"  #: in a release's folder
OBJECTS = "objects"  #: folder of the Object Files


@dataclass(frozen=True, kw_only=True)
class IndexEntry:
    """What the index says of one object; a column per field. Unknown figures are None.

    Fields with a default are columns that older releases lack.
    """

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
    licence_url: str = ""  #: empty if unknown
    title: str = ""  #: of the mesh at its source
    attribution: str = ""  #: whom to name
    changes: str = ""  #: what was changed of the published mesh
    uncertain: int = 0  #: 1 if the sound is marked uncertain


#: Type of each column of the index, in order: str, int or float.
COLUMNS: dict[str, type] = {
    field.name: (get_args(field.type) or (field.type,))[0] for field in fields(IndexEntry)
}
_LATER = frozenset(field.name for field in fields(IndexEntry) if field.default is not MISSING)
_WHOLE = re.compile("[0-9]{1,19}")
_NUMBER = re.compile(r"-?[0-9]{1,30}(\.[0-9]{0,30})?([eE][-+]?[0-9]{1,3})?")
#: Least and greatest value of the columns of numbers.
_RANGES = {
    **{"size": (1e-12, 1e6), "modes": (0, 10**6), "lowest_hz": (1e-6, 1e9), "bytes": (1, MAX_BYTES)},
    **{"vision_psnr": (-1000.0, 1000.0), "gain_error": (0.0, 1e9), "touch_psnr": (-1000.0, 1000.0)},
    "uncertain": (0, 1),
}
MAX_TEXT, MAX_CATEGORY = 1000, 100  #: characters
_MAX_NAME = 255  # bytes of a file's name
_IN_RELEASE = f"one in the release, of at most {MAX_TEXT} characters and names of at most {_MAX_NAME} bytes"
#: Test and description of the columns of texts that are no names of a header.
_TEXTS: dict[str, tuple[Callable[[str], object], str]] = {
    "path": (lambda text: len(text) <= MAX_TEXT and _is_inside(PurePosixPath(text)), _IN_RELEASE),
    "category": (lambda text: len(text) <= MAX_CATEGORY, f"a text of at most {MAX_CATEGORY} characters"),
    "split": (("train", "val", "test").__contains__, "train, val or test"),
    "sha256": (re.compile("[0-9a-f]{64}").fullmatch, "64 hexadecimal digits"),
    "licence": (lambda text: 0 < len(text) <= MAX_TEXT, f"a text of 1 to {MAX_TEXT} characters"),
    **dict.fromkeys(
        ("source", "title", "attribution"),
        (lambda text: len(text) <= MAX_TEXT, f"a text of at most {MAX_TEXT} characters"),
    ),
    "licence_url": (lambda text: not text or is_web_address(text), "an address such as https://example.org"),
    "changes": (lambda text: len(text) <= 2 * MAX_TEXT, f"a text of at most {2 * MAX_TEXT} characters"),
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
    folder : path or str
        Of the release; or its address: ``hf://OWNER/NAME``, ``hf://OWNER/NAME@REVISION`` or
        ``https://HOST/PATH``, whose files are kept in a cache.
    device : str or torch.device, optional
        Where nets are evaluated.

    Attributes
    ----------
    entries : tuple of IndexEntry
        What the index says, in its order.

    Raises
    ------
    ObjectFolderError
        If the folder or address is not a release, or its index is damaged or cannot be downloaded.

    Examples
    --------
    >>> dataset = Dataset("release")
    >>> steel = dataset.filter(material="steel", split="train")
    >>> bell = dataset["bell"]
    >>> small = dataset[[entry.size < 0.1 for entry in dataset.entries]]
    """

    def __init__(self, folder: str | Path, device: Device = "cpu"):
        self._published: WebRelease | HubRelease | None = None
        if isinstance(folder, str) and "://" in folder:
            from objectfolder.objectfile.online import open_published

            self._published = open_published(folder, INDEX)
        self.folder, self.device = Path(self._published.folder if self._published else folder), device
        try:
            self.entries = self._released = read_index(self.folder / INDEX)
        except ObjectFolderError as error:
            if self._published is None:
                raise
            looks = content_hint(self.folder / INDEX)
            raise ObjectFolderError(f"{folder} is not a release{looks}: {error}") from error
        self._numbers = self._rows = _numbers(self.entries)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the objects."""
        return tuple(entry.key for entry in self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, which: Any) -> Any:
        """Read an object by number or key; return a dataset of a slice, a list or array of these, or a mask.

        Raises IndexError if there is no object of a number, or a mask is of another length; TypeError if it
        is none of these; and ObjectFolderError if there is no object of a key, or its file is missing or
        cannot be downloaded, damaged, or of another object or material than the index says.
        """
        if isinstance(which, slice):
            return self._with(self.entries[which])
        if isinstance(which, np.ndarray | torch.Tensor):
            which = which.tolist()
        if isinstance(which, list):
            return self._with(self._several(which))
        entry = self.entry(which)
        path = self._file(entry)
        if not path.is_file():
            raise ObjectFolderError(f"{path} is missing, though the index names it; download it again")
        place = f"{self.folder / INDEX}, object {self._rows[entry.key] + 1}"
        _Inside(self.folder).check(entry.path, f"{place}: path")
        file = ObjectFile.load(path, self.device)
        for name in NAMES:
            said, found = getattr(entry, name), getattr(file, name)
            if said != found:
                raise ObjectFolderError(
                    f"{place}: {name} is {said!r}, expected {found!r} as in {path}; download it again"
                )
        return file

    def __iter__(self) -> Iterator[ObjectFile]:
        return (self[number] for number in range(len(self)))

    def __contains__(self, item: object) -> bool:
        key = _key(item)
        return isinstance(key, str) and key in self._numbers

    def index(self, value: ObjectFile | str, start: int = 0, stop: int | None = None) -> int:
        """Return the number of an object, given by itself or its key; no file is read.

        Raises ObjectFolderError, a ValueError, if it is not in the dataset from ``start`` to ``stop``.
        """
        key = _key(value)
        if value in self and start == 0 and stop is None:
            return self._numbers[key]
        try:
            return self.keys.index(key, start, sys.maxsize if stop is None else stop)
        except ValueError:
            raise self._unknown(key) from None

    def count(self, value: ObjectFile | str) -> int:
        """Return how often the dataset holds an object, given by itself or its key; no file is read."""
        return self.keys.count(_key(value))

    def __repr__(self) -> str:
        place = self._published.address if self._published else str(self.folder)
        return f"Dataset({place!r}): {plural(len(self), 'object')}"

    def entry(self, which: int | str) -> IndexEntry:
        """Return what the index says of an object, by number or key."""
        if isinstance(which, str):
            if which not in self._numbers:
                raise self._unknown(which)
            return self.entries[self._numbers[which]]
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
        """Return the path of an Object File, by number or key; that of an address is downloaded."""
        return self._file(self.entry(which))

    def filter(
        self,
        category: str | Collection[str] | None = None,
        material: str | Collection[str] | None = None,
        split: str | Collection[str] | None = None,
    ) -> "Dataset":
        """Return the objects of some categories, materials and splits; None: of all.

        A mask chooses by anything else: ``dataset[[entry.size < 0.1 for entry in dataset.entries]]``. Raises
        ObjectFolderError if no object of the release has one of the values: it is probably misspelt.
        """
        kept = self.entries
        for name, values in (("category", category), ("material", material), ("split", split)):
            if values is None:
                continue
            listed = values if isinstance(values, Collection) and not isinstance(values, str) else [values]
            if not all(isinstance(value, str) for value in listed):
                raise ObjectFolderError(
                    f"{name} is {quoted(values)}, expected a text or several; for other fields use a "
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
        """Compare every Object File with its digest in the index; those of an address are downloaded.

        Raises ObjectFolderError if one is missing or differs; the message names all of them.
        """
        wrong = [
            entry.key
            for entry in self.entries
            if not (path := self._file(entry)).is_file() or file_digest(path) != entry.sha256
        ]
        if wrong:
            raise ObjectFolderError(
                f"{self.folder}: missing or changed since release: {', '.join(wrong)}; download them again"
            )

    def _file(self, entry: IndexEntry) -> Path:
        """Return the path of an Object File; that of an address is there, with the digest of the index."""
        if self._published is not None:
            self._published.fetch(entry.path, entry.bytes, entry.sha256)
        return self.folder / entry.path

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
        part.folder, part.device, part._published = self.folder, self.device, self._published
        part._released, part._rows = self._released, self._rows
        part.entries, part._numbers = entries, _numbers(entries)
        return part


def _numbers(entries: Sequence[IndexEntry]) -> dict[str, int]:
    """Return where each key is first."""
    return {entry.key: number for number, entry in reversed([*enumerate(entries)])}


def _key(item: object) -> Any:
    """Return the key of an Object File; anything else as it is."""
    return item.key if isinstance(item, ObjectFile) else item


def read_index(path: Path) -> tuple[IndexEntry, ...]:
    """Read the index of a release.

    Raises ObjectFolderError if it is missing, damaged or empty, or a row breaks a rule of its columns, has
    the key of another, or names a file outside the release; the message names the row.
    """
    inside = _Inside(path.parent)
    inside.check(path.name, "the index")
    entries: list[IndexEntry] = []
    rows_by_key: dict[str, int] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream, strict=True)
            _check_columns(reader.fieldnames or (), path)
            for number, row in enumerate(reader, 1):
                place = f"{path}, object {number}"
                entry = _entry(row, place)
                first = rows_by_key.setdefault(entry.key, number)
                if first != number:
                    raise ObjectFolderError(
                        f"{place}: key is {entry.key!r}, expected another than that of object {first}"
                    )
                inside.check(entry.path, f"{place}: path")
                entries.append(entry)
    except OSError as error:
        raise ObjectFolderError(
            f"{path.parent} is not a release: cannot read {path}: {error.strerror}; "
            "`objectfolder release DIR` writes one"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ObjectFolderError(f"{path}, after object {len(entries)}, is damaged: {error}") from error
    if not entries:
        raise ObjectFolderError(f"{path} holds no objects, expected at least one; download it again")
    return tuple(entries)


def _check_columns(names: Sequence[str], path: Path) -> None:
    """Columns of newer versions are left alone, and older ones lack some."""
    if missing := [name for name in COLUMNS if name not in names and name not in _LATER]:
        raise ObjectFolderError(f"{path} lacks {', '.join(missing)}, expected columns of these names")
    if twice := [name for name in COLUMNS if names.count(name) > 1]:
        raise ObjectFolderError(f"{path} has the column {twice[0]} twice, expected it once")


def _entry(row: dict[str, Any], place: str) -> IndexEntry:
    columns = {name: kind for name, kind in COLUMNS.items() if name in row}
    if missing := [name for name in columns if row[name] is None]:
        raise ObjectFolderError(f"{place}: lacks {', '.join(missing)}")
    if more := row.get(None):  # type: ignore[call-overload]
        raise ObjectFolderError(f"{place}: {quoted(more)} is beyond the last column, expected nothing there")
    return IndexEntry(**{name: _value(row[name], name, kind, place) for name, kind in columns.items()})


def _value(cell: str, name: str, kind: type, place: str) -> Any:
    if kind is str:
        text = from_csv(cell)
        if name in NAMES:
            return checked_name(name, text, f"{place}: {name}")
        holds, expected = _TEXTS[name]
        if visible(text) != text:
            expected += ", without control characters"
        elif holds(text):
            return text
        raise ObjectFolderError(f"{place}: {name} is {quoted(text)}, expected {expected}")
    if not cell and name in _OPTIONAL:
        return None
    least, most = _RANGES[name]
    if (_WHOLE if kind is int else _NUMBER).fullmatch(cell) and least <= (number := kind(cell)) <= most:
        return number
    expected = f"a {'whole number' if kind is int else 'number'} from {least:g} to {most:g}"
    raise ObjectFolderError(f"{place}: {name} is {quoted(cell)}, expected {expected}")


def _is_inside(path: PurePosixPath) -> bool:
    names = path.parts
    short = all(len(name.encode(errors="surrogatepass")) <= _MAX_NAME for name in names)
    return short and bool(names) and not path.is_absolute() and ".." not in names


class _Inside:
    """Refuses files that a link takes out of a release."""

    def __init__(self, folder: Path):
        self.folder, self.root = folder, _real(folder)
        # A snapshot in the cache of the Hugging Face Hub consists of links into a folder of its repository.
        in_hub = self.root.parent.name == "snapshots"
        self.blobs = self.root.parents[1] / "blobs" if in_hub else None
        self._folders: dict[Path, Path] = {}  # resolved once each

    def check(self, name: str, place: str) -> None:
        """Check the file of a name; ``place`` begins the message."""
        path = self.folder / name
        if path.parent not in self._folders:
            self._folders[path.parent] = _real(path.parent)
        target = _real(path) if path.is_symlink() else self._folders[path.parent] / path.name
        if not target.is_relative_to(self.root) and target.parent != self.blobs:
            raise ObjectFolderError(
                f"{place} {quoted(name)} leads to {target}, expected a file in the release; download it again"
            )


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError for links in a circle
