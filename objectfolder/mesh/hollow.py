"""Hollow solids with a wall of given thickness, and how thick a solid is; in the unit frame."""

import igl
import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.closing.contour import BLOCK, RESOLUTION, block_centres, contour, grid_indices
from objectfolder.mesh.closing.solids import subtract
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.raycast import cross_walls
from objectfolder.mesh.sdf import near_surface
from objectfolder.mesh.topology import Mesh, distance

_STEPS = 0.02 * 0.5 ** np.arange(4)  # by which the middle of the largest ball is sought
_TRIED, _KEPT = 200, 4  # middles of walls, of which there are more; the best of them


def hollow_out(surface: Mesh, wall: float, name: str = "mesh") -> Mesh:
    """Return the wall of a closed surface: what lies within ``wall`` of it, inside; unit frame.

    The inner side is the level set of the distance to the surface, on a grid. Mass and inertia of a box
    and a can with a wall of half a percent of the size are right to 1 %.

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
    thickest = thickest_part(surface)
    if 2 * wall >= thickest:
        raise ObjectFolderError(
            f"{name}: a wall of {wall:.2%} of the size fills the solid, which is at most {thickest:.2%} of "
            "the size thick; expected a wall under half of that"
        )
    spacing = 2 * BOUND / (RESOLUTION - 1)
    blocks, lower = np.full(3, -(-RESOLUTION // BLOCK)), np.full(3, -BOUND)
    samples = near_surface(surface, RESOLUTION, 2 * spacing, wall)
    near = np.unique((samples // BLOCK) @ [blocks[1] * blocks[2], blocks[2], 1])
    # The level set is in none of the other blocks.
    centres, _ = block_centres(lower, spacing, blocks)
    within = np.asarray(igl.fast_winding_number(*surface, centres)) > 0.5
    far = np.where(within, -1.0, 1.0)
    if wall > 2 * spacing:  # some may be in the wall
        far[within] = wall - distance(surface, centres[within])
    inner = contour(lambda at: wall - _depth(surface, at), lower, spacing, blocks, near, far)
    return subtract(surface, inner)


def thickest_part(surface: Mesh) -> float:
    """Return the diameter of the largest ball inside a closed surface, to a percent of the size."""
    points, lengths = cross_walls(*surface)
    # In balls and cylinders each takes as long as a comparison with every face.
    points = points[np.isfinite(lengths)][:_TRIED]
    depth = distance(surface, points)
    for step in _STEPS:
        best = np.argsort(-depth)[:_KEPT]
        steps = np.repeat(step * (grid_indices(3, 3, 3) - 1)[None], len(best), 0)
        inside = np.linalg.norm(steps, axis=2) < depth[best, None]  # one step at least, that of no length
        points = (points[best, None] + steps)[inside]
        depth = distance(surface, points)
    return float(2 * depth.max())


def _depth(surface: Mesh, points: np.ndarray) -> np.ndarray:
    """Return the distance to the surface of points (N, 3): positive inside, negative outside."""
    away = distance(surface, points)
    inside = np.asarray(igl.fast_winding_number(*surface, points)) > 0.5
    return np.where(inside, away, -away)
