"""Zero level sets of functions sampled in selected blocks of a grid only, and remeshing by one.

Remeshing is the last resort: thin walls and cavities may be lost.
"""

from collections.abc import Callable

import igl
import numpy as np
from skimage.measure import marching_cubes

from objectfolder.mesh.closing.wedges import separate_wedges
from objectfolder.mesh.closing.weld import weld
from objectfolder.mesh.topology import Mesh, distance, is_closed, signed_volume

BLOCK = 8  #: samples along each side of a block
RESOLUTION = 192  #: samples along each axis of a remeshed surface
_BOUND = 0.52
_APART = 1e-3  # of the spacing: distance from the samples at which vertices are kept, where needed


def grid_indices(*shape: int) -> np.ndarray:
    """Return the integer coordinates of a grid's samples, last axis fastest; (N, 3)."""
    return np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)


def block_centres(lower: np.ndarray, spacing: float, blocks: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the centres (B, 3) of a grid's blocks and the radius of a sphere around a block's samples."""
    side = BLOCK * spacing
    return lower + side * (grid_indices(*blocks) + 0.5) - spacing / 2, side * np.sqrt(3) / 2


def contour(
    function: Callable[[np.ndarray], np.ndarray],
    lower: np.ndarray,
    spacing: float,
    blocks: np.ndarray,
    chosen: np.ndarray,
    elsewhere: np.ndarray | float,
) -> Mesh:
    """Extract the closed surface, oriented outward, around the points where a function is negative.

    The function maps points (N, 3) to values (N,). It is sampled at ``lower + spacing * index`` in the
    ``chosen`` blocks, in the order of `block_centres`, of a grid of ``blocks`` (3,) along each axis; the
    samples in others have the value ``elsewhere``, of all or of each block. Outside the grid, values are
    positive. There are no faces if the function is negative nowhere.
    """
    count = int(np.prod(blocks))
    values = np.repeat(np.broadcast_to(np.asarray(elsewhere, float), count), BLOCK**3).reshape(count, -1)
    corner = BLOCK * np.stack(np.unravel_index(chosen, tuple(blocks)), -1)
    samples = (corner[:, None] + grid_indices(BLOCK, BLOCK, BLOCK)).reshape(-1, 3)
    values[chosen] = function(lower + spacing * samples).reshape(len(chosen), -1)
    grid = values.reshape(*blocks, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5)
    grid = np.pad(grid.reshape(BLOCK * np.asarray(blocks)), 1, constant_values=spacing)
    v, f = np.empty((0, 3)), np.empty((0, 3), np.int64)
    if grid.min() < 0:
        v, f, _, _ = marching_cubes(grid, 0.0, allow_degenerate=False)
    if len(f) == 0:
        return v[:0], f
    v, f = separate_wedges(*weld((v - 1) * spacing + lower, f.astype(np.int64), 1e-9))
    if not is_closed(f):
        # Vertices in one place cannot be told apart: keep them off the samples, and separate.
        apart = np.where(np.abs(grid) < _APART * spacing, np.copysign(_APART * spacing, grid), grid)
        v, f, _, _ = marching_cubes(apart, 0.0, allow_degenerate=False)
        v, f = (v - 1) * spacing + lower, f.astype(np.int64)
    return v, f if signed_volume(v, f) > 0 else np.ascontiguousarray(f[:, ::-1])


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
