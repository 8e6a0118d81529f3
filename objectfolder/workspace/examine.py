"""Examine a mesh before it becomes an object: load it, close its surface, and see whether it can be built."""

import os
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
from objectfolder.mesh.normalize import Normalized, normalize
from objectfolder.mesh.reading.load import default_up, load_mesh
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.sound.fem.settings import VoxelizeConfig
from objectfolder.sound.fem.voxelize import voxelize
from objectfolder.workspace.materials_list import LISTS
from objectfolder.workspace.objects import MAX_SCALE, MIN_SCALE, check_new, object_files
from objectfolder.workspace.params import settings

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}  #: metres
SMALL = 0.01  # metres; smallest size that is guessed
LARGE = 2.0  # metres; few objects that are struck and touched are larger
MOVED = 1e-3  # fraction of the size by which closing may move a surface without a note
CLOSED = "closed already"  # in place of the repair step that closed a surface
MOST_SIZES = 4  # closings until the size holds a wall of given metres
SETTLED = 1e-4  # fraction of the size by which it may change then


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
    shell: float | None = None  #: wall of a hollow object whose mesh is closed, metres; of assets alone
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


@dataclass(frozen=True)
class ClosedCandidate:
    """A candidate whose surface is closed."""

    candidate: Candidate  #: of its meshes, the one that counts
    normalized: Normalized
    scale: float  #: longest side, metres
    up: str
    report: dict[str, Any]  #: content of ``normalize.json``
    notes: list[str]


def close_candidate(
    candidate: Candidate,
    texture_size: int,
    scale: float | None,
    up: str | None,
    unit: str = "m",
    wall: float | None = None,
    bridge: str = "all",
) -> ClosedCandidate:
    """Load a candidate's mesh and close its surface.

    ``scale``: longest side, metres, None takes the mesh's own; ``up``: None guesses from the file format;
    ``unit``: of the mesh's coordinates; ``wall``: thickness that open sheets get, metres; ``bridge``: where
    to fill small gaps, "all", "fem" or "off". What the candidate itself says of scale, up and wall comes
    first. Raises ObjectFolderError if the mesh cannot be read or closed, or its size is not plausible.
    """
    key, mesh = candidate.key, candidate.mesh
    scale, up, wall = candidate.size or scale, candidate.up or up, candidate.wall or wall
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
    report = normalized.report(size, up or default_up(mesh))
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
    return ClosedCandidate(candidate, normalized, size, report["source_up"], report, notes)


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

    ``values``: contents of ``params.yaml``; the others are as of `close_candidate`. Raises ObjectFolderError
    if it cannot become an object.
    """
    if candidate.refusal is not None:
        raise ObjectFolderError(candidate.refusal)
    key = candidate.key
    check_new(key, values, mesh=candidate.mesh)
    if candidate.material is None:
        raise ObjectFolderError(f"{key} has no material; give --material, or list it in {LISTS[0]}")
    if candidate.shell is not None:
        raise ObjectFolderError(
            f"{key}: shell is {candidate.shell:g} m, which `objectfolder asset` knows alone; here give the "
            "mass of the real object as mass, or a mesh with its inner surface"
        )
    own_material(candidate.material)
    texture_size = settings(NormalizeConfig, values).texture_size
    closed = close_candidate(candidate, texture_size, scale, up, unit, wall, bridge)
    config = settings(VoxelizeConfig, values)
    normalized, report = closed.normalized, closed.report
    voxelize(normalized.select_visible(bridge), normalized.surface.mesh, config, key)  # raises
    if candidate.mass is not None:
        check_mass(key, candidate.mass, report["volume_m3"])
    welded = [rung["components_after"] for rung in report["rungs"] if rung["name"] == "clean"]
    pieces = welded[0] if welded else report["components"]
    volume = report["volume_m3"]
    return Examination(
        closed.candidate, closed.scale, closed.up, pieces, report["rung"], volume, closed.notes
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
