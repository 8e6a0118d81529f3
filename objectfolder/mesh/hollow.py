"""Hollow solids with a wall of given thickness, and how thick a solid is; in the unit frame."""

import igl
import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.closing.contour import BLOCK, RESOLUTION, block_centres, contour, grid_indices
from objectfolder.mesh.closing.solids import subtract
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.topology import Mesh, distance

_COARSE = 28  # samples along each axis in which the thickest part is looked for
_REFINED = 6  # halvings of the spacing around the best samples
_KEPT = 16  # of the best samples


def hollow_out(surface: Mesh, wall: float, name: str = "mesh") -> Mesh:
    """Return the wall of a closed surface: what lies within ``wall`` of it, inside; unit frame.

    The inner side is the level set of the distance to the surface, on a grid. Mass and inertia of a sphere, a
    can and a box with a wall of 1 % of the size are right to 1 %.

    Parameters
    ----------
    surface : (V, 3) array and (F, 3) int array
        Closed, oriented outward.
    wall : float
        Thickness of the wall.
    name : str
        Name of the object in errors.

    Raises
    ------
    ObjectFolderError
        If the wall fills the solid, so that nothing is hollow.
    """
    spacing = 2 * BOUND / (RESOLUTION - 1)
    blocks = np.full(3, -(-RESOLUTION // BLOCK))
    lower = np.full(3, -BOUND)
    centres, radius = block_centres(lower, spacing, blocks)
    depth = _depth(surface, centres)
    near = np.flatnonzero(np.abs(depth - wall) < radius + spacing)
    inner = contour(lambda points: wall - _depth(surface, points), lower, spacing, blocks, near, wall - depth)
    if not len(inner[1]):
        raise ObjectFolderError(
            f"{name}: a wall of {wall:.2%} of the size fills the solid, which is at most "
            f"{thickest_part(surface):.2%} of the size thick; expected a wall under half of that"
        )
    return subtract(surface, inner)


def thickest_part(surface: Mesh) -> float:
    """Return the diameter of the largest ball inside a closed surface, to half a percent of the size."""
    low, high = surface[0].min(0), surface[0].max(0)
    spacing = (high - low) / _COARSE
    points = low + spacing * (grid_indices(_COARSE, _COARSE, _COARSE) + 0.5)
    depth = _depth(surface, points)
    for _ in range(_REFINED):
        best = np.argsort(-depth)[:_KEPT]
        spacing = spacing / 2
        around = points[best, None] + spacing * (grid_indices(3, 3, 3) - 1)
        points = np.concatenate([points[best], around.reshape(-1, 3)])
        depth = np.concatenate([depth[best], _depth(surface, around.reshape(-1, 3))])
    return float(2 * depth.max())


def _depth(surface: Mesh, points: np.ndarray) -> np.ndarray:
    """Return the distance to the surface of points (N, 3): positive inside, negative outside."""
    away = distance(surface, points)
    inside = np.asarray(igl.fast_winding_number(*surface, points)) > 0.5
    return np.where(inside, away, -away)
