"""Closed physical surface from any triangle mesh, by a series of repairs that avoids remeshing.

clean -> cap, thicken -> union -> untangle -> grid -> specks -> bridge -> specks: each step is used only where
needed. Remeshing on a grid fills cavities and doubles thin walls, so it is the last resort and gives a
warning. All lengths are in the unit frame (longest side 1).
"""

from dataclasses import dataclass, field, replace

import igl
import numpy as np

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.mesh.closing.contour import RESOLUTION, remesh_on_grid
from objectfolder.mesh.closing.holes import NOTED_HOLE, close_piece, visible_loops
from objectfolder.mesh.closing.solids import SPECKS, bridge, drop_specks, label_bodies, unite, untangle
from objectfolder.mesh.closing.weld import clean, opposite_pairs
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.scanline import Certificate, check_winding, winding_certificate
from objectfolder.mesh.topology import (
    Mesh,
    compact,
    connected_pieces,
    distance,
    edge_defects,
    face_areas,
    face_components,
    is_closed,
    join_meshes,
    signed_volume,
)

BRIDGED_GAP = 1 / 64  #: half a cell of the finest FEM grid
SHEET_WALL = 0.02  #: default thickness of a sheet
MAX_OPEN_PIECES = 256  #: more make a triangle soup, whose holes and gaps are indistinguishable
MAX_BODIES = 128  #: more are not bridged: each bridge takes the better part of a second
LEFT_OUT = 1e-3  #: of the size; cancelled faces further from the closed surface are noted
CRUMB = 0.01  #: area fraction below which an open piece is never a sheet
_PROBES = 20_000  # points at which the deviation is measured


@dataclass(frozen=True)
class RepairStep:
    """Step of the repair that changed the mesh."""

    name: str  #: clean, cap, thicken, union, untangle, specks, bridge or grid
    detail: str  #: description of the change
    components_before: int
    components_after: int
    volume_before: float | None  #: None while the mesh is open
    volume_after: float | None
    deviation_max: float  #: between the mesh after this step and the source mesh, both ways
    deviation_mean: float  #: area-weighted, from the mesh after this step to the source mesh


@dataclass(frozen=True)
class ClosedSurface:
    """Closed, outward-oriented triangle surface with the record of its repairs."""

    vertices: np.ndarray  #: (V, 3) float64
    faces: np.ndarray  #: (F, 3) int64
    repairs: list[RepairStep]
    weld_tolerance: float
    certificate: Certificate  #: that it is closed, with winding numbers 0 and 1
    warnings: list[str] = field(default_factory=list)
    unbridged: Mesh | None = None  #: mesh before gaps were bridged, if any
    holes: int = 0  #: visible ones that were capped for want of a wall: what they open became solid

    @property
    def mesh(self) -> Mesh:
        """Vertices and faces."""
        return self.vertices, self.faces

    @property
    def volume(self) -> float:
        """Enclosed volume."""
        return signed_volume(self.vertices, self.faces)

    @property
    def components(self) -> int:
        """Number of solid bodies."""
        return len(label_bodies(self.vertices, self.faces)[1])

    @property
    def cavities(self) -> int:
        """Number of closed hollows inside."""
        return int(face_components(self.faces, len(self.vertices)).max()) + 1 - self.components

    @property
    def last_step(self) -> str:
        """Name of the last step other than ``clean``; ``keep`` if there is none."""
        return next((r.name for r in reversed(self.repairs) if r.name != "clean"), "keep")

    @property
    def deviation_max(self) -> float:
        """Largest distance between this surface and the source mesh."""
        return self.repairs[-1].deviation_max

    @property
    def deviation_mean(self) -> float:
        """Area-weighted mean distance from this surface to the source mesh."""
        return self.repairs[-1].deviation_mean


def close_surface(
    vertices: np.ndarray,
    faces: np.ndarray,
    name: str = "mesh",
    wall: float | None = None,
    bridging: bool = True,
    scale: float | None = None,
) -> ClosedSurface:
    """Turn the triangles of a mesh into one closed solid.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    name : str
        Name of the object in errors.
    wall : float, optional
        Thickness given to visible sheets; default: `SHEET_WALL`, with a warning. If it is given and no
        opening is large, the largest visible hole is one, such as the mouth of a bottle.
    bridging : bool
        Whether gaps below `BRIDGED_GAP` between pieces are filled.
    scale : float, optional
        Size in metres, for warnings.

    Raises
    ------
    ObjectFolderError
        Unless the result is closed, has winding number 0 or 1, and one body holds 99.9 % of its volume. The
        message lists the pieces with their volumes and gaps.
    """
    repair = _Repair(name, np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    tolerance = repair.clean()
    openings = repair.close_pieces(SHEET_WALL if wall is None else wall, asked=wall is not None)
    if openings and wall is None:
        metres = "" if scale is None else f" ({SHEET_WALL * scale:.3g} m)"
        repair.warnings.append(
            f"{plural(openings, 'open sheet')} got a wall of {SHEET_WALL:.0%} of the size{metres}; "
            "set `wall` in metres, or close the hole in the mesh, if it is solid"
        )
    if wall is not None and not openings:
        thickness = f"{wall:.2%} of the size" if scale is None else f"{wall * scale:.3g} m"
        repair.warnings.append(
            f"no piece is an open sheet with room for a wall of {thickness}: `wall` is not used"
        )
    repair.join()
    if not repair.solid:
        repair.untangle()
    if not repair.solid:
        repair.remesh(openings and (SHEET_WALL if wall is None else wall))
    # Small parts, such as knobs, may be within reach of a bridge; crumbs are not worth one.
    repair.drop_specks(BRIDGED_GAP if bridging else np.inf)
    before = bridged = repair.mesh
    if bridging:
        repair.bridge()
        bridged = repair.mesh
        repair.drop_specks()
    repair.accept(bridging)
    repair.note_cancelled()
    return ClosedSurface(
        *repair.mesh,
        repair.repairs,
        tolerance,
        winding_certificate(*repair.mesh),
        repair.warnings,
        None if before is bridged else before,
        repair.holes,
    )


class _Repair:
    """Mesh under repair, with the record of its steps."""

    def __init__(self, name: str, vertices: np.ndarray, faces: np.ndarray):
        self.name, self.source, self.mesh = name, (vertices, faces), (vertices, faces)
        self.repairs: list[RepairStep] = []
        self.warnings: list[str] = []
        self.cancelled: Mesh = (vertices, faces[:0])  # faces that their reversed copies cancelled
        self.holes = 0  # visible ones that were capped
        self.moved = 0.0  # by welding; deviations are measured from the welded mesh

    @property
    def solid(self) -> bool:
        v, f = self.mesh
        return len(f) > 0 and is_closed(f) and signed_volume(v, f) > 0 and winding_certificate(v, f).solid

    def clean(self) -> float:
        before = self.mesh
        mesh, tolerance, self.moved = clean(*before)
        lost = len(before[1]) - len(mesh[1])
        if face_areas(*mesh).sum() == 0:
            welded = f", {len(mesh[1])} of them not degenerate" if lost else ""
            raise ObjectFolderError(
                f"{self.name}: the mesh has {plural(len(before[1]), 'face')}{welded}, without any area; "
                "expected a mesh that encloses a volume, or a sheet"
            )
        self.source = mesh
        if lost:
            self.cancelled = opposite_pairs(*before, tolerance)
        detail = f"welded at {tolerance:g}" + (
            f", {lost} degenerate or doubled faces dropped" if lost else ""
        )
        self._record("clean", detail, (before[0], before[1][:0]), mesh)
        return tolerance

    def close_pieces(self, wall: float, asked: bool) -> int:
        """Cap or thicken open pieces; return the number of sheets.

        Where a wall is asked for and none is a sheet, the one with the largest visible hole is.
        """
        pieces = connected_pieces(*self.mesh)
        defects = [edge_defects(f) for _, f in pieces]
        is_open = [boundary > 0 and not crowded for boundary, crowded, _ in defects]
        if not any(is_open):
            return 0
        if sum(is_open) > MAX_OPEN_PIECES:
            return 0  # a triangle soup: only the grid remains
        before, scene = self.mesh, RayCaster(*self.mesh)
        total = face_areas(*before).sum()
        shown = [
            i for i, piece in enumerate(pieces) if is_open[i] and face_areas(*piece).sum() > CRUMB * total
        ]
        closed = {
            i: close_piece(piece, scene, wall, *([] if i in shown else [np.inf]))
            for i, piece in enumerate(pieces)
            if is_open[i]
        }
        solid = [i for i in shown if not closed[i][2]]
        if asked and len(solid) == len(shown) > 0:
            mouths = {i: next(visible_loops(pieces[i], scene), 0.0) for i in shown}
            widest = max(shown, key=lambda i: mouths[i] * face_areas(*pieces[i]).sum())
            if mouths[widest]:
                closed[widest] = close_piece(pieces[widest], scene, wall, mouths[widest] * (1 - 1e-9))
        if not asked:
            self.holes = sum(1 for i in solid for _ in visible_loops(pieces[i], scene, NOTED_HOLE))
        for i, (piece, _, _) in closed.items():
            pieces[i] = piece
        capped = sum(holes for _, holes, _ in closed.values())
        sheets = sum(openings > 0 for _, _, openings in closed.values())
        detail = [f"{capped} holes capped"] if capped else []
        detail += [f"{sheets} sheets given a wall of {wall:.2%} of the size"] if sheets else []
        self._record(
            "thicken" if sheets else "cap",
            f"{', '.join(detail)} in {sum(is_open)} open of {len(pieces)} pieces",
            before,
            join_meshes(pieces),
        )
        return sheets

    def join(self) -> None:
        pieces, before = connected_pieces(*self.mesh), self.mesh
        broken = [f for _, f in pieces if not is_closed(f)]
        if broken:
            return  # only the grid remains
        if len(pieces) > 1:
            mesh, cavities = unite(pieces)
            detail = f"{len(pieces) - cavities} solids and {cavities} cavities"
            self._record("union", detail, before, mesh)
        elif signed_volume(*before) < 0:
            v, f = before
            self.mesh = (v, np.ascontiguousarray(f[:, ::-1]))

    def untangle(self) -> None:
        before = self.mesh
        if len(before[1]) and is_closed(before[1]):
            mesh = untangle(*before)
            if len(mesh[1]):
                self._record("untangle", "cut where it overlaps itself, and united", before, mesh)

    def remesh(self, wall: float) -> None:
        v, f = self.mesh
        if len(f) and is_closed(f) and not winding_certificate(v, f).columns:
            check_winding(v, f, self.name)  # raises: too thin for any grid
        mesh = remesh_on_grid(*self.source, wall)
        self._refuse_empty(mesh)
        detail = f"remeshed at {RESOLUTION}^3"
        self.warnings.append(f"{detail}: thin walls and cavities may be lost")
        self._record("grid", detail, (mesh[0], mesh[1][:0]), mesh)

    def _refuse_empty(self, mesh: Mesh) -> None:
        if len(mesh[1]) == 0:
            raise ObjectFolderError(
                f"{self.name}: encloses nothing ({self._history()}); expected a mesh that encloses a volume: "
                "close its holes or give it thickness"
            )

    def drop_specks(self, across: float = np.inf) -> None:
        before = self.mesh
        self._refuse_empty(before)
        mesh, dropped = drop_specks(*before, across)
        if dropped:
            share = 1 - signed_volume(*mesh) / signed_volume(*before)
            detail = f"{plural(dropped, 'piece')} with {share:.2e} of the volume dropped"
            self._record("specks", detail, before, mesh)

    def bridge(self) -> None:
        before = self.mesh
        if 1 < len(label_bodies(*before)[1]) <= MAX_BODIES:
            mesh, bridged = bridge(*before, BRIDGED_GAP)
            if bridged:
                detail = f"{plural(len(bridged), 'gap')} up to {max(bridged):.3%} of the size filled"
                self._record("bridge", detail, before, mesh)

    def accept(self, bridging: bool) -> None:
        v, f = self.mesh
        if not self.solid:
            overlap = winding_certificate(v, f).outside_fraction
            raise ObjectFolderError(
                f"{self.name}: could not be closed into a solid ({self._history()}): "
                f"it has {plural(sum(edge_defects(f)), 'edge')} open or shared by more than two faces, and "
                f"overlaps itself in {overlap:.2%} of the space; expected a mesh that encloses a volume "
                "once: close its holes or give it thickness"
            )
        body, volumes = label_bodies(v, f)
        if volumes[0] >= (1 - SPECKS) * volumes.sum():
            return
        pieces = [compact(v, f[body == k]) for k in range(len(volumes))]
        lines = []
        for k, volume in enumerate(volumes[:8]):
            gap, other = min((distance(p, pieces[k][0]).min(), i) for i, p in enumerate(pieces) if i != k)
            centre = ", ".join(f"{c:.2f}" for c in (pieces[k][0].min(0) + pieces[k][0].max(0)) / 2)
            lines.append(
                f"piece {k + 1} at ({centre}) holds {volume / volumes.sum():.1%} of the volume, "
                f"{gap:.2%} of the size away from piece {other + 1}"
            )
        lines += [f"and {len(volumes) - 8} more"] if len(volumes) > 8 else []
        remedy = (
            f"gaps under {BRIDGED_GAP:.1%} are bridged, these are wider: join the pieces in the mesh"
            if bridging
            else "bridging is off for this object; set `bridge: all` or `bridge: fem`"
        )
        if len(volumes) > MAX_BODIES:
            remedy = f"more than {MAX_BODIES} pieces are not bridged: join them"
        raise ObjectFolderError(
            f"{self.name}: {len(volumes)} separate pieces, expected one that holds 99.9 % of the volume: "
            f"{'; '.join(lines)}; {remedy}"
        )

    def note_cancelled(self) -> None:
        """Warn of faces that their reversed copies cancelled, and that are not inside the solid."""
        if len(self.cancelled[1]) == 0:
            return
        probes = sample_surface(*self.cancelled, _PROBES, np.random.default_rng(0))
        away = float(_away(self.mesh, probes).max())
        if away > LEFT_OUT:
            self.repairs[-1] = replace(
                self.repairs[-1], deviation_max=max(away, self.repairs[-1].deviation_max)
            )
            self.warnings.append(
                f"faces up to {away:.2%} of the size from the closed surface have reversed copies, with "
                "which they enclose nothing, and are left out: delete the copies in the mesh, or "
                "give that part thickness"
            )

    def _history(self) -> str:
        return ", ".join(step.detail for step in self.repairs)

    def _record(self, name: str, detail: str, before: Mesh, after: Mesh) -> None:
        maximum, mean = (0.0, 0.0) if after is self.source else _deviation(after, self.source)
        volumes = [signed_volume(v, f) if len(f) and is_closed(f) else None for v, f in (before, after)]
        step = RepairStep(
            name,
            detail,
            components_before=_pieces(before),
            components_after=_pieces(after),
            volume_before=volumes[0],
            volume_after=volumes[1],
            deviation_max=maximum + self.moved,
            deviation_mean=mean,
        )
        self.repairs.append(step)
        self.mesh = after


def _pieces(mesh: Mesh) -> int:
    return int(face_components(mesh[1], len(mesh[0])).max(initial=-1)) + 1


def _deviation(mesh: Mesh, source: Mesh) -> tuple[float, float]:
    """Measure the largest and mean distance between a mesh and its source.

    Parts of the source inside the solid (united pieces) do not count.
    """
    if len(mesh[1]) == 0:
        return 0.0, 0.0
    rng = np.random.default_rng(0)
    probes = sample_surface(*mesh, _PROBES, rng)
    corners = mesh[0] if len(mesh[0]) <= _PROBES else rng.choice(mesh[0], _PROBES, replace=False)
    there = distance(source, np.concatenate([probes, corners]))
    back_probes = sample_surface(*source, _PROBES, rng)
    back = _away(mesh, back_probes)
    return float(max(there.max(), back.max())), float(there[:_PROBES].mean())


def _away(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Compute the distances of points to a closed mesh; 0 inside."""
    away = distance(mesh, points)
    far = np.flatnonzero(away > 1e-9)
    if len(far):
        inside = np.asarray(igl.fast_winding_number(*mesh, points[far])) > 0.5
        away[far[inside]] = 0
    return away
