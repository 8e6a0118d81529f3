"""Grasps of several objects, as one memory-mapped table: what was seen and felt, and how it ended.

``grasp_data`` writes a folder per object: an array per name of `ARRAYS`, of N rows each, and, last,
``record.json``, without which a folder is incomplete.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.benchmarks.datasets.arrays import map_array, read_rows
from objectfolder.benchmarks.datasets.splits import label_order
from objectfolder.errors import ObjectFolderError
from objectfolder.io import read_json

FORMAT = "objectfolder grasps 1"  #: of how grasps are drawn and stored; others are not mixed with these
RECORD = "record.json"
#: By name, the type of an array and the shape of a row, None where it is the writer's choice.
ARRAYS: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "success": ("bool", ()),  #: whether the object was held
    "soft": ("float32", ()),  #: share of slightly perturbed repetitions, itself included, that succeed
    "width": ("float32", ()),  #: opening of the closed jaws, m
    "offset": ("float32", (3,)),  #: middle of the contacts from the centre of mass; closing, lateral, up; m
    "force": ("float32", ()),  #: of the jaws, N
    "image": ("uint8", (None, None, 3)),  #: of the external camera
    "touch": ("uint8", (2, None, None, 3)),  #: left and right finger, from the Object File
    "explicit": ("uint8", (2, None, None, 3)),  #: of the same contacts, simulated on the source's surface
}
OPTIONAL = "explicit"  #: absent where there is no ground truth
NUMBERS = ("soft", "width", "offset", "force")
AGAIN = "collect its grasps again"


def array_path(folder: Path, name: str) -> Path:
    """Return where a folder holds one array."""
    return folder / f"{name}.npy"


class Grasps:
    """Grasps of several objects, read-only; pictures are not held in the memory.

    With N grasps per object, row r is grasp number ``r % N`` of object ``r // N``.

    Parameters
    ----------
    folders : mapping
        From keys to folders with ``record.json`` and the arrays of `ARRAYS`.

    Attributes
    ----------
    keys : tuple of str
        Objects in the order of labels; see `objectfolder.benchmarks.datasets.splits.label_order`.
    count : int
        Grasps per object, N.
    labels : (K N,) int64 array
        Object of each row, counted from 0.
    success : (K N,) bool array
        How each grasp ended.
    has_explicit : bool
        Whether touches were simulated from the ground truth, too.
    records : dict
        By key, what ``record.json`` says.

    Raises
    ------
    ObjectFolderError
        If a folder is incomplete or damaged, or objects differ in the number or shape of grasps.
    """

    def __init__(self, folders: Mapping[str, Path]):
        if not folders:
            raise ObjectFolderError("no objects were given, expected folders of grasps of two at least")
        self.keys = label_order(folders)
        paths = {key: Path(folders[key]) for key in self.keys}
        self.records: dict[str, dict[str, Any]] = {key: _record(key, path) for key, path in paths.items()}
        first = self.keys[0]
        self.count = int(self.records[first]["count"])
        self.labels = np.repeat(np.arange(len(self.keys), dtype=np.int64), self.count)
        self.has_explicit = array_path(paths[first], OPTIONAL).is_file()
        self._arrays: dict[str, list[np.ndarray]] = {}
        for name in ARRAYS:
            if name == OPTIONAL:
                _check_all_or_none({key: array_path(path, name).is_file() for key, path in paths.items()})
                if not self.has_explicit:
                    continue
            arrays = {key: _open(key, path, name, self.records[key]["count"]) for key, path in paths.items()}
            _check_alike(name, {key: array.shape for key, array in arrays.items()})
            self._arrays[name] = list(arrays.values())
        if self.has_explicit and self.shape("explicit") != self.shape("touch"):
            raise ObjectFolderError(
                f"{first}: explicit touches have shape {self.shape('explicit')}, expected that of touches, "
                f"{self.shape('touch')}; {AGAIN}"
            )
        self.success = np.concatenate(self._arrays["success"])

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def digest(self) -> str:
        """SHA-256 of all records, which hold digests of what is in the folders; hexadecimal."""
        records = [self.records[key] for key in self.keys]
        return hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of a row of an array."""
        return self._of(name)[0].shape[1:]

    def read(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Read some rows of an array.

        Parameters
        ----------
        name : str
            One of `ARRAYS`, which says what it is.
        rows : (B,) int array
            In any order, also twice.

        Returns
        -------
        (B, ...) array

        Raises
        ------
        ObjectFolderError
            If there is no such array.
        IndexError
            If there is no such row.
        """
        return read_rows(self._of(name), rows)

    def _of(self, name: str) -> list[np.ndarray]:
        if name not in self._arrays:
            raise ObjectFolderError(f"grasps have no {name!r}, expected one of {', '.join(self._arrays)}")
        return self._arrays[name]


def _record(key: str, folder: Path) -> dict[str, Any]:
    if not (folder / RECORD).is_file():
        raise ObjectFolderError(
            f"{key}: {folder} holds no complete grasps ({RECORD} is missing); collect them again"
        )
    record = read_json(folder / RECORD)
    known = record.get("format") if isinstance(record, dict) else None
    if known != FORMAT:
        raise ObjectFolderError(
            f"{key}: {folder / RECORD} is of format {known!r}, expected {FORMAT!r}; {AGAIN}"
        )
    if record.get("key") != key:
        raise ObjectFolderError(f"{folder} holds grasps of {record.get('key')}, expected those of {key}")
    lacking = [
        name
        for name, kind in (("count", int), ("digest", str))
        if not isinstance(record.get(name), kind) or not record[name]
    ]
    if lacking:
        raise ObjectFolderError(f"{key}: {folder / RECORD} tells no {' and no '.join(lacking)}; {AGAIN}")
    return record


def _open(key: str, folder: Path, name: str, count: int) -> np.ndarray:
    path, (dtype, row) = array_path(folder, name), ARRAYS[name]
    array = map_array(key, path, AGAIN)
    fits = len(array.shape) == 1 + len(row) and all(
        has == wanted or wanted is None for has, wanted in zip(array.shape, (count, *row))
    )
    if array.dtype != dtype or not fits:
        expected = ", ".join("any" if side is None else str(side) for side in (count, *row))
        raise ObjectFolderError(
            f"{key}: {path} holds {array.dtype} of shape {array.shape}, expected {dtype} of ({expected}); "
            f"{AGAIN}"
        )
    if name in NUMBERS and not np.isfinite(array).all():
        raise ObjectFolderError(f"{key}: {path} holds values that are not finite; {AGAIN}")
    return array


def _check_all_or_none(there: Mapping[str, bool]) -> None:
    without = [key for key, is_there in there.items() if not is_there]
    if without and len(without) < len(there):
        raise ObjectFolderError(
            f"{', '.join(without)}: no explicit touches ({array_path(Path(), OPTIONAL)}), which the other "
            "objects have; collect them for all objects or for none"
        )


def _check_alike(name: str, shapes: Mapping[str, tuple[int, ...]]) -> None:
    (first, expected), *others = shapes.items()
    for key, shape in others:
        if shape != expected:
            raise ObjectFolderError(
                f"{key}: its {name} has shape {shape}, that of {first} {expected}; expected the same of all "
                "objects: collect grasps alike"
            )
