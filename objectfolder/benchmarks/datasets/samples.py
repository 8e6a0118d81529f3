"""Memory-mapped arrays of several objects, read as one table."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile


class Samples:
    """Arrays of several objects with equally many rows each, read-only and memory-mapped.

    With N rows per object, row r is sample ``r % N`` of object ``r // N``.

    Parameters
    ----------
    records : mapping
        Contents of each object's record file by key, in label order.
    arrays : mapping
        By name, the array (N, ...) of each object in the same order.

    Attributes
    ----------
    keys : tuple of str
        Objects in label order; see `objectfolder.benchmarks.datasets.splits.label_order`.
    count : int
        Samples per object, N.
    labels : (K N,) int64 array
        Object index of each row.
    records : dict
        Contents of the record files by key.
    """

    def __init__(self, records: Mapping[str, dict[str, Any]], arrays: Mapping[str, Sequence[np.ndarray]]):
        self.keys = tuple(records)
        self.records = dict(records)
        self.count = int(records[self.keys[0]]["count"])
        self.labels = np.repeat(np.arange(len(self.keys), dtype=np.int64), self.count)
        self._arrays = arrays

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def digest(self) -> str:
        """SHA-256 of all records, which identify the arrays; hexadecimal."""
        records = [self.records[key] for key in self.keys]
        return hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of one row of an array."""
        return self._of(name)[0].shape[1:]

    def read(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Read rows of an array.

        Parameters
        ----------
        rows : (B,) int array
            In any order; repetitions are allowed.

        Returns
        -------
        (B, ...) array

        Raises
        ------
        ObjectFolderError
            If there is no such array.
        IndexError
            If a row is out of range.
        """
        return gather_rows(self._of(name), rows)

    def _of(self, name: str) -> Sequence[np.ndarray]:
        if name not in self._arrays:
            raise ObjectFolderError(f"no array {name!r}, expected one of {', '.join(self._arrays)}")
        return self._arrays[name]


def object_digest(file: "ObjectFile") -> str:
    """Return the SHA-256 of an Object File's header and tensors; hexadecimal."""
    digest = hashlib.sha256(json.dumps(file.header, sort_keys=True).encode())
    for name in sorted(file.tensors):
        tensor = np.ascontiguousarray(file.tensors[name])
        digest.update(f"{name} {tensor.dtype.str} {tensor.shape}".encode() + tensor.tobytes())
    return digest.hexdigest()


def array_path(folder: Path, name: str) -> Path:
    """Return the path of an array in an object's folder."""
    return folder / f"{name}.npy"


def map_array(key: str, path: Path, remedy: str) -> np.ndarray:
    """Memory-map an object's ``.npy`` file, read-only; nothing is unpickled.

    Raises ObjectFolderError if the file is missing, damaged, or not a numeric array.

    Parameters
    ----------
    key : str
        Object, named in errors.
    remedy : str
        What to do about a damaged file; ends the error message.
    """
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ObjectFolderError(f"{key}: {path} is damaged ({error}); {remedy}") from error


def are_written(folder: Path, names: Iterable[str], count: int) -> bool:
    """Return whether an object's folder holds these arrays, whole, with so many rows each."""
    try:
        return all(len(map_array(folder.name, array_path(folder, name), "")) == count for name in names)
    except ObjectFolderError:
        return False


def averaged_images(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average images (N, H, W, 3) uint8 to a smaller size, (N, h, w, 3) uint8."""
    import torch  # here, because the declarations of tasks, which commands read, need no torch
    from torch.nn.functional import adaptive_avg_pool2d

    channels = torch.from_numpy(images).permute(0, 3, 1, 2).float()
    return adaptive_avg_pool2d(channels, size).round().byte().permute(0, 2, 3, 1).numpy()


def check_equal_shapes(name: str, shapes: Mapping[str, Any], remedy: str) -> None:
    """Raise ObjectFolderError unless all objects have arrays of the same shape.

    Parameters
    ----------
    name : str
        Array, named in the error.
    shapes : mapping
        Shape by object key.
    remedy : str
        Ends the error message.
    """
    (first, expected), *others = shapes.items()
    for key, shape in others:
        if shape != expected:
            raise ObjectFolderError(
                f"{key}: {name} has shape {shape}, that of {first} {expected}; expected the same: {remedy}"
            )


def gather_rows(arrays: Sequence[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Gather rows of arrays of equal shape (N, ...); row r is row ``r % N`` of array ``r // N``.

    Raises IndexError if a row is out of range.

    Parameters
    ----------
    rows : (B,) int array
        In any order; repetitions are allowed.

    Returns
    -------
    (B, ...) array
    """
    rows, count = np.asarray(rows, np.int64), len(arrays[0])
    wrong = rows[(rows < 0) | (rows >= len(arrays) * count)]
    if len(wrong):
        raise IndexError(f"row {wrong[0]} of {len(arrays) * count}")
    objects, within = np.divmod(rows, count)
    out = np.empty((len(rows), *arrays[0].shape[1:]), arrays[0].dtype)
    for i in np.unique(objects):
        chosen = objects == i
        out[chosen] = arrays[i][within[chosen]]
    return out
