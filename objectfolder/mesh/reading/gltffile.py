"""Document, buffers, accessors and images of a glTF 2.0 file (Khronos, 2021)."""

import base64
import json
import struct
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from PIL import Image

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh.reading.files import MAX_NAME, find_referenced, read_image, read_referenced
from objectfolder.mesh.reading.text import CUT_OFF

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
VISIBILITY, INSTANCING, LOD = "KHR_node_visibility", "EXT_mesh_gpu_instancing", "MSFT_lod"
DRACO = "KHR_draco_mesh_compression"
#: Extensions that are read, or beside which a file holds the same without.
READ = {"KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp", VISIBILITY, INSTANCING, LOD}
# Extensions that a file may require: those that are read, those of textures, which are refused only if a
# texture that counts has no other image, and those that change neither shape nor base colour.
HARMLESS = ("_materials_", "_texture_", "_lights_", "_xmp", "KHR_animation_", "KHR_node_")
REMEDIES = {
    DRACO: "export it without compression, or run `npx @gltf-transform/cli copy IN.glb OUT.glb`",
    "EXT_meshopt_compression": "export it without compression",
    "KHR_meshopt_compression": "export it without compression",
}


class GltfFile:
    """glTF document with its buffers, and what reading it left out."""

    def __init__(self, path: Path):
        self.path = path
        self.document, self.binary = read_document(path)
        for name in self.document.get("extensionsRequired", []):
            if name not in READ and not any(part in name for part in HARMLESS):
                remedy = REMEDIES.get(name, "export it without")
                raise ObjectFolderError(
                    f"{path} needs the glTF extension {shortened(name)}, which is not supported; {remedy}"
                )
        self.buffers = [self._buffer(i, buffer) for i, buffer in enumerate(self.document.get("buffers", []))]
        self.left_out: Counter[str] = Counter()
        self.noted: set[str] = set()  # extensions

    def note_extensions(self, item: dict[str, Any], known: Collection[str] = ()) -> None:
        """Note the extensions of a part of the document that are not read."""
        for name in item.get("extensions", {}).keys() - READ - {*known}:
            self.left_out[f"{shortened(name)} left out"] += 1
            self.noted.add(name)

    def accessor(
        self, index: int, width: int | None, expected: int | None = None, fractions: bool = False
    ) -> np.ndarray:
        """Values (count, width) of an accessor; scaled to [-1, 1] if normalized, or integer ``fractions``.

        Without a width, that of colours: 3 or 4.
        """
        accessor = self.document["accessors"][index]
        dtype, columns, count = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]], accessor["count"]
        if columns != width and (width is not None or columns not in (3, 4)):
            raise ObjectFolderError(
                f"{self.path}: accessor {index} has {columns} columns, expected {width or '3 or 4'}; "
                "export the mesh again"
            )
        if expected not in (None, count):
            raise ObjectFolderError(
                f"{self.path}: accessor {index} has {shortened(count)} values for {expected} vertices; "
                "export the mesh again"
            )
        if "bufferView" in accessor:
            offset = accessor.get("byteOffset", 0)
            values = self._view(accessor["bufferView"], offset, np.dtype(dtype), count, columns)
        else:
            held = sum(map(len, self.buffers))
            if count > held:
                raise ObjectFolderError(
                    f"{self.path}: accessor {index} has {shortened(count)} values, more than the {held} "
                    "bytes of the file's buffers; export it again, uncompressed"
                )
            values = np.zeros((count, columns), dtype)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            at, new = sparse["indices"], sparse["values"]
            n, index_type = sparse["count"], np.dtype(DTYPES[at["componentType"]])
            rows = self._view(at["bufferView"], at.get("byteOffset", 0), index_type, n, 1)[:, 0]
            values = values.copy()
            values[rows] = self._view(
                new["bufferView"], new.get("byteOffset", 0), np.dtype(dtype), n, columns
            )
        result = values.astype(np.float64)
        if accessor.get("normalized") or (fractions and values.dtype.kind != "f"):
            result = np.maximum(result / np.iinfo(dtype).max, -1)
        return result

    def image(self, index: int, mode: str) -> Image.Image:
        """Decode an image into Pillow's pixels ``mode``."""
        image = self.document["images"][index]
        name = image.get("name") or f"image {index}"
        if "bufferView" in image:
            view = self.document["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = self.buffers[view["buffer"]][start : start + view["byteLength"]]
        else:
            data = self._fetch(image["uri"])
            name = name if is_data(image["uri"]) else file_name(self.path, image["uri"])
        return read_image(data, name, self.path, mode)

    def _buffer(self, index: int, buffer: dict[str, Any]) -> bytes:
        # Without an address, the first is the binary chunk; another is not there, and nothing may need it.
        data = self._fetch(buffer["uri"]) if "uri" in buffer else self.binary if index == 0 else None
        if data is not None and len(data) < buffer["byteLength"]:
            where = buffer.get("uri", "its binary chunk")[:80]
            raise ObjectFolderError(
                f"{self.path} cannot be read as a mesh: {where} holds {len(data)} bytes, expected "
                f"{buffer['byteLength']}; {CUT_OFF}"
            )
        return data or b""

    def _fetch(self, uri: str) -> bytes:
        if is_data(uri):
            header, _, content = uri.partition(",")
            data = unquote_to_bytes(content)
            return base64.b64decode(data + b"==") if header.lower().endswith(";base64") else data
        name = find_referenced(self.path, file_name(self.path, uri), any_case=True)
        return read_referenced(self.path, name)

    def _view(self, index: int, offset: int, dtype: np.dtype, count: int, columns: int) -> np.ndarray:
        view = self.document["bufferViews"][index]
        row = dtype.itemsize * columns
        stride = view.get("byteStride") or row
        start = view.get("byteOffset", 0) + offset
        end = start + (count - 1) * stride + row
        if min(offset, count) < 0 or stride < row or end > view.get("byteOffset", 0) + view["byteLength"]:
            raise ObjectFolderError(
                f"{self.path}: an accessor reaches beyond the end of buffer view {index}; {CUT_OFF}"
            )
        return np.ndarray(
            (count, columns), dtype, self.buffers[view["buffer"]], start, (stride, dtype.itemsize)
        )


def is_data(uri: str) -> bool:
    """Whether a URI holds its data itself."""
    return uri[:5].lower() == "data:"


def file_name(path: Path, uri: str) -> str:
    """Return the file name that a URI of a glTF file stands for; as written if only that file exists.

    Of an absolute address, it is the last name, for a file beside the mesh.
    """
    name = unquote(uri.rpartition("/")[2] if "://" in uri else uri)
    if name == uri or len(uri.encode(errors="replace")) > MAX_NAME:
        return name
    return uri if (path.parent / uri).is_file() and not (path.parent / name).is_file() else name


def read_document(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON document and the binary chunk (empty in ``.gltf``) of a glTF file."""
    data, binary = path.read_bytes(), b""
    if path.suffix.lower() == ".glb":
        data, binary = _chunks(path, data)
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its glTF document is not JSON ({error}); export it again"
        ) from error
    asset = document.get("asset", {}) if isinstance(document, dict) else {"version": "none"}
    version, least = asset.get("version", "2.0"), asset.get("minVersion", "2.0")
    if not str(version).startswith("2.") or least != "2.0":
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: glTF version {shortened(version)}, expected 2.0; export it "
            "again"
        )
    return document, binary


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    if data[:4] != b"glTF" or len(data) < 20:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it has no binary glTF header; export it again"
        )
    version, length, size, kind = struct.unpack("<III4s", data[4:20])
    if version != 2:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: glTF version {version}, expected 2; export it again"
        )
    if len(data) < length or kind != b"JSON" or 20 + size > length:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it holds {len(data)} bytes, its header says {length}; "
            f"{CUT_OFF}"
        )
    binary = b""
    if 28 + size <= length:
        binary_size, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
        binary = data[28 + size : 28 + size + binary_size] if kind == b"BIN\0" else b""
    return data[20 : 20 + size], binary
