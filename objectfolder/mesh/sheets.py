"""Walls that pass between the samples of a distance grid: wings, blades, sheet metal under a voxel.

No sample lies inside of such a wall, and marching cubes loses it. The sample nearest to it along each grid
edge that it crosses is therefore listed as inside; and the vertices that this adds are moved to the wall.
"""

import igl
import numpy as np

from objectfolder.mesh.featurecodec import ORIGIN, REACH
from objectfolder.mesh.gridcodec import BOUND, band_width
from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sharpen import edge_middles

#: Where on the way from the outer to the listed sample the nearest point of the wall is sought: before the
#: middle, up to which the wall may reach, and far enough to part the vertices around one outer sample.
SOUGHT = 0.3
OPPOSED = -0.7  #: most cosine between the normals of a wall's two faces: an edge of 45 degrees is a sharp one


def find_sheets(
    values: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find samples that should count as inside of walls under a voxel, and the vertices around them.

    The grid (R, R, R) int8 is that of the surface, in voxels, closed and oriented outward. Returns the
    lists ``sheets``, ``moved`` and ``offsets`` of `objectfolder.mesh.featurecodec.Features`.
    """
    count = len(values)
    sheets = _within_walls(values, vertices, faces)
    moved, inner, outer = _borders_of(values, sheets)
    if not len(moved):
        return sheets, moved, np.zeros((0, 3), np.uint8)
    inside, outside = (np.stack(np.unravel_index(k, (count,) * 3), 1) for k in (inner, outer))
    sought = outside + SOUGHT * (inside - outside)
    nearest = igl.point_mesh_squared_distance(sought, vertices, np.asarray(faces, np.int64))[2]
    off = (np.asarray(nearest) - edge_middles(moved, count)) / REACH
    return sheets, moved, np.rint(ORIGIN * (1 + off)).clip(0, 2 * ORIGIN).astype(np.uint8)


def cells_around(samples: np.ndarray, count: int) -> np.ndarray:
    """Return the cells that samples are corners of, with repetitions."""
    return (samples[:, None] - _block(2, count)).ravel()


def _block(side: int, count: int) -> np.ndarray:
    """Return the numbers of a cube of samples, from its lowest one's; (side^3,)."""
    return np.indices((side,) * 3).reshape(3, -1).T @ np.array([count**2, count, 1])


def _within_walls(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the samples nearest to walls that cross a grid edge between two samples outside; ascending.

    And those inside the same walls beside them: as shallow as they are, they would not join across diagonals.
    """
    count = len(values)
    caster, normals = RayCaster(vertices, faces), unit_vectors(area_vectors(vertices, faces))
    voxel = 127 * 2 * BOUND / (count - 1) / band_width(count)  # in units of the values
    found = []
    for axis, stride in enumerate((count**2, count, 1)):
        lower, upper = (np.moveaxis(values, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        nearer, farther = np.minimum(lower, upper), np.maximum(lower, upper)
        # The middle of the wall is within half a voxel of the nearer sample, and within one of the other.
        near = (nearer > 0) & (nearer < voxel / 2) & (farther < voxel)
        low = np.argwhere(np.moveaxis(near, 0, axis))
        low = low[((low > 0) & (low < count - 2)).all(1)]
        along = np.eye(3)[axis]
        entered, front = _entries(caster, normals, low, along)
        left, back = _entries(caster, normals, low + along, -along)
        left = 1 - left
        opposed = np.einsum("ij,ij->i", front, back) < OPPOSED  # false for rays that miss, as is the next
        thin = opposed & (entered < left)
        further = entered[thin] + left[thin] > 1
        found.append(low[thin] @ [count**2, count, 1] + further * stride)
    outside = np.unique(np.concatenate(found))
    around = np.unique(outside[:, None] + _block(3, count) - _block(3, count).max() // 2)
    shallow = values.ravel()[around]
    return np.union1d(outside, around[(shallow <= 0) & (shallow > -voxel)])


def _entries(
    caster: RayCaster, normals: np.ndarray, start: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where rays of a voxel enter the solid, (N,), and the normals there, (N, 3); else NaN."""
    directions = np.broadcast_to(along, start.shape)
    distance, face = caster.first_hit(start.astype(np.float64), directions, np.ones(len(start)))
    normal = normals[face]
    enters = (face >= 0) & (normal @ along < 0)
    return np.where(enters, distance, np.nan), np.where(enters[:, None], normal, np.nan)


def _borders_of(values: np.ndarray, sheets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the grid edges from listed samples to those outside, ascending, and both samples of each."""
    inside = (values <= 0).ravel()
    inside[sheets] = True
    count = len(values)
    edges = []
    for axis, stride in enumerate((count**2, count, 1)):
        for way in (-stride, stride):
            inner = sheets[~inside[sheets + way]]
            edges.append(np.stack([3 * np.minimum(inner, inner + way) + axis, inner, inner + way]))
    numbers, inner, outer = np.concatenate(edges, 1)
    order = np.argsort(numbers)
    return numbers[order], inner[order], outer[order]
