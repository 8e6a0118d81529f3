"""Read ``.ply`` (Stanford): polygons and triangle strips, their colours and texture coordinates."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import Any

import numpy as np
from PIL import Image
from trimesh.grouping import unique_rows
from trimesh.visual.texture import unmerge_faces

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import split_loops
from objectfolder.mesh.reading.files import find_referenced, read_image, read_referenced
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
    utf16_order,
)
from objectfolder.mesh.textured import PLAIN

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
CODES = dict(zip(("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"), "bBhHiIqQfd"))
MAX_HEADER = 1 << 20  # bytes of a file that has no end of its header
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
COLORS = [tuple(prefix + name for name in ("red", "green", "blue")) for prefix in ("", "diffuse_")]
COLORS.append(("r", "g", "b"))
ALPHAS = ("alpha", "diffuse_alpha", "a")
COORDINATES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"), ("texture_s", "texture_t"))
CARRIERS = ("vertex", "face")  # elements whose colours count
NORMAL = ("nx", "ny", "nz")
INDICES = ("vertex_indices", "vertex_index")
NUMBER = np.dtype("<f8")  # of text, once it is parsed
WRONG = (StructError, ValueError, OverflowError, IndexError)  # what lengths raise that the file has not


@dataclass
class _Property:
    """Property of an element of N rows: values (N,), or of lists, whose lengths sum to M, (M,)."""

    name: str
    declared: np.dtype[Any]
    stored: np.dtype[Any]
    count: np.dtype[Any] | None  #: of a list's length, as it is stored
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    sizes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))  #: (N,) lengths of lists


@dataclass
class _Element:
    name: str
    rows: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def numbers(self) -> dict[str, _Property]:
        """The properties that are no lists, by name."""
        return {one.name: one for one in self.properties if one.count is None}

    @property
    def lists(self) -> dict[str, _Property]:
        """The properties that are lists, by name."""
        return {one.name: one for one in self.properties if one.count is not None}


def read_ply(path: Path) -> MeshContent:
    """Read a ``.ply``, in text or binary; colours are interpreted as sRGB.

    Its header tells the elements and their rows. Bytes after them do not count.

    Raises
    ------
    ObjectFolderError
        If the header is not that of a ``.ply``, the file breaks off, or the texture that it names is missing
        or unreadable, or is one of several.
    """
    data = path.read_bytes()
    textures, image = ply_textures(data), None
    if len(textures) > 1:  # the faces of each are told in several ways, or not at all
        raise ObjectFolderError(
            f"{path} names {len(textures)} textures ({shortened(', '.join(textures))}), expected at most "
            "one; export it as .obj or .glb, which tell the faces of each, or bake them into one"
        )
    elements = {element.name: element for element in _read_elements(path, data)}
    if textures:
        file = find_referenced(path, textures[0], any_case=True)
        image = read_image(read_referenced(path, file), path.parent / file, path)
    vertex, face = (elements.get(name, _Element(name, 0)) for name in CARRIERS)
    if not vertex.numbers.keys() >= set("xyz"):
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its vertices have no x, y and z; export it again"
        )
    vertices = _stack(vertex, "xyz")
    normals = _stack(vertex, NORMAL) if vertex.numbers.keys() >= set(NORMAL) else None
    corners, triangles, owner = _triangles(elements, vertices)
    faces = corners[triangles]
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        return MeshContent([MeshPart(vertices, faces, SurfaceMaterial())])  # which is refused in words
    (colors, clear), (face_colors, clear_faces) = _colors(vertex), _colors(face)
    notes = ["alpha of colours left out"] if clear or clear_faces else []
    others = [name for name, other in elements.items() if name not in CARRIERS and _color_names(other)]
    notes += [f"colours of element {shortened(name)} left out" for name in others]
    if colors is not None and face_colors is not None:
        notes.append("colours of faces beside those of vertices left out")
    mesh = MeshPart(vertices, faces, SurfaceMaterial(), None, _linear(colors), normals)
    uv = None if image is None else _coordinates(vertex, face, corners)
    if image is not None and uv is not None:
        if colors is not None or face_colors is not None:
            notes = [*notes[:-1], "vertex colours beside a texture left out"]
        return MeshContent(_textured(mesh, uv[triangles], image), notes)
    if textures:
        notes.append("texture left out: the file has no texture coordinates")
    if colors is None and face_colors is not None:
        strips = np.full((1, 3), np.rint(255 * srgb.encode(np.float64(PLAIN))))
        colors, kept, faces = split_by_face_color(np.concatenate([face_colors, strips])[owner], faces)
        normals = None if normals is None else normals[kept]
        mesh = MeshPart(vertices[kept], faces, SurfaceMaterial(), None, _linear(colors), normals)
    return MeshContent([mesh], notes)


def ply_textures(data: bytes) -> list[str]:
    """Return the textures named in the header of a ``.ply``, in order."""
    found = [re.match(r"\s*(?:comment|obj_info)\b.*?texturefile(.*)", line, re.I) for line in _split(data)[0]]
    return list(dict.fromkeys(name[1].strip().strip('"') for name in found if name))


def _split(data: bytes) -> tuple[list[str], bytes]:
    """Split a file into the lines of its header, and what follows it."""
    if utf16_order(data):
        data = decode_text(data).encode()
    first = re.search(rb"\r\n|\n|\r", data)
    usual = first[0] if first else b"\n"  # a line break, by which data may begin, too
    end = re.search(rb"[\r\n][ \t]*end_header[ \t]*(?:" + usual + rb"|\r\n|\n|\r|\Z)", data)
    header = decode_text(data[: end.start()] if end else data[:MAX_HEADER])
    return re.split(r"[\r\n]+", header), data[end.end() :] if end else b""


def _read_elements(path: Path, data: bytes) -> list[_Element]:
    lines, body = _split(data)
    elements, order = _parse_header(path, lines)
    element = None
    try:
        if order:
            place, stored = 0, np.frombuffer(body, np.uint8)
            for element in elements:
                place = _fill(element, stored, place)
        else:
            _fill_from_text(path, body, elements)
    except ObjectFolderError:
        raise
    except WRONG as error:
        where = f" of element {shortened(element.name)} ({element.rows} rows)" if element else ""
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: its data end before those{where} that its header announces, "
            f"or have lists of other lengths; {CUT_OFF}"
        ) from error
    return elements


def _parse_header(path: Path, lines: Sequence[str]) -> tuple[list[_Element], str]:
    """Return the elements, without values, and the order of bytes, "" for text."""
    elements: list[_Element] = []
    order = None
    for number, line in enumerate(lines):
        try:
            keyword, *words = line.split() or [""]
            if number == 0 and keyword.lower() != "ply":
                raise ValueError(keyword)
            if keyword == "format":
                order = ORDERS[words[0]]
            elif keyword == "element":
                elements.append(_Element(words[0], int(words[1])))
            elif keyword == "property":
                *types, name = words
                codes = [TYPES[one] for one in types if one != "list"]
                declared = [np.dtype(code) for code in codes]
                stored = [np.dtype(order + code) if order else NUMBER for code in codes]
                count = stored[0] if types[0] == "list" else None
                item = declared[0 if count is None else 1]
                elements[-1].properties.append(_Property(name, item, stored[-1], count))
        except (ValueError, KeyError, IndexError) as error:
            raise ObjectFolderError(
                f"{path} cannot be read as a mesh: {shortened(line)!r} is not a valid line of a .ply header; "
                "export it again"
            ) from error
    if order is None:
        raise ObjectFolderError(f"{path} cannot be read as a mesh: its header has no format; export it again")
    return elements, order


def _fill_from_text(path: Path, body: bytes, elements: Sequence[_Element]) -> None:
    """Read the values from text: a row is a line, of which further words do not count, or any words."""
    body = body.rstrip(b"\0\x1a \t\r\n").replace(b"\r", b"\n") + b"\n"
    ends, words = count_words(np.frombuffer(body, np.uint8))
    total = sum(element.rows for element in elements)
    if len(ends) >= total > 0:
        values = _parse(path, body[: ends[total - 1]], int(words[:total].sum()))
        starts, row = NUMBER.itemsize * np.cumsum([0, *words[:total]]), 0
        with suppress(*WRONG):
            for element in elements:
                lines = starts[row : row + element.rows + 1]
                if element.rows and (_extract(element, values, lines[:-1]) > lines[1:]).any():
                    break
                row += element.rows
            else:
                return
    after = re.search(rb"(?<!\S)(?!nan|inf)[a-z]", body, re.I)  # words that follow the data
    body = body[: after.start()] if after else body
    values, place = _parse(path, body, len(body.split())), 0
    for element in elements:
        place = _fill(element, values, place)


def _parse(path: Path, text: bytes, count: int) -> np.ndarray:
    """Parse numbers, as the bytes that store them."""
    values = parse_numbers(text, count)
    if values is None:
        problem = DECIMAL_COMMAS if has_decimal_commas(text) else "words that are no numbers; export it again"
        raise ObjectFolderError(f"{path} cannot be read as a mesh: its data have {problem}")
    return values.astype(NUMBER).view(np.uint8)


def _fill(element: _Element, body: np.ndarray, start: int) -> int:
    """Read the values of an element that begins at a place of the body; return the place after it."""
    least = sum((one.stored if one.count is None else one.count).itemsize for one in element.properties)
    if not element.rows or not element.properties:
        return start
    if element.rows * least > len(body) - start:
        raise ValueError(f"{element.rows} rows")
    with suppress(*WRONG):  # all rows may be as long as the first
        step = _follow(element, body, start, 1)[1] - start
        places = start + step * np.arange(element.rows)
        after = _extract(element, body, places)
        if (after == places + step).all():
            return int(after[-1])
    return int(_extract(element, body, _follow(element, body, start, element.rows)[:-1])[-1])


def _follow(element: _Element, body: np.ndarray, start: int, rows: int) -> np.ndarray:
    """Return the places where rows begin, and the last one ends, (rows + 1,)."""
    lists: list[tuple[int, Any, int, int]] = []
    skipped = 0
    for one in element.properties:
        if one.count is None:
            skipped += one.stored.itemsize
        else:
            code = one.count.str[0].replace("|", "<") + CODES[one.count.str[1:]]
            lists.append((skipped, Struct(code).unpack_from, one.count.itemsize, one.stored.itemsize))
            skipped = 0
    buffer, place = memoryview(body), start
    places = [place]
    for _ in range(rows):
        for before, read, own, item in lists:
            place += before
            place += own + item * int(read(buffer, place)[0])
        place += skipped
        places.append(place)
    return np.array(places)


def _extract(element: _Element, body: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Read the values of rows that begin at given places (N,); return the places where they end, (N,)."""
    for one in element.properties:
        sizes = np.ones(len(places), np.int64)
        if one.count is not None:
            one.sizes = sizes = _gather(body, places, sizes, one.count).astype(np.int64)
            places = places + one.count.itemsize
            if sizes.min() < 0 or sizes.sum() * one.stored.itemsize > len(body):
                raise ValueError("lists of a wrong length")
        one.values = _gather(body, places, sizes, one.stored)
        if one.declared.kind == "f":
            with np.errstate(over="ignore"):
                one.values = one.values.astype(one.declared)
        places = places + sizes * one.stored.itemsize
    return places


def _gather(body: np.ndarray, places: np.ndarray, sizes: np.ndarray, dtype: np.dtype[Any]) -> np.ndarray:
    """Read as many values as sizes (N,) say from each of some places (N,)."""
    size, step = int(sizes[0]), np.diff(places)
    if (sizes == size).all() and (step == step[:1]).all():
        if places[0] < 0 or places[-1] + size * dtype.itemsize > len(body):
            raise IndexError("beyond the end")
        strides = (int(step[0]) if len(step) else 0, dtype.itemsize)
        shape = (len(places), size)
        return np.ndarray(shape, dtype, body, int(places[0]), strides).ravel()
    first = np.cumsum(sizes) - sizes
    inner = np.arange(sizes.sum()) - np.repeat(first, sizes)
    each = np.repeat(places, sizes) + inner * dtype.itemsize
    return body[each[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]


def _stack(element: _Element, names: Iterable[str]) -> np.ndarray:
    """Return numbers of rows as columns, float64."""
    return np.column_stack([element.numbers[name].values for name in names]).astype(np.float64)


def _color_names(element: _Element) -> tuple[str, ...] | None:
    return next((names for names in COLORS if element.numbers.keys() >= set(names)), None)


def _colors(element: _Element) -> tuple[np.ndarray | None, bool]:
    """Return the colours (N, 3) of rows, 0 to 255 in whole steps, and whether any has an alpha below 1."""
    names = _color_names(element)
    if names is None or not element.rows:
        return None, False
    alpha = [name for name in ALPHAS if name in element.numbers][:1]
    values = np.nan_to_num(_stack(element, [*names, *alpha]))
    whole, brightest = element.numbers[names[0]].declared.kind in "iu", values[:, :3].max()
    if whole:
        values /= 257 if brightest > 255 else 1
    else:
        values *= 255 / color_unit(brightest)
    values = np.rint(np.clip(values, 0, 255))
    return values[:, :3], bool((values[:, 3:] < 255).any())


def _linear(colors: np.ndarray | None) -> np.ndarray | None:
    return None if colors is None else srgb.decode(colors / 255)


def _triangles(
    elements: Mapping[str, _Element], vertices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices of corners (C,), triangles of corners (T, 3) and their faces (T,), -1 in strips.

    The first corners are those of the faces, in order.
    """
    corners, triangles, owner = np.zeros(0, np.int64), np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    if index := _index(elements.get("face")):
        corners = _whole(index.values)
        triangles, owner = split_loops(vertices, corners, index.sizes)
        first = np.cumsum(index.sizes) - index.sizes
        whole = (triangles[:, 0] != first[owner]).any() or _color_names(elements["face"]) is not None
        triangles, owner = _by_sizes(triangles, owner, index.sizes[owner], whole)
    if index := _index(elements.get("tristrips")):
        more, own = _whole(index.values), _strip_triangles(_whole(index.values), index.sizes)
        triangles = np.concatenate([triangles, len(corners) + own])
        corners = np.concatenate([corners, more])
        owner = np.concatenate([owner, np.full(len(own), -1)])
    return corners, triangles, owner


def _by_sizes(
    triangles: np.ndarray, owner: np.ndarray, size: np.ndarray, whole: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Order triangles as built objects have them: by polygon's size, second halves of quadrilaterals last.

    If these stay whole, or have more corners, all triangles of a polygon follow each other.
    """
    half = (size == 4) & (np.append(-1, owner[:-1]) == owner) & ~np.bool_(whole)
    triangles = np.where(half[:, None], np.roll(triangles, -1, 1), triangles)
    order = np.lexsort((half, size if whole else np.minimum(size, 5)))
    return triangles[order], owner[order]


def _index(element: _Element | None) -> _Property | None:
    """Return the list that holds the vertices of an element's polygons or strips."""
    lists = element.lists if element and element.rows else {}
    others = [one for one in lists.values() if one.declared.kind in "iu"]
    return next((lists[name] for name in INDICES if name in lists), others[0] if others else None)


def _whole(values: np.ndarray) -> np.ndarray:
    """Convert numbers to integers; -1 for what is none."""
    return np.clip(np.nan_to_num(values, nan=-1), -(2.0**53), 2.0**53).astype(np.int64)


def _strip_triangles(vertex: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the triangles (T, 3) of strips, which end at a -1 and with their list, as places in it.

    Every second one is turned, and those that have no area because of a repeated vertex are left out.
    """
    place = np.arange(len(vertex))
    row = np.repeat(np.cumsum(sizes) - sizes, sizes)
    begin = np.maximum(row, np.maximum.accumulate(np.where(vertex < 0, place + 1, 0)))
    three = place[:-2, None] + np.arange(3)
    a, b, c = vertex[three].T
    whole = (begin[three[:, 2]] == begin[three[:, 0]]) & (a >= 0) & (a != b) & (b != c) & (c != a)
    three = three[whole]
    turned = (three[:, 0] - begin[three[:, 0]]) % 2 == 1
    return np.where(turned[:, None], three[:, [1, 0, 2]], three)


def _coordinates(vertex: _Element, face: _Element, corners: np.ndarray) -> np.ndarray | None:
    """Return the texture coordinates of corners (C, 2), NaN where a face has none; None if no face has."""
    wedges, index = face.lists.get("texcoord"), _index(face)
    if wedges and index:
        held = wedges.sizes == 2 * index.sizes
        known = np.flatnonzero(np.repeat(held, index.sizes))
        if len(known):
            uv = np.full((len(corners), 2), np.nan)
            uv[known] = wedges.values[np.repeat(held, wedges.sizes)].reshape(-1, 2)
            return uv
    names = next((names for names in COORDINATES if vertex.numbers.keys() >= set(names)), None)
    return None if names is None else _stack(vertex, names)[corners]


def _textured(mesh: MeshPart, uv: np.ndarray, image: Image.Image) -> list[MeshPart]:
    """Give a mesh an image, given the coordinates of the faces' corners (F, 3, 2), NaN in faces without."""
    without = np.isnan(uv).all((1, 2))
    pairs = uv[~without].reshape(-1, 2)
    distinct, number = unique_rows(pairs)
    faces, vertex, coordinate = unmerge_faces(mesh.faces[~without], number.reshape(-1, 3))
    normals = None if mesh.normals is None else mesh.normals[vertex]
    surface = SurfaceMaterial(image)
    parts = [MeshPart(mesh.vertices[vertex], faces, surface, pairs[distinct][coordinate], None, normals)]
    if without.any():
        parts.append(
            replace(
                mesh,
                faces=mesh.faces[without],
                material=mesh.material if mesh.colors is not None else surface,
            )
        )
    return parts
