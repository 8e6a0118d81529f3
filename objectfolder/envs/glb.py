"""Binary glTF files: read and written as their document and their one buffer."""

import json
import struct
from typing import Any

import numpy as np

_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_COMPONENTS = {"<f4": 5126, "<u4": 5125}
_TYPES = {1: "SCALAR", 3: "VEC3"}


def unpacked(content: bytes) -> tuple[dict[str, Any], bytearray]:
    """Return the document and the buffer of a binary glTF."""
    length = struct.unpack_from("<3I", content)[2]
    place, chunks = 12, {}
    while place < length:
        size, kind = struct.unpack_from("<2I", content, place)
        chunks[kind] = content[place + 8 : place + 8 + size]
        place += 8 + size
    return json.loads(chunks[_JSON]), bytearray(chunks[_BIN])


def packed(document: dict[str, Any], buffer: bytearray) -> bytes:
    """Return a binary glTF of a document and its buffer."""
    document["buffers"] = [{"byteLength": len(buffer)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    parts = [
        struct.pack("<2I", len(padded), kind) + padded
        for padded, kind in ((_padded(text, b" "), _JSON), (_padded(bytes(buffer), b"\0"), _BIN))
    ]
    return struct.pack("<3I", _MAGIC, _VERSION, 12 + sum(map(len, parts))) + b"".join(parts)


def append(document: dict[str, Any], buffer: bytearray, values: np.ndarray) -> int:
    """Add an array to the buffer, and return the index of its accessor.

    Parameters
    ----------
    values : (N,) or (N, 3) array
        Float32 or uint32.
    """
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    buffer.extend(b"\0" * (-len(buffer) % 4))
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(buffer), "byteLength": values.nbytes})
    buffer.extend(values.tobytes())
    rows = values.reshape(len(values), -1)
    document["accessors"].append(
        {
            "bufferView": len(document["bufferViews"]) - 1,
            "componentType": _COMPONENTS[values.dtype.str],
            "count": len(values),
            "type": _TYPES[rows.shape[1]],
            "min": rows.min(0).tolist(),
            "max": rows.max(0).tolist(),
        }
    )
    return len(document["accessors"]) - 1


def values_of(document: dict[str, Any], buffer: bytearray, accessor: int) -> np.ndarray:
    """Return the array of an accessor that `append` could have added."""
    found = document["accessors"][accessor]
    kind = {number: name for name, number in _COMPONENTS.items()}[found["componentType"]]
    width = {name: number for number, name in _TYPES.items()}[found["type"]]
    start = document["bufferViews"][found["bufferView"]]["byteOffset"]
    values = np.frombuffer(buffer, kind, found["count"] * width, start)
    return values if width == 1 else values.reshape(-1, width)


def _padded(content: bytes, fill: bytes) -> bytes:
    return content + fill * (-len(content) % 4)
