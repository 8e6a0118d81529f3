"""Read ``.obj``, ``.ply``, ``.stl`` and ``.off`` with trimesh, and what they refer to."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from trimesh.exchange.obj import load_obj
from trimesh.resolvers import Resolver

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.part import Material, Part, Parts, read_image, read_referenced
from objectfolder.mesh.reading.references import mtl_names, textures


def read_obj(path: Path) -> Parts:
    """Read a Wavefront ``.obj`` with its material libraries and colour textures.

    Colours (``Kd`` and those that follow a vertex) are taken as sRGB. A texture replaces ``Kd`` and vertex
    colours, as exporters mean it.

    Raises
    ------
    ObjectFolderError
        If a file that it refers to is missing or unreadable, or a face index is out of range.
    """
    data = path.read_bytes()
    text = data.decode(errors="replace")
    _check_indices(path, text)
    files = _Files(path, mtl_names(text))
    geometry = load_obj(BytesIO(data), resolver=files).get("geometry", {}).values()
    files.check()
    materials: dict[int, Material] = {}
    parts, notes = [], []
    for content in geometry:
        visual, colors = content.get("visual"), content.get("vertex_colors")
        source = getattr(visual, "material", None)
        if id(source) not in materials:
            materials[id(source)] = _material(source)
        material = materials[id(source)]
        colors = None if colors is None else srgb.decode(_unit(colors)[:, :3])
        if colors is not None and material.image is not None:
            notes.append("vertex colours beside a texture left out")
            colors = None
        if colors is not None:
            material = Material()
        uv = None if visual is None or visual.uv is None else np.asarray(visual.uv, np.float64)[:, :2]
        vertices, faces = _vertices(content["vertices"]), _triangles(content["faces"])
        normals = content.get("vertex_normals")
        parts.append(
            Part(vertices, faces, material, uv, colors, None if normals is None else _vertices(normals))
        )
    used = dict.fromkeys(re.findall(r"^usemtl[ \t]+(.+?)\s*$", text, re.MULTILINE))
    missing = [name for name in used if name not in files.materials]
    if missing:
        notes.append(f"material {', '.join(missing[:5])} is not defined: its faces have no colour")
    return Parts(parts, notes)


def read_polygons(path: Path) -> Parts:
    """Read a ``.ply``, ``.stl`` or ``.off``; colours are taken as sRGB.

    Raises
    ------
    ObjectFolderError
        If the texture that a ``.ply`` names is missing or unreadable.
    """
    files = _Files(path)
    kind = path.suffix.lower().removeprefix(".")
    with path.open("rb") as stream:
        scene: Any = trimesh.load_scene(stream, file_type=kind, resolver=files, process=False)
    files.check()
    mesh = scene.to_mesh()
    visual = mesh.visual
    vertices, faces = _vertices(mesh.vertices), _triangles(mesh.faces)
    normals = None
    if len(scene.geometry) == 1:
        (source,) = scene.geometry.values()
        # What a file does not hold, trimesh computes only when asked.
        normals = _vertices(source.vertex_normals) if "vertex_normals" in source._cache else None
    if visual.kind == "texture":
        material = _material(visual.material)
        uv = None if visual.uv is None else np.asarray(visual.uv, np.float64)
        return Parts([Part(vertices, faces, material, uv, normals=normals)])
    colors: np.ndarray | None = None
    if visual.kind == "face":
        colors, vertex, faces = _split(np.asarray(visual.face_colors), faces)
        vertices, normals = vertices[vertex], None if normals is None else normals[vertex]
    elif visual.kind == "vertex":
        colors = np.asarray(visual.vertex_colors)
    linear = None if colors is None else srgb.decode(colors[:, :3] / 255)
    return Parts([Part(vertices, faces, Material(), None, linear, normals)])


class _Files(Resolver):
    """Gives trimesh the files that a mesh refers to; remembers what failed, which trimesh passes over."""

    def __init__(self, path: Path, libraries: list[str] | None = None):
        self.path = path
        self.libraries = libraries
        self.materials: list[str] = []
        self.error: ObjectFolderError | None = None

    def get(self, key: str) -> bytes:
        try:
            if self.libraries is not None:  # trimesh asks for one first, but it gets all
                libraries, self.libraries = self.libraries, None
                text = "\n".join(
                    read_referenced(self.path, name).decode(errors="replace") for name in libraries
                )
                self.materials = re.findall(r"^\s*newmtl[ \t]+(.+?)\s*$", text, re.MULTILINE)
                return re.sub(r"^\s*map_Kd\s.*$", _without_options, text, flags=re.MULTILINE | re.I).encode()
            data = read_referenced(self.path, key)
            read_image(data, self.path.parent / key, self.path)
            return data
        except ObjectFolderError as error:
            self.error = self.error or error
            raise

    def check(self) -> None:
        """Raise the first error that a file gave."""
        if self.error is not None:
            raise self.error

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> Any:
        raise NotImplementedError

    def keys(self) -> list[str]:
        return []


def _without_options(statement: re.Match[str]) -> str:
    return "map_Kd " + textures(statement[0])[0][1]


def _check_indices(path: Path, text: str) -> None:
    """Raise for face indices that trimesh takes otherwise than the format means them."""
    faces = "\n".join(re.findall(r"^f\s.*", text, re.MULTILINE))
    zero = re.search(r"[\s/]0+(?=[/\s]|$)", faces)
    if zero:
        line = faces[faces.rfind("\nf", 0, zero.end()) + 1 :].partition("\n")[0].strip()
        raise ObjectFolderError(f"{path}: {line[:60]!r} has the index 0, but .obj counts from 1")
    relative = re.search(r"^f\s[^\n-]*-\d", text, re.MULTILINE) if "-" in faces else None
    if relative and re.search(r"^v\s", text[relative.start() :], re.MULTILINE):
        raise ObjectFolderError(
            f"{path}: negative face indices among the vertices are not supported; export it again"
        )


def _material(source: Any) -> Material:
    """Material of a trimesh one; colours there are sRGB."""
    if source is None:
        return Material()
    image: Image.Image | None = getattr(source, "image", None) or getattr(source, "baseColorTexture", None)
    if image is not None:
        return Material(image.convert("RGB"))
    return Material(color=srgb.decode(np.asarray(source.main_color[:3]) / 255))


def _unit(colors: Any) -> np.ndarray:
    return np.clip(
        np.asarray(colors, np.float64) / (255 if np.asarray(colors).max(initial=0) > 1 else 1), 0, 1
    )


def _vertices(values: Any) -> np.ndarray:
    return np.asarray(values, np.float64).reshape(-1, 3)


def _triangles(values: Any) -> np.ndarray:
    """Triangles (F, 3) of polygons (P, n), as fans."""
    polygons = np.asarray(values, np.int64)
    corner = np.arange(1, polygons.shape[1] - 1)
    fans = np.stack([np.zeros_like(corner), corner, corner + 1], 1)
    return polygons[:, fans].reshape(-1, 3)


def _split(colors: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give every colour its own vertices: colours (V', 3), whose copies (V',) they are, faces (F, 3)."""
    palette, color = np.unique(colors, axis=0, return_inverse=True)
    corner = faces * len(palette) + color.reshape(-1, 1)
    kept, renumbered = np.unique(corner, return_inverse=True)
    return palette[kept % len(palette)], kept // len(palette), renumbered.reshape(-1, 3)
