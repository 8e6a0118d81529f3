"""Find the meshes in a folder and examine each before it is added to a workspace."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from objectfolder.base.checks import check_mass
from objectfolder.base.errors import ObjectFolderError, plural, shortened
from objectfolder.base.materials import own_material
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import FORMATS, default_up, load_mesh
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.sound.fem.settings import VoxelizeConfig
from objectfolder.sound.fem.voxelize import voxelize
from objectfolder.workspace.materials_list import LISTS, read_materials
from objectfolder.workspace.objects import MAX_SCALE, MIN_SCALE, check_new, object_files
from objectfolder.workspace.params import settings

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}  #: metres
SMALL = 0.01  # metres; smallest size that is guessed
LARGE = 2.0  # metres; few objects that are struck and touched are larger
MOVED = 1e-3  # fraction of the size by which closing may move a surface without a note
CLOSED = "closed already"  # in place of the repair step that closed a surface
MOST_SIZES = 4  # closings until the size holds a wall of given metres
SETTLED = 1e-4  # fraction of the size by which it may change then
#: Other formats of shapes, whose files are not read.
UNREAD = (
    ".3ds",
    ".3mf",
    ".blend",
    ".dae",
    ".fbx",
    ".igs",
    ".iges",
    ".step",
    ".stp",
    ".usd",
    ".usda",
    ".usdc",
    ".usdz",
)
SCANS = {
    "google_16k",
    "google_64k",
    "google_512k",
    "poisson",
    "tsdf",
}  #: folders of meshes of one object, of YCB
INNER = {
    "mesh",
    "meshes",
    "model",
    "models",
    "visual",
    *SCANS,
}  #: folders inside an object's, which name none


@dataclass(frozen=True)
class Candidate:
    """A mesh that may become an object."""

    key: str
    mesh: Path
    material: str | None = None
    refusal: str | None = None  #: reason why its location alone rules it out
    others: tuple[Path, ...] = ()  #: further meshes in its folder, of which the one with a texture counts
    size: float | None = None  #: longest side, metres
    up: str | None = None
    wall: float | None = None  #: thickness that open sheets get, metres
    mass: float | None = None  #: of the real object, kg
    licence: str = ""  #: of the mesh
    author: str = ""
    source: str = ""  #: title and address of the mesh


@dataclass(frozen=True)
class Examination:
    """Result of examining a candidate; without a refusal it can be added."""

    candidate: Candidate
    scale: float = 0.0  #: longest side, metres
    up: str = ""
    pieces: int = 0  #: connected pieces of the source's surface
    rung: str = ""  #: repair step that closed its surface
    volume: float = 0.0  #: m^3
    notes: list[str] = field(default_factory=list)
    refusal: str | None = None


def slug(name: str, numbered: bool = False) -> str:
    """Make an object key from a file or folder name: ``025_Mug (blue)`` gives ``mug_blue``.

    Numbers at either end go, unless there is nothing else, or the key is to be numbered: ``obj_000001`` and
    ``025_mug`` give ``obj_000001`` and ``mug_025`` then.
    """
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    words = re.sub(r"[^a-z0-9]+", "_", ascii_name).strip("_")
    key = words.strip("_0123456789")
    if not key:
        return f"object_{words}" if words else "object"
    if not numbered:
        return key
    start = words.index(key)
    return "_".join(part for part in (key + words[start + len(key) :], words[:start].strip("_")) if part)


def discover(folder: Path, material: str | None = None) -> list[Candidate]:
    """Find the objects in a folder: each mesh file directly in it, and each subfolder that holds one.

    Keys are made from file or subfolder names, which keep their numbers where others have the same words.
    Folders such as ``meshes`` or ``google_16k`` belong to the object of the folder above.
    ``materials.csv`` or ``materials.yaml`` in the folder (`objectfolder.workspace.materials_list`) assigns
    materials and more by file, subfolder or key; ``material`` is that of the others. Returns
    candidates by name; those with a duplicate key have a refusal. Raises ObjectFolderError if there is no
    mesh, or the list of materials is invalid or names an unknown object.
    """
    listed = read_materials(folder)
    found = [(path.stem, [path]) for path in _meshes(folder)]
    for child in sorted(path for path in folder.iterdir() if path.is_dir() and path.name[0] != "."):
        inside = _meshes(child) or sorted(p for p in child.rglob("*") if _is_mesh(p))
        numbered = len(inside) > 1 and len({path.parent for path in inside}) == 1
        numbered &= len({slug(path.stem) for path in inside}) == 1 < len({path.stem for path in inside})
        if child.name.lower() in INNER and numbered:  # instances in the folder of a collection
            found += [(path.stem, [path]) for path in inside]
        elif inside:
            found.append((child.name, inside))
    if not found:
        raise ObjectFolderError(
            f"{folder} and its subfolders hold no mesh ({', '.join(FORMATS)}); put each object's mesh there, "
            "or in a subfolder of its own"
        )
    home = folder.resolve()
    inner = all(name.lower() in INNER and inside[0].parent != folder for name, inside in found)
    if inner or home.name.lower() in SCANS or (len(found) == 1 and found[0][1][0].parent == folder):
        name = home.parent.name if home.name.lower() in INNER else home.name
        found = [(name, [mesh for _, inside in found for mesh in inside])]
    words = Counter(slug(name) for name, _ in found)
    keys = [slug(name, numbered=words[slug(name)] > 1) for name, _ in found]
    sharing: dict[str, list[str]] = {}  # names of files and subfolders that give a key
    for key, (name, inside) in zip(keys, found, strict=True):
        own_file = inside[0].parent == folder
        sharing.setdefault(key, []).append(inside[0].name if own_file else f"{name}/")
    candidates, named = [], set()
    for key, (name, inside) in zip(keys, found, strict=True):
        mesh = inside[0]
        own_names = (mesh.stem, home.name) if mesh.parent == folder else ()
        names = [unicodedata.normalize("NFC", one) for one in (name, mesh.name, key, *own_names)]
        named |= {*names}
        refusal = None
        if len(sharing[key]) > 1:
            each = "both" if len(sharing[key]) == 2 else "all"
            refusal = (
                f"{_listed(sharing[key])} in {folder} would {each} be named {key!r}; rename all but one, or "
                "add one by its path"
            )
        given = {"material": material} | next((listed[n] for n in names if n in listed), {})
        candidates.append(Candidate(key, mesh, refusal=refusal, others=tuple(inside[1:]), **given))
    unknown = sorted(set(listed) - named)
    if unknown:
        raise ObjectFolderError(
            f"the list of materials in {folder} names {', '.join(unknown[:5])}, which it does not contain"
        )
    return candidates


def passed_over(folder: Path) -> list[Path]:
    """Return the files of a folder that hold a shape, it seems, but are not read: for none of its objects.

    They are of another format, or links to nothing. Files beside a mesh of their name, or in a subfolder with
    a mesh, are taken for copies.
    """
    known = {path.stem for path in _meshes(folder)}
    found = [path for path in folder.iterdir() if path.stem not in known]
    for child in folder.iterdir():
        if child.is_dir() and child.name[0] != "." and not any(_is_mesh(p) for p in child.rglob("*")):
            found += child.rglob("*")
    shapes = [path for path in found if path.suffix.lower() in (*UNREAD, *FORMATS) and path.name[0] != "."]
    return sorted(path for path in shapes if not _is_mesh(path) and not path.is_dir())


def _listed(names: Sequence[str], most: int = 4) -> str:
    """Join names with commas and "and"; of many, the first."""
    shown = list(names) if len(names) <= most else [*names[: most - 1], f"{len(names) - most + 1} more"]
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def _is_mesh(path: Path) -> bool:
    return path.suffix.lower() in FORMATS and path.name[0] != "." and path.is_file()


def _meshes(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if _is_mesh(path))


def examine(
    candidate: Candidate,
    values: dict[str, Any],
    scale: float | None,
    up: str | None,
    unit: str = "m",
    wall: float | None = None,
    bridge: str = "all",
) -> Examination:
    """Load a candidate's mesh, close its surface and voxelize it in memory.

    ``values``: contents of ``params.yaml``; ``scale``: longest side, metres, None takes the mesh's own;
    ``up``: None guesses from the file format; ``unit``: of the mesh's coordinates; ``wall``: thickness that
    open sheets get, metres; ``bridge``: where to fill small gaps, "all", "fem" or "off". What the candidate
    itself says of the first three comes first. Raises ObjectFolderError if it cannot become an object.
    """
    if candidate.refusal is not None:
        raise ObjectFolderError(candidate.refusal)
    key, mesh = candidate.key, candidate.mesh
    scale, up, wall = candidate.size or scale, candidate.up or up, candidate.wall or wall
    check_new(key, values, mesh=mesh)
    if candidate.material is None:
        raise ObjectFolderError(f"{key} has no material; give --material, or list it in {LISTS[0]}")
    own_material(candidate.material)
    texture_size = settings(NormalizeConfig, values).texture_size
    found = []
    if candidate.others:
        mesh = _textured_mesh((mesh, *candidate.others))
        count = 1 + len(candidate.others)
        found.append(f"of the {count} meshes in its folder, {mesh.name} alone has a texture or colours")
        candidate = replace(candidate, mesh=mesh, others=())
    folders = {source.parent: source for source in object_files(mesh).values()}
    found += [
        f"{source.name} is taken from {os.path.relpath(parent, mesh.parent)}"
        for parent, source in folders.items()
        if ".." in source.relative_to(mesh.parent).parts
    ]
    loaded = load_mesh(mesh, up or default_up(mesh), texture_size)
    lower, upper = loaded.bounds
    own = float((upper - lower).max())
    size = float(f"{own * UNITS[unit]:.6g}") if scale is None else scale
    if not MIN_SCALE <= size <= MAX_SCALE:
        raise ObjectFolderError(
            f"scale of {key} is {size:g} m, expected the longest side in metres, {MIN_SCALE} to {MAX_SCALE}; "
            + (_size_in_other_units(own, unit) if scale is None else _in_metres(scale))
        )
    if wall is not None and wall >= size / 2:
        raise ObjectFolderError(
            f"wall of {key} is {wall:g} m, expected less than half of its size, {size:g} m; give it in metres"
        )
    for _ in range(MOST_SIZES):
        normalized = normalize(loaded, key, wall and wall / size, bridge != "off", size)
        reached = float(f"{normalized.source_size * UNITS[unit]:.6g}")
        # With the size that was given the mesh shrinks into its walls. Its own size grows by them instead.
        if scale is not None or normalized.source_size <= own or abs(reached - size) <= SETTLED * size:
            break
        size = reached
    config = settings(VoxelizeConfig, values)
    voxelize(normalized.select_visible(bridge), normalized.surface.mesh, config, key)  # raises
    report = normalized.report(size, up or default_up(mesh))
    if candidate.mass is not None:
        check_mass(key, candidate.mass, report["volume_m3"])
    notes = [*found, *report["warnings"], *report["appearance"].get("notes", [])]
    if size > LARGE:
        remedy = _size_in_other_units(own, unit) if scale is None else _in_metres(scale)
        notes.insert(0, f"{size:.3g} m is large: {remedy}")
    if holes := normalized.surface.holes:
        notes.append(f"{plural(holes, 'hole')} capped: the piece is solid; give --wall for a shell")
    if crossing := report["self_intersections"]:
        notes.append(f"the surface intersects itself ({plural(crossing, 'edge')})")
    if report["deviation_max_m"] > MOVED * size:
        notes.append(f"closing it moved its surface by up to {report['deviation_max_m'] * 1000:.2g} mm")
    welded = [rung["components_after"] for rung in report["rungs"] if rung["name"] == "clean"]
    pieces = welded[0] if welded else report["components"]
    return Examination(
        candidate, size, report["source_up"], pieces, report["rung"], report["volume_m3"], notes
    )


def _textured_mesh(meshes: Sequence[Path]) -> Path:
    """Return the only mesh of an object that has a texture, or if none has one, vertex colours.

    Raises
    ------
    ObjectFolderError
        If there are several, or none can be told from the others.
    """
    ranks: dict[Path, int] = {}
    for mesh in meshes:
        with suppress(ObjectFolderError):  # one that cannot be read is not the one
            loaded = load_mesh(mesh)
            colors = loaded.vertex_colors
            textured = loaded.texture is not None and loaded.texture.size > 3
            ranks[mesh] = 2 if textured else int(colors is not None and bool((colors != colors[0]).any()))
    best = [mesh for mesh in meshes if ranks.get(mesh) == max(ranks.values(), default=None)]
    if len(best) == 1:
        return best[0]
    home = Path(os.path.commonpath([mesh.parent for mesh in meshes]))
    kept = ", ".join(str(mesh.relative_to(home.parent)) for mesh in meshes[:4])
    alike = f"{len(best)} have a texture or colours" if any(ranks.values()) else "none has a texture"
    raise ObjectFolderError(
        f"{home} holds {len(meshes)} meshes ({kept}), of which {alike}; keep one, or add one by its path"
    )


def _fitting_units(length: float) -> list[str]:
    """Return the units in which a length would be that of a plausible object."""
    return [unit for unit in UNITS if SMALL <= length * UNITS[unit] <= LARGE]


def _size_in_other_units(own: float, unit: str) -> str:
    """Say what to do about a mesh whose size is not plausible in a unit."""
    fitting = [f"{own:.4g} {other}" for other in _fitting_units(own)]
    guess = f"perhaps it is {' or '.join(fitting)}; " if fitting else ""
    return f"{guess}give {'--unit' if unit == 'm' else 'another --unit'} or --scale"


def _in_metres(scale: float) -> str:
    """Say what to do about a scale that is not plausible in metres."""
    guesses = [f"{scale * UNITS[unit]:.4g} for {scale:.4g} {unit}" for unit in _fitting_units(scale)]
    return "give it in metres" + (f": {' or '.join(guesses)}" if guesses else "")


def examine_all(
    candidates: Sequence[Candidate],
    values: dict[str, Any],
    up: str | None = None,
    unit: str = "m",
    wall: float | None = None,
    bridge: str = "all",
) -> Iterator[Examination]:
    """Examine candidates one by one; those that cannot be added give an examination with a refusal."""
    for candidate in candidates:
        try:
            yield examine(candidate, values, None, up, unit, wall, bridge)
        except ObjectFolderError as error:
            yield Examination(candidate, refusal=str(error))
        except Exception as error:  # whatever one mesh raises, the others are examined
            reason = f"{candidate.mesh} cannot be examined ({type(error).__name__}: {shortened(error, 200)})"
            yield Examination(candidate, refusal=reason)


def examination_table(examinations: Sequence[Examination], up_given: bool) -> Table:
    """Format examinations as a table."""
    guessed = [shown.refusal is None and not (up_given or shown.candidate.up) for shown in examinations]
    caption = "? guessed" if any(guessed) else None
    result = Table(box=SIMPLE_HEAD, show_edge=False, padding=0, caption=caption)
    numbers = ("size\nm", "pieces", "volume\ncm³")
    for name in ("object", "material", "size\nm", "up", "pieces", "closed by", "volume\ncm³"):
        # In a narrow terminal names take more lines; numbers stay whole.
        whole = name in (*numbers, "up")
        result.add_column(
            name, justify="right" if name in numbers else "left", overflow="fold", no_wrap=whole
        )
    for shown, guess in zip(examinations, guessed):
        candidate = shown.candidate
        row: list[str | Text] = [candidate.key, candidate.material or "?"]
        if shown.refusal is not None:
            row.append(Text("refused", style="bold red"))
        else:
            row += [
                _digits(shown.scale),
                shown.up + "?" * guess,
                str(shown.pieces),
            ]
            row += [CLOSED if shown.rung == "keep" else shown.rung, _digits(shown.volume * 1e6)]
        result.add_row(*row)
    return result


def _digits(value: float) -> str:
    """Return a number with four digits, such as ``2,549`` or ``0.0615``."""
    return f"{float(f'{value:.4g}'):,.10g}"
