"""Remeshing on a grid, the last resort: thin walls and cavities may be lost."""

import igl
import numpy as np

from objectfolder.mesh.closing.contour import BLOCK, block_centres, contour
from objectfolder.mesh.closing.solids import distance
from objectfolder.mesh.topology import Mesh, signed_volume

RESOLUTION = 192  #: samples along each axis
_BOUND = 0.52


def remesh_on_grid(vertices: np.ndarray, faces: np.ndarray, wall: float = 0.0) -> Mesh:
    """Extract the surface of the points with generalised winding number above 1/2 or close to a sheet.

    Takes any triangle soup in the unit frame, and turns it over if its volume is negative. If ``wall`` is
    positive, points closer to the mesh than half of it also count as inside, for sheets. The mesh is
    closed, and empty if nothing is enclosed.
    """
    if signed_volume(vertices, faces) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    spacing = 2 * _BOUND / (RESOLUTION - 1)
    blocks = np.full(3, -(-RESOLUTION // BLOCK))
    lower = np.full(3, -_BOUND)
    centres, radius = block_centres(lower, spacing, blocks)
    away = distance((vertices, faces), centres)
    winding = np.asarray(igl.fast_winding_number(vertices, faces, centres))
    # One sample represents a block that is far from the surface and clearly inside or outside.
    chosen = np.flatnonzero((away < radius + spacing + wall / 2) | (np.abs(winding - 0.5) < 0.4))

    def field(points: np.ndarray) -> np.ndarray:
        away = distance((vertices, faces), points)
        inside = np.asarray(igl.fast_winding_number(vertices, faces, points)) > 0.5
        return np.minimum(np.where(inside, -away, away), away - wall / 2 if wall else np.inf)

    return contour(field, lower, spacing, blocks, chosen, np.where(winding > 0.5, -away, away))
