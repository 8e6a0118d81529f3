"""Read Wavefront ``.obj`` with its ``.mtl`` material libraries and textures."""

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from trimesh.visual.texture import unmerge_faces

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import split_loops
from objectfolder.mesh.reading.mtl import MaterialLibraries, MtlMaterial, strip_comment
from objectfolder.mesh.reading.objlines import COORDINATE, NORMAL, NOT_NUMBERS, VERTEX, ObjLines
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial, color_unit
from objectfolder.mesh.textured import PLAIN

MAX_MATERIALS = 4096  # each becomes a part, and may take a window of the texture


def read_obj(path: Path) -> MeshContent:
    """Read a Wavefront ``.obj`` with its material libraries and colour textures.

    Colours (``Kd`` and per-vertex colours) are interpreted as sRGB. A texture replaces ``Kd`` and vertex
    colours, as exporters intend. ``Pr`` and ``Pm`` are roughness and metallic.

    Raises
    ------
    ObjectFolderError
        If a file it refers to is missing or unreadable, a line of numbers has other words, or a face index is
        out of range.
    """
    lines = ObjLines(path)
    libraries = MaterialLibraries(path, _library_names(lines))
    statements, names = _used_materials(lines, libraries.statements)
    positions, colors, notes = _vertices(lines)
    coordinates, normals = lines.table(COORDINATE, 2)[0], lines.table(NORMAL, 3)[0]
    rows, sizes, corners = lines.corners()
    beyond = corners[:, 0] > len(positions)
    problem = f"uses a vertex beyond the {len(positions)} of the file; export the mesh again"
    lines.refuse(np.repeat(rows, sizes)[beyond], problem)
    # A face has what all of its corners have. Coordinates and normals that are not in the file, none has.
    held = (corners > 0) & (corners <= [len(positions), len(coordinates), len(normals)])
    held = np.logical_and.reduceat(held, np.cumsum(sizes) - sizes)
    corners -= 1
    triangles, face = split_loops(positions, corners[:, 0], sizes)
    used = np.zeros(len(positions), bool)
    used[corners[triangles, 0]] = True
    colors /= color_unit(np.fmax.reduce(colors[used], None, initial=0))
    _polypaint(lines, colors)
    names = ["", *names]  # of faces before any usemtl
    distinct = list(dict.fromkeys(names))
    numbers = {name: number for number, name in enumerate(distinct)}
    material = np.array([numbers[name] for name in names])[np.searchsorted(statements, rows)]
    parts: list[MeshPart] = []
    materials: dict[str, MtlMaterial] = {}
    for group in _groups(material[face], held[face]):
        one = face[group[0]]
        name = distinct[material[one]]
        if name not in materials:
            materials[name] = libraries.material(name)
        columns = np.flatnonzero(held[one])
        faces, indices = _join_corners(corners[triangles[group]][..., columns])
        index = dict(zip(columns.tolist(), indices))
        surface, part_colors, left_out = _choose_colors(
            colors[index[VERTEX]], materials[name].surface, COORDINATE in index
        )
        uv = coordinates[index[COORDINATE]] if COORDINATE in index else None
        uv = None if uv is None else materials[name].image_coordinates(uv)
        part_normals = normals[index[NORMAL]] if NORMAL in index else None
        parts.append(MeshPart(positions[index[VERTEX]], faces, surface, uv, part_colors, part_normals))
        notes += left_out
    missing = [shortened(name) for name in distinct if name and name not in libraries.statements]
    if missing:
        colored = any(part.colors is not None for part in parts)
        look = "faces have no colour but that of their vertices" if colored else "faces have no colour"
        notes.append(f"material {', '.join(missing[:5])} is not defined: its {look}")
    if libraries.statements and not any(names):
        notes.append("materials left out: no face says which it has (usemtl)")
    if curved := lines.statements("surf")[0]:
        notes.append(f"curved surfaces left out ({len(curved)})")
    dropped = Counter(what for found in materials.values() for what in found.dropped)
    notes += [f"{what} left out ({count})" for what, count in sorted(dropped.items())]
    return MeshContent(parts, list(dict.fromkeys(notes)))


def mtl_names(path: Path) -> list[str]:
    """Return the material libraries that an ``.obj`` names, in order; names may contain spaces."""
    return _library_names(ObjLines(path))


def _library_names(lines: ObjLines) -> list[str]:
    names: dict[str, None] = {}
    for text in filter(None, lines.statements("mtllib")[1]):
        several = re.split(r"(?<=\.mtl)\s+", text.strip('"'), flags=re.I)
        names |= dict.fromkeys([name for name in several if name.lower().endswith(".mtl")] or [text])
    return list(names)


def _used_materials(lines: ObjLines, materials: Collection[str]) -> tuple[list[int], list[str]]:
    """Return the lines ``usemtl`` and their names as the libraries write them: spaces and comments differ."""
    rows, texts = lines.statements("usemtl")
    known = {strip_comment(name): name for name in materials} | {name: name for name in materials}
    names = [" ".join(text.split()) for text in texts]
    count = len(set(names))
    if count > MAX_MATERIALS:
        raise ObjectFolderError(
            f"{lines.path} uses {count} materials, expected at most {MAX_MATERIALS}; join them, such as by "
            "baking them into one texture"
        )
    return rows, [known.get(name, known.get(strip_comment(name), name)) for name in names]


def _vertices(lines: ObjLines) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return positions (V, 3), colours (V, 3) as they are written, NaN where a vertex has none, and notes."""
    held = lines.words[lines.kind == VERTEX] - 1
    table, counts = lines.table(VERTEX, int(np.clip(held.max(initial=3), 3, 8)))
    lines.refuse(np.flatnonzero(lines.kind == VERTEX)[counts < 3], NOT_NUMBERS)
    table = np.pad(table, ((0, 0), (0, 8 - table.shape[1]))) if table.shape[1] > 3 else table
    colors = np.full((len(table), 3), np.nan)
    if table.shape[1] == 3:
        return table, colors, []
    # Four numbers are x, y, z and a weight; seven have either this or an alpha.
    seven = table[counts == 7]
    weighted = (counts == 4) | (counts > 7)
    if (seven[:, 3] == 1).all() and not np.isin(seven[:, 6], (1, 255)).all():
        weighted |= counts == 7
    for first, rows in ((3, ~weighted & (counts > 5)), (4, weighted & (counts > 6))):
        colors[rows] = table[rows, first : first + 3]
    alpha = np.concatenate([table[~weighted & (counts > 6), 6], table[counts > 7, 7]])
    notes = ["alpha of vertex colours left out"] if not np.isin(alpha, (1, 255)).all() else []
    notes += ["weights of vertices left out"] if (table[weighted, 3] != 1).any() else []
    return table[:, :3], colors, notes


def _polypaint(lines: ObjLines, colors: np.ndarray) -> None:
    """Set the colours (V, 3) of vertices, in [0, 1], that ZBrush writes as comments ``#MRGB MMRRGGBB...``.

    They follow their vertices, in blocks.
    """
    rows, texts = lines.statements("#MRGB")
    blocks: dict[int, list[str]] = {}  # by the number of vertices before them
    before = np.cumsum(lines.kind == VERTEX)
    for row, text in zip(rows, texts):
        blocks.setdefault(int(before[row]), []).extend(re.findall("[0-9a-fA-F]{8}", text))
    for vertex, block in blocks.items():
        own = np.frombuffer(bytes.fromhex("".join(block)), np.uint8).reshape(-1, 4)[: len(colors), 1:]
        first = max(vertex - len(own), 0)
        colors[first : first + len(own)] = own / 255


def _choose_colors(
    colors: np.ndarray, surface: SurfaceMaterial, mapped: bool
) -> tuple[SurfaceMaterial, np.ndarray | None, list[str]]:
    """Choose between the vertex colours (V, 3) of a part, sRGB in [0, 1], and those of its material.

    An image counts if the part has texture coordinates (``mapped``), or no other colour than white. Returns
    the material, linear colours or None, and what is left out.
    """
    uncolored = np.isnan(colors)
    if uncolored.all():
        return surface, None, []
    colors = srgb.decode(np.clip(colors, 0, 1))
    white = (uncolored | (colors == 1)).all()  # as some programs write where a material has the colour
    if surface.image is not None and (mapped or white):
        return surface, None, ["vertex colours beside a texture left out"]
    if surface.color is not None and white:
        return surface, None, ["white vertex colours beside Kd left out"]
    plain = PLAIN if surface.color is None else surface.color
    return replace(surface, image=None, color=None), np.where(uncolored, plain, colors), []


def _groups(material: np.ndarray, held: np.ndarray) -> list[np.ndarray]:
    """Group triangles by material, and by what their corners have, (T, 3) bool.

    The last material comes first: the order of vertices that built objects have.
    """
    keys, first, of = np.unique(4 * material + held @ [0, 1, 2], return_index=True, return_inverse=True)
    mixed = len(np.unique(keys // 4)) < len(keys)
    order = np.lexsort((-first, keys % 4 if mixed else np.zeros_like(keys)))
    groups = np.split(np.argsort(of, kind="stable"), np.cumsum(np.bincount(of))[:-1])
    return [groups[i] for i in order]


def _join_corners(corners: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Join equal corners (T, 3, K) into vertices; return the triangles (T, 3), and K indices of vertices."""
    if corners.shape[2] == 1:
        vertex, faces = np.unique(corners, return_inverse=True)
        return faces.reshape(-1, 3), [vertex]
    faces, *index = unmerge_faces(*np.moveaxis(corners, 2, 0))
    return faces, index
