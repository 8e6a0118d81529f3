"""Read Wavefront ``.obj`` with its ``.mtl`` material libraries and textures."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.obj import load_obj

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.files import read_referenced
from objectfolder.mesh.reading.from_trimesh import (
    ReferencedFiles,
    as_points,
    fan_triangles,
    surface_material,
)
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial


def read_obj(path: Path) -> MeshContent:
    """Read a Wavefront ``.obj`` with its material libraries and colour textures.

    Colours (``Kd`` and per-vertex colours) are interpreted as sRGB. A texture replaces ``Kd`` and vertex
    colours, as exporters intend.

    Raises
    ------
    ObjectFolderError
        If a file it refers to is missing or unreadable, or a face index is out of range.
    """
    data = path.read_bytes()
    text = data.decode(errors="replace")
    _check_indices(path, text)
    files = _ObjFiles(path, mtl_names(text))
    geometry = load_obj(BytesIO(data), resolver=files).get("geometry", {}).values()
    files.check()
    materials: dict[int, SurfaceMaterial] = {}
    parts, notes = [], []
    for content in geometry:
        visual, colors = content.get("visual"), content.get("vertex_colors")
        source = getattr(visual, "material", None)
        if id(source) not in materials:
            materials[id(source)] = surface_material(source)
        material = materials[id(source)]
        colors = None if colors is None else srgb.decode(_unit_range(colors)[:, :3])
        if colors is not None and material.image is not None:
            notes.append("vertex colours beside a texture left out")
            colors = None
        if colors is not None:
            material = SurfaceMaterial()
        uv = None if visual is None or visual.uv is None else np.asarray(visual.uv, np.float64)[:, :2]
        vertices, faces = as_points(content["vertices"]), fan_triangles(content["faces"])
        normals = content.get("vertex_normals")
        parts.append(
            MeshPart(vertices, faces, material, uv, colors, None if normals is None else as_points(normals))
        )
    used = dict.fromkeys(re.findall(r"^usemtl[ \t]+(.+?)\s*$", text, re.MULTILINE))
    missing = [name for name in used if name not in files.materials]
    if missing:
        notes.append(f"material {', '.join(missing[:5])} is not defined: its faces have no colour")
    return MeshContent(parts, notes)


def mtl_names(obj: str) -> list[str]:
    """Return the material libraries named in the text of an ``.obj``, in order; names may contain spaces."""
    lines = re.findall(r"^mtllib[ \t]+(.+?)\s*$", obj, re.MULTILINE)
    names = [name for line in lines for name in re.findall(r"\S.*?\.mtl(?=\s|$)", line, re.I) or [line]]
    return list(dict.fromkeys(names))


def textures(mtl: str) -> list[tuple[str, str]]:
    """Return the maps in the text of an ``.mtl``: statement, such as ``map_Kd``, and file name."""
    # Options such as `-s 1 1 1` precede the name.
    option = r"^(-\w+(\s+(-?[\d.]+|on|off))*\s+)*"
    maps = re.findall(r"^\s*(map_\w+|bump|disp|decal|norm)\s+(.+?)\s*$", mtl, re.MULTILINE | re.I)
    return [(statement, re.sub(option, "", name)) for statement, name in maps]


class _ObjFiles(ReferencedFiles):
    """Images and material libraries of an ``.obj``."""

    def __init__(self, path: Path, libraries: list[str]):
        super().__init__(path)
        self.libraries: list[str] | None = libraries
        self.materials: list[str] = []

    def read(self, key: str) -> bytes:
        if self.libraries is None:
            return super().read(key)
        # trimesh asks for the first library only, before any image: give it all of them.
        libraries, self.libraries = self.libraries, None
        text = "\n".join(read_referenced(self.path, name).decode(errors="replace") for name in libraries)
        self.materials = re.findall(r"^\s*newmtl[ \t]+(.+?)\s*$", text, re.MULTILINE)
        return re.sub(r"^\s*map_Kd\s.*$", _without_options, text, flags=re.MULTILINE | re.I).encode()


def _without_options(statement: re.Match[str]) -> str:
    return "map_Kd " + textures(statement[0])[0][1]


def _check_indices(path: Path, text: str) -> None:
    """Raise for face indices that trimesh misinterprets."""
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


def _unit_range(colors: Any) -> np.ndarray:
    return np.clip(
        np.asarray(colors, np.float64) / (255 if np.asarray(colors).max(initial=0) > 1 else 1), 0, 1
    )
