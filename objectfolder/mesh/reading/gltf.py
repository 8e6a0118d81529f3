"""Read glTF 2.0 (Khronos, 2021): triangles with base colour, roughness and metallic, in scene space."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageStat

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh.reading.gltffile import DRACO, REMEDIES, GltfFile, file_name, is_data, read_document
from objectfolder.mesh.reading.gltfscene import Influences, bend, move, place_meshes
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial

GLOSS, TRANSMISSION = "KHR_materials_pbrSpecularGlossiness", "KHR_materials_transmission"
UNLIT = "KHR_materials_unlit"
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
NEAREST = 9728
TRIANGLES, STRIP, FAN = 4, 5, 6
READ_ATTRIBUTES = ("POSITION", "NORMAL", "TANGENT", "COLOR_0", "TEXCOORD_", "JOINTS_", "WEIGHTS_")
MAX_SETS = 16  # of four joints that move a vertex
MAX_ELEMENTS = 50_000_000  # vertices and corners of faces; nodes may repeat a mesh


def read_gltf(path: Path) -> MeshContent:
    """Read the default scene of a ``.gltf`` or ``.glb``, with skins and morph targets at rest.

    Base colour textures (with ``KHR_texture_transform``), factors, vertex colours, roughness and metallic
    are kept; a map of roughness and metallic, or of glossiness, is reduced to its mean. What else the file
    holds is listed in notes.

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
        return _Reader(GltfFile(path)).read()


def uris(path: Path) -> list[str]:
    """Return the paths of the files that a valid glTF file refers to, as it names them."""
    with _valid(path):
        document, _ = read_document(path)
        items = [*document.get("buffers", []), *document.get("images", [])]
        found = [item["uri"] for item in items if item.get("uri")]
        return [file_name(path, uri) for uri in found if not is_data(uri)]


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


class _Reader:
    """glTF file with the materials and images read so far."""

    def __init__(self, file: GltfFile):
        self.file, self.path, self.left_out = file, file.path, file.left_out
        self.document = file.document
        self.materials: dict[int | None, tuple[SurfaceMaterial, dict[str, Any]]] = {
            None: (SurfaceMaterial(), {})
        }
        self.images: dict[tuple[int, str], Image.Image] = {}

    def read(self) -> MeshContent:
        placed, notes = place_meshes(self.file)
        parts: list[MeshPart] = []
        meshes: dict[Any, list[tuple[MeshPart, Influences | None]]] = {}
        elements = 0
        for one in placed:
            key = one.mesh, one.weights, one.joints is not None
            if key not in meshes:
                meshes[key] = self._shapes(*key)
            elements += len(one.transforms) * sum(
                len(shape.vertices) + shape.faces.size for shape, _ in meshes[key]
            )
            self._check_size(elements)
            for shape, influences in meshes[key]:
                if one.joints is not None and influences is not None:
                    parts.append(bend(shape, influences, one.joints))
                else:
                    self.left_out["skin without weights left out"] += one.joints is not None
                    parts += [move(shape, transform) for transform in one.transforms]
        # What nodes or primitives refer to is noted with them.
        unnoted = self.document.get("extensions", {}).keys() - self.file.noted
        self.file.note_extensions({"extensions": dict.fromkeys(unnoted)})
        notes += [f"{what} ({n})" for what, n in sorted(self.left_out.items()) if n]
        return MeshContent(parts, notes)

    def _check_size(self, elements: int) -> None:
        if elements > MAX_ELEMENTS:
            raise ObjectFolderError(
                f"{self.path} holds more than {MAX_ELEMENTS} vertices and corners of faces, with meshes that "
                "its nodes repeat; simplify it"
            )

    def _shapes(
        self, mesh: int, morphs: tuple[float, ...], skinned: bool
    ) -> list[tuple[MeshPart, Influences | None]]:
        """Return the primitives of a mesh, in its own frame, and if it is skinned the joints of each."""
        shapes: list[tuple[MeshPart, Influences | None]] = []
        for primitive in self.document["meshes"][mesh]["primitives"]:
            self.file.note_extensions(primitive, {DRACO})
            if primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN):
                self.left_out["points or lines left out"] += 1
            elif "POSITION" not in primitive.get("attributes", {}):
                self.left_out["faces without positions left out"] += 1
            else:
                influences = self._influences(primitive) if skinned else None
                shapes.append((self._shape(primitive, morphs), influences))
                self._check_size(sum(len(shape.vertices) + shape.faces.size for shape, _ in shapes))
        return shapes

    def _shape(self, primitive: dict[str, Any], morphs: tuple[float, ...]) -> MeshPart:
        attributes = primitive["attributes"]
        if DRACO in primitive.get("extensions", {}) and self._is_empty(attributes["POSITION"]):
            raise ObjectFolderError(f"{self.path} is compressed with {DRACO}; {REMEDIES[DRACO]}")
        for name in attributes:
            self.left_out[f"attribute {shortened(name)} left out"] += not name.startswith(READ_ATTRIBUTES)
        vertices = self._attribute(primitive, "POSITION", 3, morphs)
        count = len(vertices)
        corners = np.arange(count)
        if "indices" in primitive:
            corners = self.file.accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
        mode = primitive.get("mode", TRIANGLES)
        self.left_out["corners of no whole triangle left out"] += len(corners) % 3 if mode == TRIANGLES else 0
        faces = _triangles(corners, mode)
        material, texture = self._material(primitive.get("material"))
        uv = None
        transform_uv = texture.get("extensions", {}).get("KHR_texture_transform", {})
        name = f"TEXCOORD_{transform_uv.get('texCoord', texture.get('texCoord', 0))}"
        if material.image is not None and name in attributes:
            uv = self._attribute(primitive, name, 2, morphs, count)
            uv = _transform_uv(uv, transform_uv) * [1, -1] + [0, 1]
        colors = None
        if "COLOR_0" in attributes:
            colors = np.clip(self._attribute(primitive, "COLOR_0", None, morphs, count)[:, :3], 0, 1)
            # Exporters often write white beside a texture.
            colors = None if material.image is not None and (colors > 0.999).all() else colors
        normals = self._attribute(primitive, "NORMAL", 3, morphs, count) if "NORMAL" in attributes else None
        return MeshPart(vertices, faces, material, uv, colors, normals)

    def _attribute(
        self,
        primitive: dict[str, Any],
        name: str,
        width: int | None,
        morphs: tuple[float, ...],
        expected: int | None = None,
    ) -> np.ndarray:
        """Return an attribute (V, width), with the morph targets at their weights."""
        # Colours of integers are fractions, also where an exporter forgot to say so.
        fractions = name == "COLOR_0"
        values = self.file.accessor(primitive["attributes"][name], width, expected, fractions)
        for weight, target in zip(morphs, primitive.get("targets", [])):
            if weight and name in target:
                values = values + weight * self.file.accessor(
                    target[name], values.shape[1], len(values), fractions
                )
        return values

    def _influences(self, primitive: dict[str, Any]) -> Influences | None:
        attributes = primitive["attributes"]
        sets = [n for n in range(len(attributes)) if {f"JOINTS_{n}", f"WEIGHTS_{n}"} <= attributes.keys()]
        if not sets:
            return None
        if len(sets) > MAX_SETS:
            raise ObjectFolderError(
                f"{self.path}: a mesh has {len(sets)} sets of joints, expected at most {MAX_SETS}; export it "
                "again"
            )
        joints, weights = (
            np.hstack([self.file.accessor(attributes[f"{name}_{n}"], 4) for n in sets])
            for name in ("JOINTS", "WEIGHTS")
        )
        return Influences(joints.astype(np.int64), weights)

    def _is_empty(self, accessor: int) -> bool:
        """Whether an accessor has no data of its own."""
        return not {"bufferView", "sparse"} & self.document["accessors"][accessor].keys()

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
                self.left_out["specular and glossiness map replaced by its mean"] += 1
            roughness, metallic = 1 - glossiness, 0.0
        elif "metallicRoughnessTexture" in surface:
            image, _ = self._texture(surface["metallicRoughnessTexture"])
            mean = np.array(ImageStat.Stat(image).mean) / 255
            roughness = (1.0 if roughness is None else roughness) * mean[1]
            metallic = (1.0 if metallic is None else metallic) * mean[2]
            self.left_out["roughness and metallic map replaced by its mean"] += 1
        self._note_dropped(material)
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

    def _note_dropped(self, material: dict[str, Any]) -> None:
        extensions = material.get("extensions", {})
        for what in ("normal", "occlusion", "emissive"):
            self.left_out[f"{what} map left out"] += f"{what}Texture" in material
        emits = any(material.get("emissiveFactor", [])) and "emissiveTexture" not in material
        self.left_out["emission left out"] += emits
        transmits = extensions.get(TRANSMISSION, {}).get("transmissionFactor", 0) != 0
        self.left_out["transparency left out"] += material.get("alphaMode", "OPAQUE") != "OPAQUE" or transmits
        self.left_out["specular colour left out"] += "specularFactor" in extensions.get(GLOSS, {})
        self.file.note_extensions(material, {GLOSS, TRANSMISSION})

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
        self.left_out["filter without interpolation left out"] += sampler.get("magFilter") == NEAREST
        if (source, mode) not in self.images:
            self.images[source, mode] = self.file.image(source, mode)
        return self.images[source, mode], wrap


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode == FAN:
        return np.stack([corners[1:-1], corners[2:], np.repeat(corners[:1], max(len(corners) - 2, 0))], 1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip


def _transform_uv(uv: np.ndarray, transform: dict[str, Any]) -> np.ndarray:
    """Apply ``KHR_texture_transform``: scale, rotate counter-clockwise as seen (v points down), move."""
    u, v = (uv * transform.get("scale", (1, 1))).T
    cos, sin = math.cos(transform.get("rotation", 0)), math.sin(transform.get("rotation", 0))
    return np.stack([cos * u + sin * v, cos * v - sin * u], 1) + transform.get("offset", (0, 0))
