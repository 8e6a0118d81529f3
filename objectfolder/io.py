"""Read and write artifacts.

Every writer goes through `atomic`, so a file is either absent or complete. Every reader checks what it needs
and names the file when something is wrong.
"""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from objectfolder.errors import ObjectFolderError

MAX_BYTES = 2**30  #: of a safetensors file; a thousand times what an Object File takes
MAX_HEADER = 2**20  #: characters of its JSON header


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Give a temporary path next to ``path``; on success fsync it and rename it into place.

    The temporary name keeps the suffix, because writers choose the format by it, and is the same every time,
    so that a killed writer leaves at most one.

    Raises
    ------
    ObjectFolderError
        If the directory cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise ObjectFolderError(
            f"cannot write {path}: {error.strerror}; make the directory {path.parent} writable"
        ) from error
    try:
        yield temporary
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(directory: Path) -> None:
    """Raise ObjectFolderError unless files can be made in a directory."""
    with atomic(directory / ".writable"):
        pass
    (directory / ".writable").unlink()


def write_json(path: str | Path, value: Any) -> None:
    """Write JSON with sorted keys."""
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(value, indent=2, sort_keys=True) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write text."""
    with atomic(path) as temporary:
        temporary.write_text(text)


def write_npz(path: str | Path, **arrays: Any) -> None:
    """Write a compressed ``.npz`` whose bytes depend on the arrays only; no pickled objects."""
    pickled = [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]
    if pickled:
        raise TypeError(f"{path}: {', '.join(pickled)} would be pickled; expected arrays of numbers")
    with atomic(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def write_npy(path: str | Path, array: np.ndarray) -> None:
    """Write an array of numbers as ``.npy``."""
    with atomic(path) as temporary, temporary.open("wb") as stream:
        np.save(stream, array, allow_pickle=False)


def write_safetensors(path: str | Path, tensors: dict[str, Any], header: dict[str, Any]) -> None:
    """Write numpy tensors and a JSON header (stored under one metadata key, so the bytes are stable)."""
    from safetensors.numpy import save_file

    with atomic(path) as temporary:
        contiguous = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
        mode = temporary.stat().st_mode  # safetensors lets nobody else read what it writes
        save_file(contiguous, temporary, metadata={"objectfolder": json.dumps(header, sort_keys=True)})
        temporary.chmod(mode)


def write_png(path: str | Path, image: np.ndarray) -> None:
    """Write an (H, W, 3) or (H, W) uint8 image."""
    from PIL import Image

    with atomic(path) as temporary:
        Image.fromarray(image).save(temporary)


def write_table(path: str | Path, columns: list[str], rows: list[list[Any]]) -> None:
    """Write rows of numbers as CSV."""
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    with atomic(path) as temporary:
        temporary.write_text("\n".join([",".join(columns), *lines]) + "\n")


def write_curve(path: str | Path, curve: list[Any]) -> None:
    """Write a training curve (`objectfolder.nets.fit.CurvePoint`) as CSV.

    The wall-clock column is left out: the same inputs must give the same bytes.
    """
    rows = [[p.step, p.train_loss, p.val_loss] for p in curve]
    write_table(path, ["step", "train_loss", "val_loss"], rows)


def keep(path: str | Path, name: str | Path) -> None:
    """Give a file a second name, under which it outlives the first; a copy where links are not possible."""
    with atomic(name) as temporary:
        temporary.unlink()
        try:
            os.link(path, temporary)
        except OSError:
            shutil.copyfile(path, temporary)


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with _existing(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    ObjectFolderError
        If the file is missing or damaged.
    """
    path = _existing(path)
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error


def read_npz(path: str | Path, *required: str) -> dict[str, np.ndarray]:
    """Read an ``.npz`` and check that it holds the required arrays.

    Raises
    ------
    ObjectFolderError
        If the file is missing, damaged, or lacks an array.
    """
    path = _existing(path)
    try:
        # Opened here, because numpy leaves a damaged file open.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error
    missing = set(required) - set(arrays)
    if missing:
        raise ObjectFolderError(
            f"{path} lacks {', '.join(sorted(missing))} (it holds {', '.join(sorted(arrays))}); rebuild it"
        )
    return arrays


class StoredTensors(Mapping[str, np.ndarray]):
    """Tensors of a safetensors file, each read from the mapped file when it is asked for.

    Raises
    ------
    ObjectFolderError
        On reading, if a tensor is of a type that numpy lacks.
    """

    def __init__(self, path: Path, stream: Any):
        self._path, self._stream = path, stream
        self._names = tuple(sorted(stream.keys()))

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._names:
            raise KeyError(name)
        try:
            return self._stream.get_tensor(name)
        except Exception as error:
            raise ObjectFolderError(f"{self._path}: tensor {name} cannot be read: {error}") from error

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def size(self, name: str) -> int:
        """Count the numbers of a tensor without reading them."""
        return math.prod(self._stream.get_slice(name).get_shape())


def open_safetensors(path: str | Path) -> tuple[StoredTensors, Any]:
    """Open a file that `write_safetensors` wrote: its tensors, unread, and its JSON header.

    Nothing in the file is executed. Its sizes are checked against each other before any memory is taken.

    Raises
    ------
    ObjectFolderError
        If the file is missing, damaged, too large, or not one of ours.
    """
    from safetensors import safe_open

    path = _existing(path)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ObjectFolderError(f"{path} has {size:,} bytes, expected at most {MAX_BYTES:,}")
    try:
        stream = safe_open(str(path), framework="numpy")
        header = (stream.metadata() or {}).get("objectfolder")
        if header is not None and len(header) > MAX_HEADER:
            raise ValueError(f"its header has {len(header):,} characters, expected at most {MAX_HEADER:,}")
        values = json.loads(header, parse_constant=_no_number) if header is not None else {}
        return StoredTensors(path, stream), values
    except Exception as error:
        raise ObjectFolderError(f"{path} is not a readable safetensors file: {error}") from error


def read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read all tensors and the JSON header; otherwise as `open_safetensors`."""
    tensors, header = open_safetensors(path)
    return dict(tensors), header


def read_rows(path: str | Path, width: int, hint: str = "") -> np.ndarray:
    """Read the (N, width) real numbers of a ``.npy`` file; float64.

    Parameters
    ----------
    hint : str
        Ends the message of an error about the shape.

    Raises
    ------
    ObjectFolderError
        If the file is missing, no array of real numbers, or of another shape. It is never unpickled, and no
        memory is taken for more than it holds.
    """
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; expected a .npy file of shape (N, {width})")
    try:
        with path.open("rb") as stream:
            shape, dtype = _npy_header(stream)
            if dtype.kind not in "fiu":
                raise ObjectFolderError(f"{path} holds {dtype}, expected real numbers")
            if len(shape) != 2 or shape[1] != width:
                raise ObjectFolderError(f"{path} has shape {shape}, expected (N, {width}){hint}")
            # numpy would take the memory before it sees that the file is too short.
            if shape[0] * width * dtype.itemsize > path.stat().st_size:
                raise ValueError(f"it is too short for an array of shape {shape}")
            stream.seek(0)
            return np.load(stream, allow_pickle=False).astype(np.float64)
    except ObjectFolderError:
        raise
    except Exception as error:  # numpy parses the header as Python literals: many things go wrong
        raise ObjectFolderError(f"{path} is not a .npy file of numbers: {error}") from error


def _npy_header(stream: BinaryIO) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"its version is {version}, expected 1.0 or 2.0")
    return shape, dtype


def _no_number(name: str) -> None:
    raise ValueError(f"its header holds {name}, which is not JSON")


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; build it with `objectfolder build`")
    return path
