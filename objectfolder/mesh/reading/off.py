"""Read ``.off`` (Geomview): polygons with colours of vertices or faces."""

import re
from pathlib import Path

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import split_loops
from objectfolder.mesh.reading.parts import (
    MeshContent,
    MeshPart,
    SurfaceMaterial,
    color_unit,
    split_by_face_color,
)
from objectfolder.mesh.reading.text import (
    CUT_OFF,
    DECIMAL_COMMAS,
    count_words,
    decode_text,
    has_decimal_commas,
    parse_numbers,
)
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
    header, (text, held), (face_text, face_held) = _lines(path)
    columns = 3 * (1 + bool(header["normals"]) + bool(header["colors"]))
    values = _parse(path, text, held, "vertices")
    table = _take(path, values, np.cumsum(held) - held, np.full(len(held), columns), held, "vertices")
    table = table.reshape(-1, columns)
    vertices = table[:, :3]
    normals = table[:, 3:6] if header["normals"] else None
    colors = table[:, columns - 3 :] if header["colors"] else None
    alpha = np.zeros(0)
    if colors is not None:  # two further numbers are texture coordinates
        alpha = values[(np.cumsum(held) - held + columns)[np.isin(held - columns, (1, 3))]]
    values, held = _parse(path, face_text, face_held, "faces"), face_held
    start = np.cumsum(held) - held
    sizes = _whole(path, values[start])
    corners = _whole(path, _take(path, values, start + 1, sizes, held - 1, "faces"))
    triangles, owner = split_loops(vertices, corners, sizes)
    order = np.argsort(sizes[owner], kind="stable")  # as in built objects
    faces, owner = corners[triangles[order]], owner[order]
    more = held - 1 - sizes  # numbers after the corners
    colored = more >= 3
    face_colors = np.full((len(held), 3), np.nan)
    face_colors[colored] = values[(start + 1 + sizes)[colored, None] + np.arange(3)]
    face_colors = face_colors[owner]
    alpha = np.append(alpha, values[(start + held - 1)[more == 4]])
    notes = [] if np.isin(alpha, (1, 255)).all() else ["alpha of colours left out"]
    if (more == 1).any():
        notes.append("numbers of colours in a colour map left out")
    uncolored = np.isnan(face_colors).any(1)
    if colors is not None and not uncolored.all():
        notes.append("colours of faces beside those of vertices left out")
    elif not uncolored.all() and 0 <= faces.min() <= faces.max() < len(vertices):
        brightest = face_colors[~uncolored].max()
        face_colors[uncolored] = srgb.encode(np.float64(PLAIN)) * color_unit(brightest)
        colors, vertex, faces = split_by_face_color(face_colors, faces)
        vertices, normals = vertices[vertex], None if normals is None else normals[vertex]
    linear = None
    if colors is not None:
        linear = srgb.decode(np.clip(colors / color_unit(colors.max(initial=0)), 0, 1))
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(), None, linear, normals)], notes)


def _lines(path: Path) -> tuple[re.Match[str], tuple[bytes, np.ndarray], tuple[bytes, np.ndarray]]:
    """Return the header, and the lines of vertices and of faces, each with their numbers of words."""
    text = decode_text(path.read_bytes()).rstrip("\0\x1a").replace("\r", "\n")
    first, _, rest = re.sub("#[^\n]*", "", text).lstrip().partition("\n")
    header = HEADER.fullmatch(first.strip())
    if header is None or "BINARY" in header["rest"]:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its first line is {shortened(first.strip())!r}, "
            "expected OFF, COFF or NOFF and text; export it again"
        )
    body = f"{header['rest']}\n{rest}\n".encode()
    ends, words = count_words(np.frombuffer(body, np.uint8))
    counts = body[: ends[0]].split()[:2] if len(ends) else []
    if len(counts) < 2 or not all(re.fullmatch(rb"[0-9]{1,9}", count) for count in counts):
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: no numbers of vertices and faces follow its first line; "
            "export it again"
        )
    vertex_count, face_count = map(int, counts)
    last = vertex_count + face_count
    if len(ends) <= last or not face_count:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it has {len(ends) - 1} lines of vertices and faces, expected "
            f"{vertex_count} and {face_count}; {CUT_OFF}"
        )
    return (
        header,
        (body[ends[0] : ends[vertex_count]], words[1 : vertex_count + 1]),
        (body[ends[vertex_count] : ends[last]], words[vertex_count + 1 : last + 1]),
    )


def _parse(path: Path, text: bytes, held: np.ndarray, what: str) -> np.ndarray:
    values = parse_numbers(text, int(held.sum()))
    if values is None:
        raise _wrong(path, what, text)
    return values


def _take(
    path: Path, values: np.ndarray, start: np.ndarray, sizes: np.ndarray, held: np.ndarray, what: str
) -> np.ndarray:
    """Return as many values of each line as sizes (L,) say, one after the other; lines have ``held`` (L,)."""
    if (sizes < 0).any() or (sizes > held).any():
        raise _wrong(path, what)
    inner = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return values[np.repeat(start, sizes) + inner]


def _whole(path: Path, values: np.ndarray) -> np.ndarray:
    if not (np.abs(values) < 2**53).all() or (values % 1).any():
        raise _wrong(path, "faces")
    return values.astype(np.int64)


def _wrong(path: Path, what: str, text: bytes = b"") -> ObjectFolderError:
    problem = "words that are no numbers, or too few; export it again"
    return ObjectFolderError(
        f"{path}: some of its {what} have {DECIMAL_COMMAS if has_decimal_commas(text) else problem}"
    )
