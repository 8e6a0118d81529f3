"""Read Wavefront ``.obj`` with its ``.mtl`` material libraries and textures."""

import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.obj import load_obj

from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.files import read_referenced
from objectfolder.mesh.reading.from_trimesh import (
    ReferencedFiles,
    as_points,
    fan_triangles,
    surface_material,
)
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial

MAP = re.compile(r"map_\w+|bump|disp|decal|norm", re.I)
# Options such as `-s 1 1 1`, which precede a file name. Possessive, so that nothing is tried twice.
OPTIONS = re.compile(r"^(?:-\w++(?:\s++(?:-?[\d.]++|on|off)(?=\s))*+\s++)*+")
MAX_MATERIALS = 4096  # trimesh takes time in proportion to the square of their number


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
    text = _joined(data.decode(errors="replace"))
    _check_indices(path, text)
    _check_materials(path, text)
    files = _ObjFiles(path, mtl_names(text))
    geometry = load_obj(BytesIO(data), resolver=files).get("geometry", {}).values()
    files.check()
    materials: dict[int, SurfaceMaterial] = {}
    parts, notes = [], []
    for content in geometry:
        visual, colors = content.get("visual"), content.get("vertex_colors")
        source = getattr(visual, "material", None)
        if id(source) not in materials:
            materials[id(source)] = surface_material(source, files.images)
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
    used = dict.fromkeys(name.strip() for name in re.findall(r"^usemtl[ \t](.*)", text, re.MULTILINE))
    missing = [shortened(name) for name in used if name and name not in files.materials]
    if missing:
        notes.append(f"material {', '.join(missing[:5])} is not defined: its faces have no colour")
    return MeshContent(parts, notes)


def mtl_names(obj: str) -> list[str]:
    """Return the material libraries named in the text of an ``.obj``, in order; names may contain spaces."""
    lines = [line.strip() for line in re.findall(r"^mtllib[ \t](.*)", _joined(obj), re.MULTILINE)]
    names = [name for line in lines if line for name in _libraries(line)]
    return list(dict.fromkeys(names))


def _libraries(line: str) -> list[str]:
    names = re.split(r"(?<=\.mtl)\s+", line, flags=re.I)
    return [name for name in names if name.lower().endswith(".mtl")] or [line]


def textures(mtl: str) -> list[tuple[str, str]]:
    """Return the maps in the text of an ``.mtl``: statement, such as ``map_Kd``, and file name."""
    return [(keyword, OPTIONS.sub("", rest)) for keyword, rest in _statements(mtl) if MAP.fullmatch(keyword)]


def _joined(obj: str) -> str:
    """Join continued lines, as trimesh does."""
    return obj.replace("\r\n", "\n").replace("\\\n", "")


def _statements(mtl: str) -> Iterator[tuple[str, str]]:
    """Yield the first word and the rest of every line that has more than one word."""
    for line in mtl.splitlines():
        words = line.strip().split(maxsplit=1)
        if len(words) == 2:
            yield words[0], words[1]


class _ObjFiles(ReferencedFiles):
    """Images and material libraries of an ``.obj``."""

    def __init__(self, path: Path, libraries: list[str]):
        super().__init__(path)
        self.libraries: list[str] | None = libraries
        self.materials: set[str] = set()

    def read(self, key: str) -> bytes:
        if self.libraries is None:
            return super().read(key)
        # trimesh asks for the first library only, before any image: give it all of them.
        libraries, self.libraries = self.libraries, None
        text = "\n".join(read_referenced(self.path, name).decode(errors="replace") for name in libraries)
        statements = list(_statements(text))
        named = [rest for keyword, rest in statements if keyword.lower() == "newmtl"]
        self.materials = {" ".join(name.split()) for name in named}
        lines = (
            f"{keyword} {OPTIONS.sub('', rest) if keyword.lower() == 'map_kd' else rest}"
            for keyword, rest in statements
        )
        return "\n".join(lines).encode()


def _check_materials(path: Path, text: str) -> None:
    count = len(set(re.findall("usemtl (.*)", text)))  # as trimesh finds them
    if count > MAX_MATERIALS:
        raise ObjectFolderError(
            f"{path} uses {count} materials, expected at most {MAX_MATERIALS}; join them, such as by baking "
            "them into one texture"
        )


def _check_indices(path: Path, text: str) -> None:
    """Raise for face indices that trimesh misinterprets."""
    faces = "\n".join(re.findall(r"^f\s.*", text, re.MULTILINE))
    zero = re.search(r"[\s/]0+(?=[/\s]|$)", faces)
    if zero:
        line = faces[faces.rfind("\nf", 0, zero.end()) + 1 :].partition("\n")[0].strip()
        raise ObjectFolderError(f"{path}: {shortened(line)!r} has the index 0, but .obj counts from 1")
    relative = re.search(r"^f\s[^\n-]*-\d", text, re.MULTILINE) if "-" in faces else None
    if relative and re.search(r"^v\s", text[relative.start() :], re.MULTILINE):
        raise ObjectFolderError(
            f"{path}: negative face indices among the vertices are not supported; export it again"
        )


def _unit_range(colors: Any) -> np.ndarray:
    return np.clip(
        np.asarray(colors, np.float64) / (255 if np.asarray(colors).max(initial=0) > 1 else 1), 0, 1
    )
