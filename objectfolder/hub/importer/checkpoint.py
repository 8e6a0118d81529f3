"""Safe reader of released files: loads and validates pickled dictionaries without executing pickled code."""

import math
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from objectfolder.base.arrays import torch_problem
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import content_hint, existing_file

_KINDS = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
_ORDERS = ("<", ">", "=", "|")
MAX_BYTES = 4 << 30  #: of a file; one with a grid of small networks has a few hundred million
MAX_PICKLE = 256 << 20  #: bytes of the pickle in a zip archive, with the NumPy arrays, but not the tensors
MAX_ENTRIES = 100_000
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


class StoredDtype:
    """Numeric type as pickled: a type code, then a state, of which only the byte order is used."""

    def __init__(self, code: Any, align: Any = False, copy: Any = True):
        code = _text(code)
        if code not in _KINDS:
            raise ValueError(f"an array of NumPy type {code!r}; expected numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        order = _text(state[1])
        if order not in _ORDERS or any(part is not None for part in state[2:5]):
            raise ValueError(f"a NumPy type with state {state!r}; expected plain numbers")
        self.dtype = self.dtype.newbyteorder("=" if order == "|" else order)


class StoredArray:
    """Array as pickled: constructed empty, then filled from its state."""

    def __init__(self) -> None:
        self.value: np.ndarray = np.empty(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, stored, columns_first, data = state
        if not isinstance(stored, StoredDtype) or not isinstance(data, bytes | bytearray):
            raise ValueError("an array that is not numeric")
        shape = tuple(shape)
        if not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError(f"an array of shape {shape!r}")
        if math.prod(shape) * stored.dtype.itemsize != len(data):
            raise ValueError(f"an array of shape {shape} in {len(data)} bytes")
        flat = np.frombuffer(bytes(data), stored.dtype)
        self.value = flat.reshape(shape, order="F" if columns_first else "C")


def _reconstruct(kind: Any, shape: Any, code: Any) -> StoredArray:
    return StoredArray()


def _scalar(stored: Any, data: Any) -> int | float | bool:
    if not isinstance(stored, StoredDtype) or not isinstance(data, bytes):
        raise ValueError("a NumPy scalar that is not a number")
    return np.frombuffer(data, stored.dtype, 1)[0].item()


def _text(value: Any) -> str:
    return value.decode("latin1") if isinstance(value, bytes) else str(value)


#: Names allowed in a released file in addition to torch's: those of NumPy before and since version 2.
STAND_INS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    (StoredArray, "numpy.ndarray"),
    (StoredDtype, "numpy.dtype"),
    *((_reconstruct, f"numpy.{core}.multiarray._reconstruct") for core in ("core", "_core")),
    *((_scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")),
]


class ReleasedDict:
    """Dictionary of a released file, with methods that return validated entries, or raise ObjectFolderError.

    ``path``: of the file, for messages; ``name``: keys that lead to the dictionary, joined by dots; empty for
    the outermost one.
    """

    def __init__(self, path: str | Path, name: str, values: Mapping[Any, Any]):
        self.path = path
        self.name = name
        self.values = values

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def part(self, key: str) -> "ReleasedDict":
        """Return a nested dictionary."""
        value = self._get(key, "a dictionary")
        if not isinstance(value, Mapping):
            raise self.wrong(key, _describe(value), "a dictionary")
        return ReleasedDict(self.path, self._full(key), value)

    def state(self, key: str) -> "ReleasedDict":
        """Return a state dictionary, without the key prefix ``module.`` of parallel training."""
        part = self.part(key)
        values = {str(name).removeprefix("module."): value for name, value in part.values.items()}
        return ReleasedDict(self.path, part.name, values)

    def below(self, prefix: str) -> "ReleasedDict":
        """Return the entries whose keys start with a prefix, with the prefix removed."""
        values = {k.removeprefix(prefix): v for k, v in self.values.items() if k.startswith(prefix)}
        return ReleasedDict(self.path, f"{self.name}.{prefix.rstrip('.')}", values)

    def tensor(self, key: str, *shape: int | None) -> torch.Tensor:
        """Return a float32 tensor of finite numbers of this shape, in which None stands for any size."""
        expected = f"a float tensor of shape {_shape_text(shape)}"
        value = self._get(key, expected)
        plain = (
            isinstance(value, torch.Tensor) and value.layout == torch.strided and value.device.type == "cpu"
        )
        if not plain or value.dtype not in _FLOATS or not _fits(value.shape, shape):
            raise self.wrong(key, _describe(value), expected)
        # With strides of zero, a few bytes stand for a tensor of any size.
        if value.numel() * value.element_size() > Path(self.path).stat().st_size:
            raise self.wrong(key, f"{_describe(value)}, more than the file holds", expected)
        # Copied, because the file is memory-mapped and may be replaced.
        value = value.detach().contiguous().to(torch.float32, copy=True)
        if not torch.isfinite(value).all():
            raise self.wrong(key, "values that are not finite", "finite numbers")
        return value

    def numbers(self, key: str, *shape: int | None) -> np.ndarray:
        """Return an array, tensor or list of finite numbers as float64; without a shape, a single number."""
        expected = f"numbers of shape {_shape_text(shape)}" if shape else "a number"
        value = self._get(key, expected)
        found = _describe(value)
        if isinstance(value, StoredArray):
            array = value.value
        elif isinstance(value, torch.Tensor):
            array = self.tensor(key, *value.shape).numpy()
        else:
            try:
                array = np.array(_rows(value, Path(self.path).stat().st_size))
            except (ValueError, TypeError, OverflowError) as error:
                raise self.wrong(key, found, expected) from error
        if array.dtype.kind not in "fiu":
            raise self.wrong(key, found, expected)
        if not shape and array.size == 1:
            array = array.reshape(())
        if not _fits(array.shape, shape):
            raise self.wrong(key, found, expected)
        array = np.array(array, np.float64)
        if not np.isfinite(array).all():
            raise self.wrong(key, "values that are not finite", expected)
        return array

    def numbers_or_one(self, key: str, count: int) -> np.ndarray:
        """Return ``count`` numbers of any shape, or one number repeated; (count,) float64."""
        value = self._get(key, f"{count} numbers or one")
        held = value.value if isinstance(value, StoredArray) else value
        shape = getattr(held, "shape", (len(held),) if isinstance(held, list | tuple) else ())
        if math.prod(shape) not in (1, count):
            raise self.wrong(key, _describe(value), f"{count} numbers or one")
        return np.broadcast_to(self.numbers(key, *shape).reshape(-1), (count,)).copy()

    def number(self, key: str) -> float:
        """Return a finite number."""
        return float(self.numbers(key))

    def integer(self, key: str, low: int, high: int) -> int:
        """Return an integer from ``low`` to ``high``."""
        value = self.number(key)
        if not (value.is_integer() and low <= value <= high):
            raise self.wrong(key, f"{value:g}", f"a whole number from {low} to {high}")
        return int(value)

    def setting(self, key: str, default: Any = None) -> bool | int | float | str | None:
        """Return a number, Boolean or string; the string ``"None"`` becomes None."""
        value = self.values.get(key, default)
        if value is not None and not isinstance(value, bool | int | float | str):
            raise self.wrong(key, _describe(value), "a number, Boolean or string")
        return None if value == "None" else value

    def mask(self, key: str, size: int) -> np.ndarray:
        """Return a Boolean tensor or array, flattened."""
        expected = f"{size} Booleans"
        value = self._get(key, expected)
        if isinstance(value, torch.Tensor) and value.dtype in (torch.bool, torch.uint8):
            if value.layout == torch.strided and value.device.type == "cpu" and value.numel() == size:
                if size > Path(self.path).stat().st_size:
                    raise self.wrong(key, f"{_describe(value)}, more than the file holds", expected)
                return value.flatten().bool().clone().numpy()
        elif isinstance(value, StoredArray) and value.value.dtype.kind in "bu" and value.value.size == size:
            return value.value.reshape(-1).astype(bool)
        raise self.wrong(key, _describe(value), expected)

    def wrong(self, key: str, found: str, expected: str) -> ObjectFolderError:
        """Return an error that names an entry, its value and the expected value."""
        return ObjectFolderError(f"{self.path}: {self._full(key)} is {found}; expected {expected}")

    def _get(self, key: str, expected: str) -> Any:
        if key not in self.values:
            there = ", ".join(sorted(map(str, self.values))[:12]) or "nothing"
            missing = f"{self.path}: {self._full(key)} is missing; expected {expected}"
            raise ObjectFolderError(f"{missing}. {self.name or 'The file'} holds {there}")
        return self.values[key]

    def _full(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key


def read_released(path: str | Path) -> ReleasedDict:
    """Return the outermost dictionary of a ``.pth`` file of numbers, in torch's zip format or its older one.

    No code in it is executed: torch's restricted reader rebuilds tensors and plain containers, `STAND_INS`
    rebuild NumPy arrays, and any other name is an error. Raises ObjectFolderError if the file is missing, too
    large, damaged, or contains more than numbers.
    """
    path = Path(path)
    if path.is_dir():
        raise ObjectFolderError(f"{path} is a folder; expected a file such as {path}/ObjectFile.pth")
    existing_file(path, "expected a released ObjectFile.pth")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ObjectFolderError(f"{path} has {size} bytes; a released file has at most {MAX_BYTES}")
    zipped = zipfile.is_zipfile(path)
    if zipped:
        _check_archive(path, size)
    try:
        with warnings.catch_warnings(), torch.serialization.safe_globals(STAND_INS):
            warnings.simplefilter("ignore")  # about formats that torch has deprecated
            values = torch.load(path, map_location="cpu", weights_only=True, mmap=zipped)
    except MemoryError as error:
        raise ObjectFolderError(f"{path} needs more memory than is available: the file is damaged") from error
    except Exception as error:
        unread = f"{path} is not a file of tensors and numbers ({torch_problem(error)}){content_hint(path)}"
        raise ObjectFolderError(f"{unread}; expected a released ObjectFile.pth") from error
    if not isinstance(values, Mapping):
        raise ObjectFolderError(f"{path} holds {_describe(values)}; expected a dictionary")
    return ReleasedDict(path, "", values)


def _check_archive(path: Path, size: int) -> None:
    """Reject archives with compressed entries or more bytes inside than outside; torch never compresses."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise ObjectFolderError(f"{path} is a damaged archive: {error}") from error
    packed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
    if packed or len(entries) > MAX_ENTRIES or sum(entry.file_size for entry in entries) > size:
        other = "not an archive that torch.save writes"
        raise ObjectFolderError(f"{path} is {other}: its entries are compressed")
    pickles = [entry.file_size for entry in entries if entry.filename.endswith("data.pkl")]
    if max(pickles, default=0) > MAX_PICKLE:
        raise ObjectFolderError(f"{path}: data.pkl has {max(pickles)} bytes, expected at most {MAX_PICKLE}")


def _rows(value: Any, limit: int) -> Any:
    """Check a number, a list of numbers, or a list of lists or arrays of numbers.

    Lists may contain the same list many times, so that a few bytes stand for more numbers than memory holds.
    """
    if isinstance(value, bool | int | float):
        return value
    if not isinstance(value, list | tuple):
        raise TypeError("not a list")
    rows = [row.value.tolist() if isinstance(row, StoredArray) else row for row in value]
    wide = [row for row in rows if isinstance(row, list | tuple)]
    flat = all(isinstance(x, bool | int | float) for row in wide for x in row[: limit + 1])
    if sum(map(len, wide)) + len(rows) > limit or not flat:
        raise TypeError("not numbers")
    return rows


def _fits(found: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    return len(found) == len(expected) and all(e in (None, f) for f, e in zip(found, expected))


def _shape_text(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"


def _describe(value: Any) -> str:
    if isinstance(value, torch.Tensor):
        return f"a tensor of {str(value.dtype).removeprefix('torch.')}, shape {tuple(value.shape)}"
    if isinstance(value, StoredArray):
        return f"an array of {value.value.dtype}, shape {value.value.shape}"
    if value is None or isinstance(value, bool | int | float):
        return repr(value)
    return f"of type {type(value).__name__}"
