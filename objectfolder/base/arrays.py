"""Read and write files of arrays: archives, tensors, pictures, sounds, tables of numbers.

Readers check their input and name the file in errors.
"""

import ast
import io
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import (
    atomic_stream,
    content_hint,
    existing_file,
    parse_json,
    unique_names,
    write_bytes,
)

MAX_BYTES = 2**30  #: size limit of a safetensors file; a thousand times that of an Object File
MAX_HEADER = 2**20  #: length limit of its JSON header, characters
#: Numpy's names of the types of tensors.
DTYPES = {"BOOL": "?", "F64": "<f8", "F32": "<f4", "F16": "<f2"} | {
    f"{sign}{8 * size}": f"<{sign.lower()}{size}" for sign in "IU" for size in (1, 2, 4, 8)
}


def wav_bytes(sound: np.ndarray, rate: int) -> bytes:
    """Encode a sound (samples,) as WAV. Not by libsndfile, whose PEAK chunk of floats has the time of day."""
    from scipy.io import wavfile

    stream = io.BytesIO()
    wavfile.write(stream, rate, sound)
    return stream.getvalue()


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
    text = json.dumps(header, sort_keys=True, allow_nan=False)  # `read_safetensors` refuses NaN and infinity
    return save(contiguous, metadata={"objectfolder": text})


def write_png(path: str | Path, image: np.ndarray) -> None:
    """Write an (H, W, 3) or (H, W) uint8 image."""
    from PIL import Image

    with atomic_stream(path) as stream:
        Image.fromarray(image).save(stream, "PNG")


def read_npz(path: str | Path, *required: str) -> dict[str, np.ndarray]:
    """Read an ``.npz`` and check that it holds the required arrays.

    Raises ObjectFolderError if the file is missing, damaged, or lacks an array.
    """
    path = existing_file(path)
    try:
        # Open the file here, because numpy does not close damaged files.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = unique_names([(name, archive[name]) for name in archive.files])
    except Exception as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error
    if missing := ", ".join(sorted(set(required) - set(arrays))):
        raise ObjectFolderError(f"{path} lacks {missing} (it holds {', '.join(sorted(arrays))}); rebuild it")
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
            held = f"tensor {name} holds {stored['dtype']}"
            raise ObjectFolderError(f"{self._path}: {held}, expected one of {', '.join(DTYPES)}")
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

    path = existing_file(path)
    try:
        with path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise ValueError(f"it has {size:,} bytes, expected at most {MAX_BYTES:,}")
            content = stream.read(size)
        stored = dict(deserialize(content))
        # Libraries take the last of two values of one name.
        described = parse_json(content[8 : 8 + int.from_bytes(content[:8], "little")])
        header = described.get("__metadata__", {}).get("objectfolder")
        if header is not None and len(header) > MAX_HEADER:
            raise ValueError(f"its header has {len(header):,} characters, expected at most {MAX_HEADER:,}")
        return StoredTensors(path, stored), {} if header is None else parse_json(header)
    except Exception as error:
        reason = str(error).removeprefix("Error while deserializing: ") + content_hint(path)
        other = "neither an Object File nor another readable safetensors file"
        raise ObjectFolderError(f"{path} is {other}: {reason}") from error


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
    path = existing_file(path, f"expected a .npy file of shape (N, {width})")
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
    except Exception as error:  # numpy parses the header as Python literals, which raises many types
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
