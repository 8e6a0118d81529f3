"""Read ``.ply``, ``.stl`` and ``.off``."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.from_trimesh import (
    ReferencedFiles,
    as_points,
    fan_triangles,
    surface_material,
)
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial

MAX_SOLIDS = 4096  # trimesh takes time in proportion to the square of their number


def read_polygons(path: Path) -> MeshContent:
    """Read a ``.ply``, ``.stl`` or ``.off``; colours are interpreted as sRGB.

    Raises
    ------
    ObjectFolderError
        If the texture that a ``.ply`` names is missing or unreadable.
    """
    files = ReferencedFiles(path)
    kind = path.suffix.lower().removeprefix(".")
    data = path.read_bytes()
    _check_solids(path, data)
    scene: Any = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=files, process=False)
    files.check()
    mesh = scene.to_mesh()
    visual = mesh.visual
    vertices, faces = as_points(mesh.vertices), fan_triangles(mesh.faces)
    normals = None
    if len(scene.geometry) == 1:
        (source,) = scene.geometry.values()
        # In the cache only if the file holds them; trimesh computes others on access.
        normals = as_points(source.vertex_normals) if "vertex_normals" in source._cache else None
    if visual.kind == "texture":
        material = surface_material(visual.material, files.images)
        uv = None if visual.uv is None else np.asarray(visual.uv, np.float64)
        return MeshContent([MeshPart(vertices, faces, material, uv, normals=normals)])
    colors: np.ndarray | None = None
    if visual.kind == "face":
        colors, vertex, faces = _split(np.asarray(visual.face_colors), faces)
        vertices, normals = vertices[vertex], None if normals is None else normals[vertex]
    elif visual.kind == "vertex":
        colors = np.asarray(visual.vertex_colors)
    linear = None if colors is None else srgb.decode(colors[:, :3] / 255)
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(), None, linear, normals)])


def _check_solids(path: Path, data: bytes) -> None:
    count = data.lower().count(b"endsolid") if data[:5].lower() == b"solid" else 0  # of an ASCII .stl
    if count > MAX_SOLIDS:
        raise ObjectFolderError(f"{path} holds {count} solids, expected at most {MAX_SOLIDS}; join them")


def _split(colors: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Duplicate vertices by face colour; return colours (V', 3), original vertices (V',), faces (F, 3)."""
    palette, color = np.unique(colors, axis=0, return_inverse=True)
    corner = faces * len(palette) + color.reshape(-1, 1)
    kept, renumbered = np.unique(corner, return_inverse=True)
    return palette[kept % len(palette)], kept // len(palette), renumbered.reshape(-1, 3)
