"""Bring a source mesh into the unit frame and derive its closed physical surface."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import trimesh

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.closing.piercing import self_intersections
from objectfolder.mesh.closing.surface import ClosedSurface, RepairStep, close_surface
from objectfolder.mesh.textured import TexturedMesh, appearance_report
from objectfolder.mesh.topology import Mesh

OUTSIDE = 4e-5  #: of the size; a closed surface that reaches beyond the mesh's box by more is centred anew
MOST_CLOSINGS = 5
SHORT = 0.01  #: of the size; a closed surface further from a side of the mesh's box lost a piece there


@dataclass(frozen=True)
class Normalized:
    """Object in the unit frame: longest side 1, bounding box centred on the origin, z up."""

    visual: TexturedMesh
    surface: ClosedSurface
    source_centre: np.ndarray  #: (3,) centre of the bounding box, in the z-up source's units
    source_size: float  #: longest side of the bounding box, in the source's units

    def select_visible(self, bridge: str) -> Mesh:
        """Return the surface to see and touch; it lacks the bridges that are for sound only."""
        return (bridge == "fem" and self.surface.unbridged) or self.surface.mesh

    def report(self, scale: float, up: str) -> dict[str, Any]:
        """Return the content of ``normalize.json``; entries named ``*_m`` are in metres."""
        surface = self.surface
        return {
            "scale_m": scale,
            "source_up": up,
            "source_centre": self.source_centre.tolist(),
            "source_size": self.source_size,
            "rung": surface.last_step,
            "rungs": [_in_metres(step, scale) for step in surface.repairs],
            "warnings": surface.warnings,
            "weld_tolerance": surface.weld_tolerance,
            "deviation_max_m": surface.deviation_max * scale,
            "deviation_max_percent": surface.deviation_max * 100,
            "deviation_mean_m": surface.deviation_mean * scale,
            "deviation_mean_percent": surface.deviation_mean * 100,
            "volume_m3": surface.volume * scale**3,
            "solid": mass_properties(surface.mesh),
            "components": surface.components,
            "cavities": surface.cavities,
            "overlap_fraction": surface.certificate.outside_fraction,
            "self_intersections": self_intersections(*surface.mesh),
            "vertices": len(surface.vertices),
            "faces": len(surface.faces),
            "visual_faces": len(self.visual.faces),
            "appearance": appearance_report(self.visual),
        }


def normalize(
    mesh: TexturedMesh,
    name: str = "mesh",
    wall: float | None = None,
    bridging: bool = True,
    scale: float | None = None,
) -> Normalized:
    """Centre and scale a z-up mesh to the unit frame and close its surface.

    The box is that of the mesh, and of the walls of sheets that reach beyond it.

    Parameters
    ----------
    mesh : TexturedMesh
        In any unit.
    name : str
        Name of the object in errors.
    wall : float, optional
        Thickness given to visible open sheets, unit frame.
    bridging : bool
        Whether gaps narrower than half an FEM cell are filled.
    scale : float, optional
        Longest side in metres, for warnings.

    Raises
    ------
    ObjectFolderError
        If the surface cannot be closed into one solid, or is smaller than the mesh because a piece at a side
        of the box was dropped.
    """
    lower, upper = mesh.bounds
    for _ in range(MOST_CLOSINGS):  # a wall grows with the box, by less each time
        centre, size = (lower + upper) / 2, float((upper - lower).max())
        visual = mesh.with_vertices((mesh.vertices - centre) / size)
        surface = close_surface(visual.vertices, visual.faces, name, wall, bridging, scale)
        reached = size * np.array([surface.vertices.min(0), surface.vertices.max(0)]) + centre
        beyond = max((lower - reached[0]).max(), (reached[1] - upper).max())
        if beyond <= OUTSIDE * size:
            break
        lower, upper = np.minimum(lower, reached[0]), np.maximum(upper, reached[1])
    done = Normalized(visual, surface, centre, size)
    _check_box(done, name)
    return done


def _check_box(done: Normalized, name: str) -> None:
    """Raise if a piece that set the box, and so centre and size, is not in the closed surface."""
    lower, upper = np.min(done.surface.vertices, axis=0), np.max(done.surface.vertices, axis=0)
    used = done.visual.vertices[np.unique(done.visual.faces)]
    beyond = np.maximum(lower - used, used - upper).max(1)
    furthest = int(beyond.argmax())
    if beyond[furthest] > SHORT:
        place = used[furthest] * done.source_size + done.source_centre
        raise ObjectFolderError(
            f"{name}: closing dropped what lies at ({', '.join(f'{c:.4g}' for c in place)}) of the mesh (its "
            f"units, z up), and the closed surface has {(upper - lower).max():.1%} of the mesh's size; "
            "expected it to reach all sides of the mesh's box, which sets centre and size: delete that "
            "piece, or join it to the rest as a solid"
        )


def mass_properties(surface: Mesh) -> dict[str, Any]:
    """Compute the mass properties of a closed surface, at density 1, in its frame.

    ``volume``, ``centre`` [x, y, z], and ``inertia`` [xx, yy, zz, xy, xz, yz] about the centre.
    """
    found = trimesh.Trimesh(*surface, process=False).mass_properties
    inertia = np.asarray(found.inertia)
    return {
        "volume": float(found.volume),
        "centre": np.asarray(found.center_mass).tolist(),
        "inertia": inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist(),
    }


def _in_metres(step: RepairStep, scale: float) -> dict[str, Any]:
    values = asdict(step)
    for name in ("volume_before", "volume_after"):
        volume = values.pop(name)
        values[f"{name}_m3"] = None if volume is None else volume * scale**3
    for name in ("deviation_max", "deviation_mean"):
        deviation = values.pop(name)
        values |= {f"{name}_m": deviation * scale, f"{name}_percent": deviation * 100}
    return values
