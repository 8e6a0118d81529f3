"""Memory-mapped arrays of several objects, read as one table."""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile


class Samples:
    """Arrays of several objects with equally many rows each, read-only and memory-mapped.

    With N rows per object, row r is sample ``r % N`` of object ``r // N``. Raises ObjectFolderError, with a
    remedy, if objects have arrays of different shapes.

    Parameters
    ----------
    records : mapping
        Contents of each object's record file by key, in label order
        (`objectfolder.benchmarks.datasets.splits.label_order`).
    arrays : mapping
        By name, the array (N, ...) of each object in the same order.
    """

    def __init__(
        self,
        records: Mapping[str, dict[str, Any]],
        arrays: Mapping[str, Sequence[np.ndarray]],
        remedy: str = "sample all objects with the same settings",
    ):
        self.keys, self.records = tuple(records), dict(records)
        #: objects left out, since a task uses sound and theirs is marked uncertain
        self.uncertain: tuple[str, ...] = ()
        self.count = int(records[self.keys[0]]["count"])  #: samples per object, N
        #: (K N,) int64, object index of each row.
        self.labels = np.repeat(np.arange(len(self.keys), dtype=np.int64), self.count)
        self._arrays = arrays
        for name, (first, *others) in arrays.items():
            for key, array in zip(self.keys[1:], others):
                if array.shape != first.shape:
                    raise ObjectFolderError(
                        f"{key}: {name} has shape {array.shape}, that of {self.keys[0]} {first.shape}; "
                        f"expected the same: {remedy}"
                    )

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
        """Read rows (B,) of an array, in any order and with repetitions; (B, ...).

        Raises ObjectFolderError if there is no such array, IndexError if a row is out of range.
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


def has_uncertain_sound(file: "ObjectFile") -> bool:
    """Return whether the sound of an Object File is marked uncertain: benchmarks leave it out."""
    return bool(file.header.get("audio", {}).get("uncertain"))


def require_parts(file: "ObjectFile", parts: Collection[str], use: str) -> None:
    """Raise ObjectFolderError unless an Object File holds all parts that ``use``, a plural, needs."""
    if lacking := [part for part in parts if part not in file.header]:
        *most, last = parts
        raise ObjectFolderError(
            f"{file.key}: the Object File holds no {' and no '.join(lacking)}; {use} need {', '.join(most)} "
            f"and {last}: leave the object out, or rebuild it"
        )


def array_path(folder: Path, name: str) -> Path:
    """Return the path of an array in an object's folder."""
    return folder / f"{name}.npy"


def map_array(key: str, path: Path, remedy: str) -> np.ndarray:
    """Memory-map an object's ``.npy`` file, read-only; nothing is unpickled.

    Raises ObjectFolderError if the file is missing, damaged, or not a numeric array; the message names the
    object and ends with the remedy.
    """
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ObjectFolderError(f"{key}: {path} is damaged ({error}); {remedy}") from error


def read_sample_record(
    key: str, path: Path, what: str, field: str, known: int | str, remedy: str
) -> dict[str, Any]:
    """Read the record that marks an object's folder of samples, such as ``what``, as complete.

    Raises ObjectFolderError if it is missing, its ``field`` is not the known format, or it is of another key.
    """
    if not path.is_file():
        raise ObjectFolderError(
            f"{key}: {path.parent} holds no complete {what} ({path.name} is missing); {remedy}"
        )
    record = read_json(path)
    found = record.get(field) if isinstance(record, dict) else None
    if found != known:
        raise ObjectFolderError(f"{key}: {path} has {field} {found!r}, expected {known!r}; {remedy}")
    if record.get("key") != key:
        raise ObjectFolderError(f"{path.parent} holds {what} of {record.get('key')}, expected those of {key}")
    return dict(record)


def read_stored(path: Path) -> dict[str, Any]:
    """Return the contents of a record; nothing if it is missing or damaged, so that it is written again."""
    try:
        value = read_json(path)
    except ObjectFolderError:
        return {}
    return value if isinstance(value, dict) else {}


def is_complete(record: Path, request: dict[str, Any], names: Iterable[str]) -> bool:
    """Return whether a record is of a request, and whole arrays with ``count`` rows lie beside it."""
    stored, folder = read_stored(record), record.parent
    if stored | request != stored:
        return False
    try:
        return all(len(map_array("", array_path(folder, name), "")) == request["count"] for name in names)
    except ObjectFolderError:
        return False


def averaged_images(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average images (N, H, W, 3) uint8 to a smaller size, (N, h, w, 3) uint8."""
    import torch  # here, because the declarations of tasks, which commands read, need no torch
    from torch.nn.functional import adaptive_avg_pool2d

    channels = torch.from_numpy(images).permute(0, 3, 1, 2).float()
    return adaptive_avg_pool2d(channels, size).round().byte().permute(0, 2, 3, 1).numpy()


def gather_rows(arrays: Sequence[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Gather rows (B,) of arrays of equal shape (N, ...); row r is row ``r % N`` of array ``r // N``.

    Raises IndexError if a row is out of range.
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
