"""Read ``.ply`` and ``.stl``."""

import re
from codecs import BOM_UTF8
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.ply import _elements_to_kwargs

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import fan, needs_ears, split
from objectfolder.mesh.reading.files import decode_text, read_image, read_referenced
from objectfolder.mesh.reading.parts import (
    MeshContent,
    MeshPart,
    SurfaceMaterial,
    color_unit,
    split_by_face_color,
)

COLORS, DIFFUSE = ("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue")
INDICES = ("vertex_index", "vertex_indices")
COORDINATES = {"s", "t", "u", "v", "texture_u", "texture_v", "texcoord"}
CARRIERS = ("vertex", "face")  # elements that may have colours
FACET = re.compile(rb"^\s*facet\s+normal\b", re.M | re.I)
MAX_SOLIDS = 4096  # trimesh takes time in proportion to the square of their number


def read_polygons(path: Path) -> MeshContent:
    """Read a ``.ply`` or ``.stl``; colours are interpreted as sRGB.

    Raises
    ------
    ObjectFolderError
        If the texture that a ``.ply`` names is missing or unreadable, or it names several.
    """
    kind = path.suffix.lower().removeprefix(".")
    data, textures, image = path.read_bytes(), [], None
    if kind == "ply":
        header, end, body = data.partition(b"end_header")
        data = decode_text(header).encode() + end + body
        textures = ply_textures(data)
        _check_textures(path, textures)
    else:
        _check_solids(path, data)
        _check_length(path, data)
    if textures:
        image = read_image(read_referenced(path, textures[0]), path.parent / textures[0], path)
    # Without materials: trimesh would open images of every format, and swallow errors.
    scene: Any = trimesh.load_scene(BytesIO(data), file_type=kind, skip_materials=True, process=False)
    sources = list(scene.geometry.values())
    elements = sources[0].metadata.get("_ply_raw", {}) if len(sources) == 1 else {}
    amended = _amend(elements, textured=bool(textures))
    if amended or (textures and elements):
        elements = amended or elements
        mesh = trimesh.Trimesh(**_elements_to_kwargs(elements, fix_texture=True, image=image), process=False)
        sources = [mesh]
    else:
        mesh = scene.to_mesh()
    if kind == "stl":
        _check_facets(path, data, len(mesh.faces))
    visual: Any = mesh.visual
    vertices, faces = _as_points(mesh.vertices), _fan_triangles(mesh.faces)
    normals = None
    if len(sources) == 1:
        (source,) = sources
        # In the cache only if the file holds them; trimesh computes others on access.
        normals = _as_points(source.vertex_normals) if "vertex_normals" in source._cache else None
    colored = _count_colored(elements)
    if visual.kind == "texture":
        uv = np.asarray(visual.uv, np.float64)
        notes = ["vertex colours beside a texture left out"] if colored else []
        return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(image), uv, normals=normals)], notes)
    colors: np.ndarray | None = None
    notes = ["colours of faces beside those of vertices left out"] if colored > 1 else []
    if textures:
        notes.append("texture left out: the file has no texture coordinates")
    if visual.kind == "face":
        colors, vertex, faces = split_by_face_color(np.asarray(visual.face_colors), faces)
        vertices, normals = vertices[vertex], None if normals is None else normals[vertex]
    elif visual.kind == "vertex":
        colors = np.asarray(visual.vertex_colors)
    linear = None if colors is None else srgb.decode(colors[:, :3] / 255)
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(), None, linear, normals)], notes)


def ply_textures(data: bytes) -> list[str]:
    """Return the textures named in the header of a ``.ply``, in order."""
    header = decode_text(data.partition(b"end_header")[0])
    names = re.findall(r"^(?:comment|obj_info)\b.*?texturefile(.*)", header, re.MULTILINE | re.I)
    return list(dict.fromkeys(name.strip() for name in names))


def _as_points(values: Any) -> np.ndarray:
    """Return positions or normals as (V, 3) float64."""
    return np.asarray(values, np.float64).reshape(-1, 3)


def _fan_triangles(values: Any) -> np.ndarray:
    """Split polygons (P, n) into triangle fans; (F, 3)."""
    polygons = np.asarray(values, np.int64)
    return polygons[:, fan(polygons.shape[1])].reshape(-1, 3)


def _check_textures(path: Path, names: list[str]) -> None:
    if len(names) > 1:  # trimesh would put the last one on all faces
        raise ObjectFolderError(
            f"{path} names {len(names)} textures ({shortened(', '.join(names))}), expected at most one; "
            "export it as .obj or .glb, which tell the faces of each, or bake them into one"
        )


def _check_solids(path: Path, data: bytes) -> None:
    count = data.lower().count(b"endsolid") if data[:5].lower() == b"solid" else 0  # of an ASCII .stl
    if count > MAX_SOLIDS:
        raise ObjectFolderError(f"{path} holds {count} solids, expected at most {MAX_SOLIDS}; join them")


def _check_length(path: Path, data: bytes) -> None:
    """Raise for a binary ``.stl`` that breaks off; trimesh would take it for text."""
    count = int.from_bytes(data[80:84], "little")
    text = data[:80].removeprefix(BOM_UTF8).lstrip().lower().startswith(b"solid")
    if not text and len(data) < 84 + 50 * count:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it has {len(data)} bytes, expected {84 + 50 * count} of "
            f"{count} triangles: cut off?"
        )


def _check_facets(path: Path, data: bytes, count: int) -> None:
    """Raise for an ASCII ``.stl`` of which trimesh left out solids that break off."""
    facets = len(FACET.findall(data)) if _is_text(data) else 0
    if facets > count:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it begins {facets} triangles, of which {count} are complete, "
            "in solids with an end: cut off?"
        )


def _is_text(data: bytes) -> bool:
    """Whether an ``.stl`` begins as ASCII, and has no zero, as binary counts of triangles do."""
    return data[:80].removeprefix(BOM_UTF8).lstrip().lower().startswith(b"solid") and b"\0" not in data


def _amend(elements: dict[str, Any], textured: bool) -> dict[str, Any] | None:
    """Return the elements of a ``.ply`` with what trimesh misreads put right; None if it misreads nothing.

    Without a texture, it would put a default one at texture coordinates, in place of vertex colours.
    """
    columns = {
        name: _columns(elements[name]) for name in CARRIERS if elements.get(name, {}).get("data") is not None
    }
    amended = {name: made for name, values in columns.items() if (made := _byte_colors(values))}
    if {"vertex", "face"} <= columns.keys():
        faces = _split_faces(columns["vertex"], amended.get("face", columns["face"]))
        amended |= {"face": faces} if faces else {}
    if not textured:
        for name, values in columns.items():
            held = amended.get(name, values)
            if held.keys() & COORDINATES:
                amended[name] = {key: column for key, column in held.items() if key not in COORDINATES}
    if not amended:
        return None
    return elements | {
        name: elements[name] | {"data": values, "properties": dict.fromkeys(values)}
        for name, values in amended.items()
    }


def _columns(element: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return the properties of an element; lists are (N, n), or (N,) of arrays if their lengths differ."""
    data = element["data"]
    held = data if isinstance(data, dict) else data.dtype.names or ()
    names = [name for name in element["properties"] if name in held]
    return {name: data[name]["f1"] if data[name].dtype.names else data[name] for name in names}


def _byte_colors(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """Rename colours that trimesh does not know, and bring its unknown ranges to bytes; None if none is so.

    It knows integers of 8 bits, and fractions up to 1.
    """
    names = [name for name in (COLORS, DIFFUSE) if set(name) <= columns.keys()]
    if not names:
        return None
    colors = np.stack([columns[name].ravel() for name in names[0]])
    whole, brightest = colors.dtype.kind in "iu", colors.max(initial=0)
    amended = brightest > 255 if whole else color_unit(brightest) == 255
    if names[0] == COLORS and not amended:
        return None
    if amended:
        colors = np.rint(np.clip(colors / (257 if whole else 1), 0, 255)).astype(np.uint8)
    return {name: values for name, values in columns.items() if name != "alpha"} | dict(zip(COLORS, colors))


def _count_colored(elements: dict[str, Any]) -> int:
    """Count which of vertices and faces have colours, 0 to 2."""
    held = [elements[name]["properties"].keys() for name in CARRIERS if name in elements]
    return sum(set(COLORS) <= names for names in held)


def _split_faces(vertex: dict[str, np.ndarray], face: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """Split polygons into triangles if trimesh's fans leave one or lose their colours; None otherwise."""
    name = next((name for name in INDICES if name in face), None)
    if name is None or not set("xyz") <= vertex.keys():
        return None
    points = np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64)
    sizes = np.array([len(polygon) for polygon in face[name]])
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes[sizes > 2])]
    polygons = [np.stack(list(face[name][rows])).astype(np.int64) for rows in groups]
    corners = [points[np.clip(group, 0, len(points) - 1)] for group in polygons]
    colored = set(COLORS) <= face.keys() and sizes.max(initial=0) > 3
    if not colored and not any(needs_ears(group).any() for group in corners):
        return None
    made: dict[str, list[np.ndarray]] = {key: [] for key in face}
    for rows, group, places in zip(groups, polygons, corners):
        triangles = split(places)
        count, size = group.shape
        for key, values in face.items():
            chosen = np.stack(list(values[rows]))
            if key == name:
                new = np.take_along_axis(group[:, None], triangles, 2).reshape(-1, 3)
            elif chosen.shape == (count, 2 * size):  # coordinates of each corner
                pairs = chosen.reshape(count, 1, size, 2)
                new = np.take_along_axis(pairs, triangles[..., None], 2).reshape(-1, 6)
            else:
                new = np.repeat(chosen, size - 2, 0)
            made[key].append(new)
    return {key: np.concatenate(values) for key, values in made.items()}
