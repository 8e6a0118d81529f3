"""Read glTF 2.0 (Khronos, 2021): triangles with base colour, roughness and metallic, in scene space."""

import base64
import json
import math
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from PIL import Image, ImageStat

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh.reading.files import read_image, read_referenced
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial

# Extensions that a file may require. Material extensions affect the appearance only.
EXTENSIONS = ("KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp", "KHR_materials_")
DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
GLOSS, TRANSMISSION = "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission"
UNLIT, INSTANCING = "KHR_materials_unlit", "EXT_mesh_gpu_instancing"
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
TRIANGLES, STRIP, FAN = 4, 5, 6
ROUNDING = 1e-4  # of a quaternion's length in single precision, or few digits
MAX_ELEMENTS = 50_000_000  # vertices and corners of faces; nodes may repeat a mesh


def read_gltf(path: Path) -> MeshContent:
    """Read the default scene of a ``.gltf`` or ``.glb``.

    Base colour textures (with ``KHR_texture_transform``), factors, vertex colours, roughness and metallic
    are kept; a map of roughness and metallic, or of glossiness, is reduced to its mean. Normal, occlusion and
    emissive maps, emission, transparency, other extensions of materials, skins and morph targets are dropped
    with a note.

    Returns
    -------
    MeshContent
        In the file's frame: y up.

    Raises
    ------
    ObjectFolderError
        If the file, or one it refers to, is missing or invalid, or requires an unknown extension.
    """
    with _valid(path):
        return _File(path).read()


def uris(path: Path) -> list[str]:
    """Return the paths of the files that a valid glTF file refers to, as it names them."""
    with _valid(path):
        document, _ = _document(path)
        items = [*document.get("buffers", []), *document.get("images", [])]
        found = [item["uri"] for item in items if item.get("uri")]
        return [unquote(uri) for uri in found if not uri.startswith("data:")]


@contextmanager
def _valid(path: Path) -> Iterator[None]:
    try:
        yield
    except ObjectFolderError:
        raise
    except Exception as error:  # wrong types or indices anywhere in the document
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it is not valid glTF ({type(error).__name__}: "
            f"{shortened(error, 200)}); export it again"
        ) from error


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON document and the binary chunk (empty in ``.gltf``) of a glTF file."""
    data, binary = path.read_bytes(), b""
    if path.suffix.lower() == ".glb":
        data, binary = _chunks(path, data)
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its glTF document is not JSON ({error})"
        ) from error
    version = document.get("asset", {}).get("version", "2.0") if isinstance(document, dict) else "none"
    if not str(version).startswith("2."):
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: glTF version {shortened(version)}, expected 2.0"
        )
    return document, binary


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    if data[:4] != b"glTF" or len(data) < 20:
        raise ObjectFolderError(f"{path} cannot be read as a mesh: it has no binary glTF header")
    version, length, size, kind = struct.unpack("<III4s", data[4:20])
    if version != 2:
        raise ObjectFolderError(f"{path} cannot be read as a mesh: glTF version {version}, expected 2")
    if len(data) < length or kind != b"JSON" or 20 + size > length:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it holds {len(data)} bytes, its header says {length}: cut off?"
        )
    binary = b""
    if 28 + size <= length:
        binary_size, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
        binary = data[28 + size : 28 + size + binary_size] if kind == b"BIN\0" else b""
    return data[20 : 20 + size], binary


class _File:
    """glTF document with its buffers and the materials read so far."""

    def __init__(self, path: Path):
        self.path = path
        self.document, self.binary = _document(path)
        for name in self.document.get("extensionsRequired", []):
            if not name.startswith(EXTENSIONS):
                raise ObjectFolderError(
                    f"{path} needs the glTF extension {shortened(name)}, which is not supported; export it "
                    "without"
                )
        self.buffers = [self._buffer(buffer) for buffer in self.document.get("buffers", [])]
        self.materials: dict[int | None, tuple[SurfaceMaterial, dict[str, Any]]] = {
            None: (SurfaceMaterial(), {})
        }
        self.images: dict[tuple[int, str], Image.Image] = {}
        self.changes: Counter[str] = Counter()

    def read(self) -> MeshContent:
        parts: list[MeshPart] = []
        shapes: dict[int, list[MeshPart]] = {}
        elements = 0
        for mesh, transform in self._place_meshes():
            if mesh not in shapes:
                shapes[mesh] = self._shapes(mesh)
            elements += sum(len(shape.vertices) + shape.faces.size for shape in shapes[mesh])
            self._check_size(elements)
            parts += [_move(shape, transform) for shape in shapes[mesh]]
        return MeshContent(parts, [f"{what} ({n})" for what, n in sorted(self.changes.items()) if n])

    def _place_meshes(self) -> list[tuple[int, np.ndarray]]:
        """Return the scene's meshes with their transforms (4, 4), in document order."""
        nodes = self.document.get("nodes", [])
        if self.document.get("scenes"):
            roots = self.document["scenes"][self.document.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [i for i in range(len(nodes)) if i not in children]
        placed, seen = [], set()
        queue = [(root, np.eye(4)) for root in reversed(roots)]
        while queue:
            index, parent = queue.pop()
            if index in seen:
                raise ObjectFolderError(f"{self.path}: node {index} has two parents; expected a tree")
            seen.add(index)
            node = nodes[index]
            transform = parent @ _transform(node)
            if "mesh" in node:
                placed.append((node["mesh"], transform))
                self.changes["skin left out"] += "skin" in node
                if INSTANCING in node.get("extensions", {}):
                    raise ObjectFolderError(
                        f"{self.path}: node {index} repeats its mesh with {INSTANCING}, which is not "
                        "supported; export it without instancing"
                    )
            queue += [(child, transform) for child in reversed(node.get("children", []))]
        return placed

    def _check_size(self, elements: int) -> None:
        if elements > MAX_ELEMENTS:
            raise ObjectFolderError(
                f"{self.path} holds more than {MAX_ELEMENTS} vertices and corners of faces, with meshes that "
                "its nodes repeat; simplify it"
            )

    def _shapes(self, mesh: int) -> list[MeshPart]:
        """Return the primitives of a mesh, in its own frame."""
        shapes: list[MeshPart] = []
        for primitive in self.document["meshes"][mesh]["primitives"]:
            if primitive.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN):
                shapes.append(self._shape(primitive))
                self._check_size(sum(len(shape.vertices) + shape.faces.size for shape in shapes))
            else:
                self.changes["points or lines left out"] += 1
        return shapes

    def _shape(self, primitive: dict[str, Any]) -> MeshPart:
        attributes = primitive["attributes"]
        self.changes["morph targets left out"] += "targets" in primitive
        vertices = self._accessor(attributes["POSITION"], 3)
        count = len(vertices)
        corners = np.arange(count)
        if "indices" in primitive:
            corners = self._accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
        faces = _triangles(corners, primitive.get("mode", TRIANGLES))
        material, texture = self._material(primitive.get("material"))
        uv = None
        transform_uv = texture.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{transform_uv.get('texCoord', texture.get('texCoord', 0))}"
        if material.image is not None and name in attributes:
            uv = _transform_uv(self._accessor(attributes[name], 2, count), transform_uv) * [1, -1] + [0, 1]
        colors = None
        if "COLOR_0" in attributes:
            colors = np.clip(self._accessor(attributes["COLOR_0"], None, count)[:, :3], 0, 1)
            # Exporters often write white beside a texture.
            colors = None if material.image is not None and (colors > 0.999).all() else colors
        normals = self._accessor(attributes["NORMAL"], 3, count) if "NORMAL" in attributes else None
        return MeshPart(vertices, faces, material, uv, colors, normals)

    def _material(self, index: int | None) -> tuple[SurfaceMaterial, dict[str, Any]]:
        """Return a material, and the texture info of its base colour."""
        if index in self.materials:
            return self.materials[index]
        material = self.document["materials"][index]
        surface = material.get("pbrMetallicRoughness", {})
        extensions = material.get("extensions", {})
        gloss = extensions.get(GLOSS)
        # An unlit material is not metal because its factors are absent.
        absent = None if UNLIT in extensions else 1.0
        roughness, metallic = surface.get("roughnessFactor", absent), surface.get("metallicFactor", absent)
        info, color = surface.get("baseColorTexture"), surface.get("baseColorFactor", [1, 1, 1, 1])
        if gloss is not None:
            info, color = gloss.get("diffuseTexture"), gloss.get("diffuseFactor", [1, 1, 1, 1])
            glossiness = gloss.get("glossinessFactor", 1.0)
            if "specularGlossinessTexture" in gloss:
                alpha, _ = self._texture(gloss["specularGlossinessTexture"], "RGBA")
                glossiness *= ImageStat.Stat(alpha).mean[3] / 255
                self.changes["specular and glossiness map replaced by its mean"] += 1
            roughness, metallic = 1 - glossiness, 0.0
        elif "metallicRoughnessTexture" in surface:
            image, _ = self._texture(surface["metallicRoughnessTexture"])
            mean = np.array(ImageStat.Stat(image).mean) / 255
            roughness = (1.0 if roughness is None else roughness) * mean[1]
            metallic = (1.0 if metallic is None else metallic) * mean[2]
            self.changes["roughness and metallic map replaced by its mean"] += 1
        self._note_dropped(material, extensions)
        texture, wrap = self._texture(info) if info is not None else (None, SurfaceMaterial.wrap)
        linear = np.asarray(color[:3], np.float64)
        stated = {"roughness": roughness, "metallic": metallic}
        factors = {name: float(value) for name, value in stated.items() if value is not None}
        if linear.shape != (3,) or not np.isfinite([*linear, *factors.values()]).all():
            raise ObjectFolderError(
                f"{self.path}: material {index} has a colour, roughness or metallic factor that is no "
                "number; export it again"
            )
        made = SurfaceMaterial(texture, np.clip(linear, 0, 1), **factors, wrap=wrap)
        self.materials[index] = made, info or {}
        return self.materials[index]

    def _note_dropped(self, material: dict[str, Any], extensions: dict[str, Any]) -> None:
        for what in ("normal", "occlusion", "emissive"):
            self.changes[f"{what} map left out"] += f"{what}Texture" in material
        emits = any(material.get("emissiveFactor", [])) and "emissiveTexture" not in material
        self.changes["emission left out"] += emits
        transmits = extensions.get(TRANSMISSION, {}).get("transmissionFactor", 0) != 0
        self.changes["transparency left out"] += material.get("alphaMode", "OPAQUE") != "OPAQUE" or transmits
        for name in extensions.keys() - {GLOSS, TRANSMISSION}:
            self.changes[f"{shortened(name)} left out"] += 1

    def _texture(self, info: dict[str, Any], mode: str = "RGB") -> tuple[Image.Image, tuple[str, str]]:
        texture = self.document["textures"][info["index"]]
        source = texture.get("extensions", {}).get("EXT_texture_webp", texture).get("source")
        if source is None:
            kinds = ", ".join(texture.get("extensions", {})) or "none"
            raise ObjectFolderError(
                f"{self.path}: texture {info['index']} has no image that can be read (extensions: {kinds}); "
                "export it with PNG or JPEG textures"
            )
        sampler = self.document["samplers"][texture["sampler"]] if "sampler" in texture else {}
        wrap = (WRAPS[sampler.get("wrapS", 10497)], WRAPS[sampler.get("wrapT", 10497)])
        if (source, mode) not in self.images:
            self.images[source, mode] = self._image(source, mode)
        return self.images[source, mode], wrap

    def _image(self, source: int, mode: str) -> Image.Image:
        image = self.document["images"][source]
        name = image.get("name") or f"image {source}"
        if "bufferView" in image:
            view = self.document["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = self.buffers[view["buffer"]][start : start + view["byteLength"]]
        else:
            data = self._fetch(image["uri"])
            name = name if image["uri"].startswith("data:") else unquote(image["uri"])
        return read_image(data, name, self.path, mode)

    def _buffer(self, buffer: dict[str, Any]) -> bytes:
        data = self._fetch(buffer["uri"]) if "uri" in buffer else self.binary
        if len(data) < buffer["byteLength"]:
            where = buffer.get("uri", "its binary chunk")[:80]
            raise ObjectFolderError(
                f"{self.path} cannot be read as a mesh: {where} holds {len(data)} bytes, expected "
                f"{buffer['byteLength']}: cut off?"
            )
        return data

    def _fetch(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            header, _, content = uri.partition(",")
            return base64.b64decode(content) if header.endswith(";base64") else unquote_to_bytes(content)
        return read_referenced(self.path, unquote(uri))

    def _accessor(self, index: int, width: int | None, expected: int | None = None) -> np.ndarray:
        """Values (count, width) of an accessor; scaled to [-1, 1] if normalized."""
        accessor = self.document["accessors"][index]
        dtype, columns, count = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]], accessor["count"]
        if width not in (None, columns):
            raise ObjectFolderError(f"{self.path}: accessor {index} has {columns} columns, expected {width}")
        if expected not in (None, count):
            raise ObjectFolderError(
                f"{self.path}: accessor {index} has {shortened(count)} values for {expected} vertices; "
                "export the mesh again"
            )
        if "bufferView" in accessor:
            offset = accessor.get("byteOffset", 0)
            values = self._view(accessor["bufferView"], offset, np.dtype(dtype), count, columns)
        elif "sparse" in accessor:
            held = sum(map(len, self.buffers))
            if count > held:
                raise ObjectFolderError(
                    f"{self.path}: accessor {index} has {shortened(count)} values, more than the {held} "
                    "bytes of the file's buffers; export it again"
                )
            values = np.zeros((count, columns), dtype)
        else:
            raise ObjectFolderError(f"{self.path}: accessor {index} has no data; export it uncompressed")
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
        if accessor.get("normalized"):
            result = np.maximum(result / np.iinfo(dtype).max, -1)
        return result

    def _view(self, index: int, offset: int, dtype: np.dtype, count: int, columns: int) -> np.ndarray:
        view = self.document["bufferViews"][index]
        row = dtype.itemsize * columns
        stride = view.get("byteStride") or row
        start = view.get("byteOffset", 0) + offset
        end = start + (count - 1) * stride + row
        if min(offset, count) < 0 or stride < row or end > view.get("byteOffset", 0) + view["byteLength"]:
            raise ObjectFolderError(f"{self.path}: an accessor reaches beyond buffer view {index}: cut off?")
        return np.ndarray(
            (count, columns), dtype, self.buffers[view["buffer"]], start, (stride, dtype.itemsize)
        )


def _move(shape: MeshPart, transform: np.ndarray) -> MeshPart:
    """Place a shape by a matrix (4, 4); one that mirrors reverses the orientation of faces."""
    linear = transform[:3, :3]
    return replace(
        shape,
        vertices=shape.vertices @ linear.T + transform[:3, 3],
        faces=shape.faces[:, ::-1] if np.linalg.det(linear) < 0 else shape.faces,
        normals=None if shape.normals is None else shape.normals @ _of_normals(linear).T,
    )


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == FAN:
        return np.stack([corners[1:-1], corners[2:], np.full(max(len(corners) - 2, 0), corners[0])], 1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip


def _transform(node: dict[str, Any]) -> np.ndarray:
    """Return a node's matrix (4, 4), or its translation x rotation (quaternion x, y, z, w) x scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = _unit(node.get("rotation", (0, 0, 0, 1)))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _unit(rotation: Sequence[float]) -> Sequence[float]:
    """Return a quaternion of length 1; one that has it but for rounding stays as it is."""
    length = math.hypot(*rotation)
    return rotation if abs(length - 1) < ROUNDING or not length else [part / length for part in rotation]


def _of_normals(linear: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) that transforms normals, up to length, when vertices transform by ``linear``.

    It is the inverse transpose times the absolute determinant, from cofactors that also exist if singular.
    """
    x, y, z = linear
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
    return cofactors if np.linalg.det(linear) >= 0 else -cofactors


def _transform_uv(uv: np.ndarray, transform: dict[str, Any]) -> np.ndarray:
    """Apply ``KHR_texture_transform``: scale, rotate counter-clockwise as seen (v points down), move."""
    u, v = (uv * transform.get("scale", (1, 1))).T
    cos, sin = math.cos(transform.get("rotation", 0)), math.sin(transform.get("rotation", 0))
    return np.stack([cos * u + sin * v, cos * v - sin * u], 1) + transform.get("offset", (0, 0))
