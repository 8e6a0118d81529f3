"""Read Wavefront ``.obj`` with its ``.mtl`` material libraries and textures."""

import re
from collections import Counter, defaultdict
from collections.abc import Collection
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.obj import load_obj

from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.polygon import needs_ears, split
from objectfolder.mesh.reading.files import decoded_text
from objectfolder.mesh.reading.from_trimesh import as_points, color_unit, fan_triangles
from objectfolder.mesh.reading.mtl import MaterialLibraries, MtlMaterial, bare
from objectfolder.mesh.reading.parts import MeshContent, MeshPart

FACE = re.compile(r"^f[ \t]+\S.*", re.M | re.A)
POLYGON = re.compile(r"^f(?:[ \t]++\d[\d/]*+){4,}+[ \t]*+$", re.M | re.A)
#: Faces by what their corners name: vertices, and texture coordinates, and normals, and both.
FORMS = [
    re.compile(rf"^f(?:[ \t]++{corner}(?=\s|$))++[ \t]*+$", re.M | re.A)
    for corner in (r"\d++/*+", r"\d++/\d++/?+", r"\d++//\d++", r"\d++/\d++/\d++")
]
#: Beginnings of lines that trimesh would skip: indented, or a keyword before a tab.
_SKIPPED = re.compile(r"\n(?:[ \t]++(v[tn]?|f|usemtl|mtllib|[ogs])[ \t]|(v[tn]?|f|usemtl|mtllib|[ogs])\t)")
_USED = re.compile(r"^usemtl (.*)", re.M)
MAX_MATERIALS = 4096  # trimesh takes time in proportion to the square of their number


def read_obj(path: Path) -> MeshContent:
    """Read a Wavefront ``.obj`` with its material libraries and colour textures.

    Colours (``Kd`` and per-vertex colours) are interpreted as sRGB. A texture replaces ``Kd`` and vertex
    colours, as exporters intend. ``Pr`` and ``Pm`` are roughness and metallic.

    Raises
    ------
    ObjectFolderError
        If a file it refers to is missing or unreadable, or a face index is out of range.
    """
    text = _plain(decoded_text(path.read_bytes()))
    _check_materials(path, text)
    text = _counted_from_start(path, text)
    _check_zero(path, text)
    libraries = MaterialLibraries(path, mtl_names(text))
    materials = libraries.statements
    text = _named(text, materials)
    # trimesh gets names only: it would ignore options of textures, and give materials without Kd a colour.
    library = "\n".join(f"newmtl {name}" for name in materials).encode()
    try:
        geometry = [
            content
            for one_form in _by_form(path, _concave_split(text))
            for content in load_obj(BytesIO(one_form.encode()), resolver=defaultdict(lambda: library))
            .get("geometry", {})
            .values()
        ]
    except IndexError:
        _check_vertices(path, text)
        raise
    unit = color_unit(max((_brightest(content) for content in geometry), default=0))
    parts: list[MeshPart] = []
    notes: list[str] = []
    used: dict[str, MtlMaterial] = {}
    for content in geometry:
        visual, colors = content.get("visual"), content.get("vertex_colors")
        name = (None if visual is None else visual.material.name) or ""
        if name not in used:
            used[name] = libraries.material(name)
        material = used[name]
        surface = material.surface
        colors = None if colors is None else srgb.decode(np.clip(colors[:, :3] / unit, 0, 1))
        if colors is not None and surface.image is not None:
            notes.append("vertex colours beside a texture left out")
            colors = None
        if colors is not None and surface.color is not None and (colors == 1).all():
            notes.append("white vertex colours beside Kd left out")
            colors = None
        if colors is not None:
            surface = replace(surface, color=None)
        uv = None if visual is None or visual.uv is None else np.asarray(visual.uv, np.float64)[:, :2]
        uv = None if uv is None else material.image_coordinates(uv)
        vertices, faces = as_points(content["vertices"]), fan_triangles(content["faces"])
        normals = content.get("vertex_normals")
        parts.append(
            MeshPart(vertices, faces, surface, uv, colors, None if normals is None else as_points(normals))
        )
    named = dict.fromkeys(name.strip() for name in re.findall(r"^usemtl[ \t](.*)", text, re.MULTILINE))
    missing = [shortened(name) for name in named if name and name not in materials]
    if missing:
        colored = any(part.colors is not None for part in parts)
        seen = "faces have no colour but that of their vertices" if colored else "faces have no colour"
        notes.append(f"material {', '.join(missing[:5])} is not defined: its {seen}")
    if materials and not named:
        notes.append("materials left out: no face says which it has (usemtl)")
    dropped = Counter(what for material in used.values() for what in material.dropped)
    notes += [f"{what} left out ({count})" for what, count in sorted(dropped.items())]
    return MeshContent(parts, list(dict.fromkeys(notes)))


def mtl_names(obj: str) -> list[str]:
    """Return the material libraries named in the text of an ``.obj``, in order; names may contain spaces."""
    lines = [line.strip() for line in re.findall(r"^mtllib[ \t](.*)", _plain(obj), re.MULTILINE)]
    names = [name for line in lines if line for name in _libraries(line)]
    return list(dict.fromkeys(names))


def _libraries(line: str) -> list[str]:
    names = re.split(r"(?<=\.mtl)\s+", line, flags=re.I)
    return [name for name in names if name.lower().endswith(".mtl")] or [line]


def _plain(obj: str) -> str:
    """End lines in a newline, join continued ones, as trimesh does, and begin each with keyword and space."""
    joined = "\n" + obj.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", "")
    return _SKIPPED.sub(lambda start: f"\n{start[1] or start[2]} ", joined)[1:]


def _named(text: str, materials: Collection[str]) -> str:
    """Write the names of materials that faces have as the libraries do: spaces and comments may differ."""
    known = {bare(name): name for name in materials} | {name: name for name in materials}

    def line(match: re.Match[str]) -> str:
        name = " ".join(match[1].split())
        return f"usemtl {known.get(name, known.get(bare(name), name))}"

    return _USED.sub(line, text)


def _check_materials(path: Path, text: str) -> None:
    count = len(set(re.findall("usemtl (.*)", text)))  # as trimesh finds them
    if count > MAX_MATERIALS:
        raise ObjectFolderError(
            f"{path} uses {count} materials, expected at most {MAX_MATERIALS}; join them, such as by baking "
            "them into one texture"
        )


def _check_zero(path: Path, text: str) -> None:
    """Raise for the index 0, which trimesh misinterprets."""
    faces = "\n".join(re.findall(r"^f\s.*", text, re.MULTILINE))
    zero = re.search(r"[\s/]0+(?=[/\s]|$)", faces)
    if zero:
        line = faces[faces.rfind("\nf", 0, zero.end()) + 1 :].partition("\n")[0].strip()
        raise ObjectFolderError(f"{path}: {shortened(line)!r} has the index 0, but .obj counts from 1")


def _check_vertices(path: Path, text: str) -> None:
    """Raise for a face of a vertex that is not there."""
    count = len(re.findall(r"^v\s", text, re.MULTILINE))
    for face in FACE.findall(text):
        corners = re.findall(r"\s(\d{1,18})", face.partition("#")[0])
        if any(int(index) > count for index in corners):
            raise ObjectFolderError(
                f"{path}: {shortened(face)!r} uses a vertex beyond the {count} of the file; export the mesh "
                "again"
            )


def _counted_from_start(path: Path, text: str) -> str:
    """Replace negative indices of faces, which count back from where they stand; trimesh: from the end."""
    if not re.search(r"^f\s[^\n-]*-\d", text, re.MULTILINE):
        return text
    lines, counts = text.split("\n"), Counter[str]()
    for i, line in enumerate(lines):
        keyword = line.partition(" ")[0]
        counts[keyword] += 1
        if keyword == "f" and "-" in line:
            lines[i] = "f " + " ".join(_corner(path, line, corner, counts) for corner in line.split()[1:])
    return "\n".join(lines)


def _corner(path: Path, line: str, corner: str, counts: Counter[str]) -> str:
    """Replace the negative indices of one corner, given how many lines of each kind precede it."""
    indices = corner.split("/")
    for i, (kind, index) in enumerate(zip(("v", "vt", "vn"), indices)):
        if re.fullmatch(r"-\d{1,18}", index):
            absolute = counts[kind] + 1 + int(index)
            if absolute < 1:
                raise ObjectFolderError(
                    f"{path}: {shortened(line)!r} counts back to {kind} {index}, but {counts[kind]} precede "
                    "it; export the mesh again"
                )
            indices[i] = str(absolute)
    return "/".join(indices)


def _concave_split(text: str) -> str:
    """Split the polygons of the text that trimesh's fans would leave, such as a U."""
    lines = list(dict.fromkeys(POLYGON.findall(text)))
    if not lines:
        return text
    vertices = _vertices(text)
    groups: dict[int, list[list[str]]] = defaultdict(list)
    for line in lines:
        corners = line.split()[1:]
        groups[len(corners)].append(corners)
    replaced: dict[tuple[str, ...], str] = {}
    for corners in map(np.array, groups.values()):
        index = np.strings.partition(corners, "/")[0].astype(np.int64) - 1
        valid = (index >= 0).all(1) & (index < len(vertices)).all(1)  # others are refused later
        corners, points = corners[valid], vertices[index[valid]]
        odd = needs_ears(points)
        for polygon, triangles in zip(corners[odd], split(points[odd])):
            replaced[tuple(polygon)] = "\n".join("f " + " ".join(corner) for corner in polygon[triangles])
    if not replaced:
        return text
    return POLYGON.sub(lambda match: replaced.get(tuple(match[0].split()[1:]), match[0]), text)


def _vertices(text: str) -> np.ndarray:
    """Read the positions of the vertices, (V, 3); none if a line has fewer than three numbers."""
    rows = [line.split()[:3] for line in re.findall(r"^v (.*)", text, re.MULTILINE)]
    try:
        return np.array(rows, np.float64).reshape(-1, 3)
    except ValueError:
        return np.zeros((0, 3))


def _by_form(path: Path, text: str) -> list[str]:
    """Return the text once for each form of its faces, with these faces only, if a material mixes forms.

    trimesh gives a material's faces what all of them have.
    """
    if sum(len(form.findall(text)) for form in FORMS) < len(FACE.findall(text)):
        text = FACE.sub(lambda match: _uniform(path, match[0]), text)
    forms: dict[str, set[int]] = defaultdict(set)
    for chunk in re.split(r"^(?=usemtl )", text, flags=re.MULTILINE):
        name = chunk.partition("\n")[0] if chunk.startswith("usemtl ") else ""
        forms[name.strip()] |= {i for i, form in enumerate(FORMS) if form.search(chunk)}
    if all(len(found) < 2 for found in forms.values()):
        return [text]
    found = sorted(set[int]().union(*forms.values()))
    return [_only(FORMS[i], text) for i in found]


def _only(form: re.Pattern[str], text: str) -> str:
    return FACE.sub(lambda match: match[0] if form.match(match[0]) else "", text)


def _uniform(path: Path, face: str) -> str:
    """Leave to all corners of a face what all of them have."""
    corners = [corner.split("/") for corner in face.partition("#")[0].split()[1:]]
    width = max(map(len, corners), default=0)
    columns = list(zip(*(corner + [""] * (width - len(corner)) for corner in corners)))
    kept = [column if all(column) else [""] * len(corners) for column in columns]
    uniform = "f " + " ".join("/".join(corner).rstrip("/") for corner in zip(*kept))
    if not any(form.match(uniform) for form in FORMS):
        raise ObjectFolderError(
            f"{path}: {shortened(face)!r} is not a face, expected corners such as 1, 1/2, 1//3 or 1/2/3; "
            "export the mesh again"
        )
    return uniform


def _brightest(content: dict[str, Any]) -> float:
    """Return the largest vertex colour of a geometry."""
    colors = content.get("vertex_colors")
    return 0.0 if colors is None else float(np.asarray(colors).max(initial=0))
