"""Read ``.stl``, in text or binary."""

import re
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import split_loops
from objectfolder.mesh.reading.parts import MeshContent, MeshPart, SurfaceMaterial
from objectfolder.mesh.reading.text import (
    CUT_OFF,
    DECIMAL_COMMAS,
    IS_SPACE,
    between,
    decode_text,
    find_words,
    has_decimal_commas,
    parse_numbers,
    starts,
    utf16_order,
)
from objectfolder.mesh.textured import PLAIN

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84  # bytes: 80 for anything, and the number of facets
UNKNOWN = (0, 0xFFFFFFFF)  # numbers of facets that some writers leave there
OWN_BIT, CHANNELS = 0x8000, np.array([0, 5, 10])
#: The name of a solid, in lower case: any words, to the end of the line or the first facet.
NAME = re.compile(rb"solid\b(?:(?!\bfacet\s+normal\b)[^\n])*")
WORDS = re.compile(rb"\b(?:facet\s+normal\b|vertex\s)", re.I)


def read_stl(path: Path) -> MeshContent:
    """Read an ``.stl``; colours of facets, of Magics or VisCAM, are interpreted as sRGB.

    Raises
    ------
    ObjectFolderError
        If the file breaks off, or has words for numbers.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:HEADER], "little")
    if len(data) != HEADER + FACET.itemsize * count or not count:
        text = (decode_text(data).encode() if utf16_order(data) else data.removeprefix(BOM_UTF8)).rstrip(
            b"\0"
        )
        if b"\0" not in text and (text[:99].lstrip()[:5].lower() == b"solid" or WORDS.search(text)):
            return _read_text(path, text)
    return _read_binary(path, data, count)


def _read_binary(path: Path, data: bytes, count: int) -> MeshContent:
    held, notes = max(len(data) - HEADER, 0) // FACET.itemsize, []
    if count in UNKNOWN and held:
        notes.append(f"number of facets of {count} taken for the {held} that the file holds")
        count = held
    if len(data) < HEADER + FACET.itemsize * count or len(data) < HEADER:
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it has {len(data)} bytes, expected "
            f"{HEADER + FACET.itemsize * count} for {count} triangles; {CUT_OFF}"
        )
    if held > count:
        notes.append(f"{len(data) - HEADER - FACET.itemsize * count} bytes after the {count} facets left out")
    facets = np.frombuffer(data, FACET, count, HEADER)
    vertices = facets["corners"].reshape(-1, 3).astype(np.float64)
    colors = _colors(data[:80], facets["attribute"].astype(np.int64))
    if colors is None and facets["attribute"].any():
        notes.append("attributes of facets left out: they are no colours of Magics or VisCAM")
    linear = None if colors is None else srgb.decode(np.repeat(colors, 3, 0) / 255)
    faces = np.arange(3 * count).reshape(-1, 3)
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial(), None, linear)], notes)


def _colors(header: bytes, attribute: np.ndarray) -> np.ndarray | None:
    """Return the colours (F, 3) of facets in bytes, None if there are none.

    In VisCAM, the highest bit says that a facet has a colour, 5 bits a channel, blue first. Magics has red
    first, a colour for all in the header, and that bit if a facet has no other; MeshLab sets it always.
    """
    marked = attribute & OWN_BIT > 0
    of_file = re.search(rb"COLOR=(...)", header, re.S)
    if of_file is None and not marked.any():
        return None
    channels = np.rint((attribute[:, None] >> CHANNELS & 31) * (255 / 31))
    if of_file is None:
        return np.where(marked[:, None], channels[:, ::-1], np.rint(255 * srgb.encode(np.float64(PLAIN))))
    own = ~marked & attribute.any()  # all 0: nothing was written
    if marked.all() and len(np.unique(attribute)) > 1:
        own = marked
    return np.where(own[:, None], channels, np.frombuffer(of_file[1], np.uint8))


def _read_text(path: Path, text: bytes) -> MeshContent:
    """Read the facets of all solids, wherever lines end; normals and names do not count."""
    text = NAME.sub(b"", text.lower().replace(b"\r", b"\n")) + b" " * 9
    data = np.frombuffer(text, np.uint8)
    places = starts(IS_SPACE[data])
    facet, vertex, end = (find_words(data, places, word) for word in ("facet", "vertex", "endloop"))
    if not len(facet):
        facet = find_words(data, places, "outer")
    bounds = np.append(places, [len(data)] * 4)
    numbers = data[between(bounds[vertex + 1], bounds[vertex + 4], len(data))].tobytes()
    values = parse_numbers(numbers, 3 * len(vertex))
    if values is None:
        problem = "words that are no numbers, or too few; export it again"
        problem = DECIMAL_COMMAS if has_decimal_commas(text) else problem
        raise ObjectFolderError(f"{path} cannot be read as a mesh: its vertices have {problem}")
    sizes = np.bincount(np.searchsorted(facet, vertex), minlength=len(facet) + 1)[1:]
    closed = np.searchsorted(end, np.append(facet[1:], len(places))) > np.searchsorted(end, facet)
    complete = (sizes > 2) & (closed | (len(end) == 0))
    if not complete.all():
        raise ObjectFolderError(
            f"{path} cannot be read as a mesh: it begins {len(facet)} triangles, of which {complete.sum()} "
            f"are complete; {CUT_OFF}"
        )
    vertices = values.reshape(-1, 3)[len(vertex) - sizes.sum() :]
    faces, _ = split_loops(vertices, np.arange(len(vertices)), sizes)
    notes = ["colours of facets left out"] if len(find_words(data, places, "color")) else []
    return MeshContent([MeshPart(vertices, faces, SurfaceMaterial())], notes)
