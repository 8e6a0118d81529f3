"""Read ``.off`` (Geomview): polygons with colours of vertices or faces."""

import re
from pathlib import Path

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import split
from objectfolder.mesh.reading.parts import (
    MeshContent,
    MeshPart,
    SurfaceMaterial,
    color_unit,
    split_by_face_color,
)
from objectfolder.mesh.reading.text import DECIMAL_COMMAS, decode_text, has_decimal_commas
from objectfolder.mesh.textured import PLAIN

# Texture coordinates (ST) come last and name no image.
HEADER = re.compile(r"(?:ST)?(?P<colors>C)?(?P<normals>N)?OFF(?=[\s\d]|$)(?P<rest>.*)")


def read_off(path: Path) -> MeshContent:
    """Read an ``.off`` in text; colours are interpreted as sRGB, 0 to 1 or 0 to 255.

    Raises
    ------
    ObjectFolderError
        If it is not such a file, or breaks off.
    """
    text = decode_text(path.read_bytes()).rstrip("\0\x1a")
    lines = [line for line in (line.partition("#")[0].strip() for line in text.splitlines()) if line]
    header = HEADER.fullmatch(lines[0]) if lines else None
    if header is None or "BINARY" in header["rest"]:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its first line is {shortened(lines[0] if lines else '')!r}, "
            "expected OFF, COFF or NOFF and text; export it again"
        )
    rows = [line.split() for line in [header["rest"], *lines[1:]] if line.strip()]
    counts = rows[0][:2] if rows else []
    if len(counts) < 2 or not all(re.fullmatch(r"[0-9]{1,9}", count) for count in counts):
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: no numbers of vertices and faces follow its first line; "
            "export it again"
        )
    vertex_count, face_count = map(int, counts)
    vertex_rows, face_rows = rows[1 : 1 + vertex_count], rows[1 + vertex_count :][:face_count]
    if len(face_rows) < face_count or not face_count:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it has {len(rows) - 1} lines of vertices and faces, expected "
            f"{vertex_count} and {face_count}: cut off?"
        )
    columns = 3 * (1 + bool(header["normals"]) + bool(header["colors"]))
    values = _numbers(path, [row[:columns] for row in vertex_rows], columns, "vertices")
    vertices = values[:, :3]
    normals = values[:, 3:6] if header["normals"] else None
    colors = values[:, columns - 3 :] if header["colors"] else None
    faces, face_colors = _faces(path, vertices, face_rows)
    alphas = [row[columns] for row in vertex_rows if header["colors"] and len(row) - columns in (1, 3)]
    alphas += [row[-1] for row in face_rows if len(row) == int(row[0]) + 5]
    alpha = _numbers(path, [[value] for value in alphas], 1, "colours")
    notes = [] if np.isin(alpha, (1, 255)).all() else ["alpha of colours left out"]
    if any(len(row) == int(row[0]) + 2 for row in face_rows):
        notes.append("numbers of colours in a colour map left out")
    if face_colors is not None and colors is not None:
        notes.append("colours of faces beside those of vertices left out")
    elif face_colors is not None and 0 <= faces.min() <= faces.max() < len(vertices):
        uncolored = np.isnan(face_colors).any(1)
        brightest = face_colors[~uncolored].max()
        face_colors[uncolored] = srgb.encode(np.float64(PLAIN)) * color_unit(brightest)
        colors, vertex, faces = split_by_face_color(face_colors, faces)
        vertices, normals = vertices[vertex], None if normals is None else normals[vertex]
    linear = None
    if colors is not None:
        linear = srgb.decode(np.clip(colors / color_unit(colors.max(initial=0)), 0, 1))
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(), None, linear, normals)], notes)


def _faces(path: Path, vertices: np.ndarray, rows: list[list[str]]) -> tuple[np.ndarray, np.ndarray | None]:
    """Return triangles (F, 3), by number of corners, and colours (F, 3), NaN where a face has none.

    The colours are None if no face has one.
    """
    groups: dict[str, list[list[str]]] = {}
    for row in rows:
        groups.setdefault(row[0], []).append(row)
    triangles, colors = [np.zeros((0, 3), np.int64)], [np.zeros((0, 3))]
    for corners, group in sorted(groups.items(), key=lambda item: (len(item[0]), item[0])):
        count = int(_numbers(path, [[corners]], 1, "faces", np.int64)[0, 0])
        if count < 3:
            continue  # a point or a line
        polygons = _numbers(path, [row[1 : 1 + count] for row in group], count, "faces", np.int64)
        # Indices out of range are refused later, by name.
        local = split(vertices[np.clip(polygons, 0, len(vertices) - 1)])
        triangles.append(np.take_along_axis(polygons[:, None], local, 2).reshape(-1, 3))
        given = [row[1 + count : 4 + count] for row in group]
        filled = [color if len(color) == 3 else ["nan"] * 3 for color in given]
        colors.append(np.repeat(_numbers(path, filled, 3, "faces"), count - 2, 0))
    face_colors = np.concatenate(colors)
    return np.concatenate(triangles), None if np.isnan(face_colors).any(1).all() else face_colors


def _numbers(
    path: Path, rows: list[list[str]], width: int, what: str, dtype: type = np.float64
) -> np.ndarray:
    try:
        return np.array(rows, dtype).reshape(len(rows), width)
    except (ValueError, OverflowError) as error:
        commas = has_decimal_commas(" ".join(word for row in rows for word in row).encode())
        raise ObjectFolderError(
            f"{path}: some of its {what} have "
            + (DECIMAL_COMMAS if commas else "words that are no numbers, or too few; export it again")
        ) from error
