"""Read and write artifacts.

All writers use `atomic`, so a file is either absent or complete. All readers check their input and name the
file in errors.
"""

import ast
import errno
import hashlib
import io
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from objectfolder.disk import FULL_BELOW, free_bytes, is_shortage
from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.locks import claim_file, private_path

MAX_BYTES = 2**30  #: size limit of a safetensors file; a thousand times that of an Object File
MAX_HEADER = 2**20  #: length limit of its JSON header, characters
#: Numpy's names of the types of tensors.
DTYPES = {"BOOL": "?", "F64": "<f8", "F32": "<f4", "F16": "<f2"} | {
    f"{sign}{8 * size}": f"<{sign.lower()}{size}" for sign in "IU" for size in (1, 2, 4, 8)
}


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to ``path``; on success, fsync the file and rename it into place.

    The temporary file is new, its name is drawn at random, and it has the same suffix, because writers choose
    the format by it. So no link is followed that somebody else made: one at ``path`` is replaced. Of several
    who write the same path the last one wins. What killed writers leave, the next process that writes in the
    folder removes.

    Raises ObjectFolderError if the directory cannot be written, or the path is a folder or a device. Raises
    OSError of the block, or of a full disk that the block met, which names ``path``.
    """
    with _replace(Path(path)) as (temporary, _):
        yield temporary
        with temporary.open("rb") as stream:  # a library may have replaced the file
            os.fsync(stream.fileno())


@contextmanager
def atomic_stream(path: str | Path) -> Iterator[BinaryIO]:
    """Yield a stream to write a file; otherwise like `atomic`.

    Nobody can divert it: the file stays open from when it is made.
    """
    with _replace(Path(path)) as (_, handle), os.fdopen(handle, "wb", closefd=False) as stream:
        yield stream
        stream.flush()
        os.fsync(handle)


@contextmanager
def _replace(path: Path) -> Iterator[tuple[Path, int]]:
    """Yield a new file beside ``path`` and its descriptor; then rename it into place, or remove it."""
    temporary, lock = _claim(path)
    try:
        yield temporary, lock
        temporary.replace(path)
    except BaseException as error:
        # What torch, numpy and Pillow raise if a disk is full has no number.
        vague = isinstance(error, RuntimeError) or (isinstance(error, OSError) and error.errno is None)
        full = vague and free_bytes(path.parent) < FULL_BELOW
        temporary.unlink(missing_ok=True)
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        if isinstance(error, OSError) and (is_shortage(error) or error.filename in (None, str(temporary))):
            error.filename = str(path)
            del error.filename2
        raise
    finally:
        os.close(lock)


def check_output(path: str | Path) -> None:
    """Raise ObjectFolderError unless a file can be written at a path: before work that takes long."""
    temporary, lock = _claim(Path(path))
    temporary.unlink(missing_ok=True)
    os.close(lock)


def _claim(path: Path) -> tuple[Path, int]:
    """Return a new file beside ``path``, whose folder is made, and a descriptor that locks it."""
    if not path.name:
        raise ObjectFolderError(f"cannot write {str(path)!r}: it is a folder, expected a file's name")
    try:
        if path.exists() and not path.is_file():
            raise ObjectFolderError(
                f"cannot write {path}: it is a folder or a device, expected a file's name"
            )
        try:
            return claim_file(path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            return claim_file(path)
    except OSError as error:
        folder = shortened(path.parent, 300)
        full = is_shortage(error)
        advice = f"make space on the disk of {folder}" if full else f"make the directory {folder} writable"
        raise ObjectFolderError(
            f"cannot write {shortened(path, 300)}: {error.strerror}; {advice}, or choose another name"
        ) from error


def write_json(path: str | Path, value: Any) -> None:
    """Write JSON with sorted keys."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True) + "\n")


def wav_bytes(sound: np.ndarray, rate: int) -> bytes:
    """Encode a sound (samples,) as WAV. Not by libsndfile, whose PEAK chunk of floats has the time of day."""
    from scipy.io import wavfile

    stream = io.BytesIO()
    wavfile.write(stream, rate, sound)
    return stream.getvalue()


def write_text(path: str | Path, text: str) -> None:
    """Write text."""
    write_bytes(path, text.encode())


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write bytes."""
    with atomic_stream(path) as stream:
        stream.write(content)


def write_npz(path: str | Path, **arrays: Any) -> None:
    """Write a compressed ``.npz`` without pickled objects; its bytes depend only on the arrays."""
    pickled = [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]
    if pickled:
        raise TypeError(f"{path}: {', '.join(pickled)} would be pickled; expected arrays of numbers")
    with atomic_stream(path) as stream:
        np.savez_compressed(stream, **arrays)


def write_npy(path: str | Path, array: np.ndarray) -> None:
    """Write an array of numbers as ``.npy``."""
    with atomic_stream(path) as stream:
        np.save(stream, array, allow_pickle=False)


def write_safetensors(path: str | Path, tensors: dict[str, Any], header: dict[str, Any]) -> None:
    """Write numpy tensors and a JSON header, under a single metadata key so that the bytes are stable."""
    write_bytes(path, safetensors_bytes(tensors, header))


def safetensors_bytes(tensors: Mapping[str, Any], header: dict[str, Any]) -> bytes:
    """Return the content of the file that `write_safetensors` writes."""
    from safetensors.numpy import save

    contiguous = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    return save(contiguous, metadata=_metadata(header))


def _metadata(header: dict[str, Any]) -> dict[str, str]:
    """Return the metadata that hold a header; `read_safetensors` refuses NaN and infinity."""
    return {"objectfolder": json.dumps(header, sort_keys=True, allow_nan=False)}


def write_png(path: str | Path, image: np.ndarray) -> None:
    """Write an (H, W, 3) or (H, W) uint8 image."""
    from PIL import Image

    with atomic_stream(path) as stream:
        Image.fromarray(image).save(stream, "PNG")


def write_table(path: str | Path, columns: list[str], rows: list[list[Any]]) -> None:
    """Write rows of numbers as CSV."""
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    write_text(path, "\n".join([",".join(columns), *lines]) + "\n")


def write_curve(path: str | Path, curve: list[Any]) -> None:
    """Write a training curve (`objectfolder.nets.fit.CurvePoint`) as CSV.

    Wall-clock times are omitted: equal inputs must give equal bytes.
    """
    rows = [[p.step, p.train_loss, p.val_loss] for p in curve]
    write_table(path, ["step", "train_loss", "val_loss"], rows)


def keep(path: str | Path, name: str | Path) -> None:
    """Hard-link a file to a second name, or copy it where links are impossible."""
    if Path(name).exists() and Path(name).samefile(path):
        return  # of two names of a file, a rename would leave the temporary one
    with atomic(name) as temporary:
        linked = private_path(Path(name))
        try:
            os.link(path, linked)
        except OSError:
            shutil.copyfile(path, temporary)
        else:
            linked.replace(temporary)


def file_digest(path: str | Path) -> str:
    """Return the SHA-256 digest of a file in hexadecimal."""
    with _existing(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises ObjectFolderError if the file is missing or damaged.
    """
    path = _existing(path)
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error


def read_npz(path: str | Path, *required: str) -> dict[str, np.ndarray]:
    """Read an ``.npz`` and check that it holds the required arrays.

    Raises ObjectFolderError if the file is missing, damaged, or lacks an array.
    """
    path = _existing(path)
    try:
        # Open the file here, because numpy does not close damaged files.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = _distinct([(name, archive[name]) for name in archive.files])
    except Exception as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error
    missing = set(required) - set(arrays)
    if missing:
        raise ObjectFolderError(
            f"{path} lacks {', '.join(sorted(missing))} (it holds {', '.join(sorted(arrays))}); rebuild it"
        )
    return arrays


class StoredTensors(Mapping[str, np.ndarray]):
    """Mapping of the tensors of a safetensors file; its bytes are in memory, and each access gives a copy.

    Raises ObjectFolderError on access, if numpy does not support the type of a tensor.
    """

    def __init__(self, path: Path, stored: dict[str, dict[str, Any]]):
        self._path, self._stored = path, stored

    def __getitem__(self, name: str) -> np.ndarray:
        stored = self._stored[name]
        dtype = DTYPES.get(stored["dtype"])
        if dtype is None:
            raise ObjectFolderError(
                f"{self._path}: tensor {name} holds {stored['dtype']}, expected one of {', '.join(DTYPES)}"
            )
        return np.ndarray(stored["shape"], dtype, buffer=stored["data"]).copy()

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._stored))

    def __len__(self) -> int:
        return len(self._stored)


def open_safetensors(path: str | Path) -> tuple[StoredTensors, Any]:
    """Read a file of `write_safetensors` at once; return its tensors and its JSON header.

    The file is not mapped: it may change or shrink afterwards. Nothing in it is executed. All sizes are
    checked before memory is allocated.

    Raises ObjectFolderError if the file is missing, damaged, too large, or not a safetensors file, or holds a
    name twice.
    """
    from safetensors import deserialize

    path = _existing(path)
    try:
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise ValueError(f"it has {size:,} bytes, expected at most {MAX_BYTES:,}")
            content = stream.read(size)
        stored = dict(deserialize(content))
        # Libraries take the last of two values of one name.
        described = _json(content[8 : 8 + int.from_bytes(content[:8], "little")])
        header = described.get("__metadata__", {}).get("objectfolder")
        if header is not None and len(header) > MAX_HEADER:
            raise ValueError(f"its header has {len(header):,} characters, expected at most {MAX_HEADER:,}")
        return StoredTensors(path, stored), {} if header is None else _json(header)
    except Exception as error:
        reason = str(error).removeprefix("Error while deserializing: ")
        raise ObjectFolderError(
            f"{path} is neither an Object File nor another readable safetensors file: {reason}"
        ) from error


def read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read all tensors and the JSON header; otherwise like `open_safetensors`."""
    tensors, header = open_safetensors(path)
    return dict(tensors), header


def torch_problem(error: Exception) -> str:
    """Return in a line why `torch.load` refused a file, without its advice to run what the file holds."""
    text = str(error).strip()
    if named := re.search(r"GLOBAL (\S+)", text):
        return f"it names {named[1]}, which is never run"
    if "weights_only" in text:
        detail = re.search(r"WeightsUnpickler error:\s*(.+)", text)
        text = detail[1] if detail else "torch.save did not write it, or it is damaged"
    return shortened(text.partition("\n")[0].partition(". ")[0], 200) or type(error).__name__


def read_rows(path: str | Path, width: int, hint: str = "") -> np.ndarray:
    """Read an (N, width) array of real numbers from a ``.npy`` file as float64.

    ``hint``: text appended to errors about the shape. Raises ObjectFolderError if the file is missing, or not
    an array of real numbers of this shape. The file is never unpickled, and no more memory is allocated than
    its size justifies.
    """
    path = _existing(path, f"expected a .npy file of shape (N, {width})")
    try:
        with path.open("rb") as stream:
            shape, dtype = _npy_header(stream)
            if dtype.kind not in "fiu":
                raise ObjectFolderError(f"{path} holds {dtype}, expected real numbers")
            if len(shape) != 2 or shape[1] != width:
                raise ObjectFolderError(f"{path} has shape {shape}, expected (N, {width}){hint}")
            # numpy would allocate the array before noticing that the file is too short.
            if shape[0] * width * dtype.itemsize > path.stat().st_size:
                raise ValueError(f"it is too short for an array of shape {shape}")
            stream.seek(0)
            return np.load(stream, allow_pickle=False).astype(np.float64)
    except ObjectFolderError:
        raise
    except (
        Exception
    ) as error:  # numpy parses the header as Python literals, which raises many types of errors
        raise ObjectFolderError(f"{path} is not a .npy file of numbers: {error}") from error


def _npy_header(stream: BinaryIO) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(stream)
    start = stream.tell()
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"its version is {version}, expected 1.0 or 2.0")
    length = stream.tell() - start
    stream.seek(start)
    text = stream.read(length)[2 * version[0] :].decode("latin1")  # after its length
    literal = ast.parse(text.strip(), mode="eval").body
    if isinstance(literal, ast.Dict) and len(literal.keys) > 3:  # numpy reads three, each of which is there
        raise ValueError(f"its header {shortened(text.strip())} holds a name twice")
    return shape, dtype


def _json(text: str | bytes) -> Any:
    """Parse JSON, without the extensions and the ambiguities that Python accepts."""
    return json.loads(text, parse_constant=_no_number, object_pairs_hook=_distinct)


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        [(name, times)] = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"it holds {shortened(repr(name))} {times} times, expected once")
    return values


def _no_number(name: str) -> None:
    raise ValueError(f"its header holds {name}, which is not JSON")


def _existing(path: str | Path, hint: str = "build it with `objectfolder build`") -> Path:
    path = Path(path)
    try:
        problem = None if path.is_file() else "does not exist"
        if problem and path.exists():
            problem, hint = "is a folder" if path.is_dir() else "is a device", "expected a file"
    except OSError as error:  # a name that is too long, a folder without permission
        problem = f"cannot be read: {error.strerror}"
    if problem:
        raise ObjectFolderError(f"{shortened(path, 300)} {problem}; {hint}")
    return path
