"""Where columns of a grid cross a closed surface: exact inside tests and coverage in one sweep.

A column is a line along z through sample centres. Crossings are found with a half-open edge rule that
gives both triangles of a shared edge the same answer, so the winding number along a column always
returns to zero on a closed surface.
"""

import numpy as np

_CHUNK = 4_000_000  # candidate (triangle, column) pairs held at once


def crossings(
    vertices: np.ndarray, faces: np.ndarray, count: int, lower: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Crossings of ``count`` x ``count`` columns with a triangle surface.

    Column (i, j) passes through ``lower[:2] + (i, j) * spacing``.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
    count : int
        Samples along each axis.
    lower : (3,) array
        Position of sample (0, 0, 0).
    spacing : float
        Distance between samples.

    Returns
    -------
    column : (C,) int64, ``i * count + j``
    height : (C,) float64, z of the crossing in units of samples
    sign : (C,) int64, +1 where the column enters the solid going up, -1 where it leaves
    """
    points = (np.asarray(vertices, np.float64) - lower) / spacing
    corner = points[faces]
    x, y = corner[:, :, 0], corner[:, :, 1]
    i0 = np.maximum(np.ceil(x.min(1)), 0).astype(np.int64)
    i1 = np.minimum(np.floor(x.max(1)), count - 1).astype(np.int64)
    j0 = np.maximum(np.ceil(y.min(1)), 0).astype(np.int64)
    j1 = np.minimum(np.floor(y.max(1)), count - 1).astype(np.int64)
    height_j = np.maximum(j1 - j0 + 1, 0)
    candidates = np.maximum(i1 - i0 + 1, 0) * height_j
    order = np.flatnonzero(candidates)
    total = np.cumsum(candidates[order])
    found, start = [], 0
    while start < len(order):
        before = total[start - 1] if start else 0
        stop = max(int(np.searchsorted(total, before + _CHUNK, side="right")), start + 1)
        ids = order[start:stop]
        start = stop
        triangle = np.repeat(ids, candidates[ids])
        local = np.arange(len(triangle)) - np.repeat(
            np.cumsum(candidates[ids]) - candidates[ids], candidates[ids]
        )
        i = i0[triangle] + local // height_j[triangle]
        j = j0[triangle] + local % height_j[triangle]
        winding = _winding(points, faces, triangle, i, j)
        hit = np.flatnonzero(winding)
        height = _plane_height(corner[triangle[hit]], i[hit], j[hit])
        found.append((i[hit] * count + j[hit], height, -winding[hit]))
    if not found:
        return np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64)
    column, height, sign = (np.concatenate(part) for part in zip(*found))
    return column, height, sign


def inside(
    vertices: np.ndarray, faces: np.ndarray, count: int, lower: np.ndarray, spacing: float
) -> np.ndarray:
    """Whether each sample of a cubic grid is inside a closed surface; (count,)*3 bool."""
    column, height, sign = crossings(vertices, faces, count, lower, spacing)
    first_above = np.clip(np.ceil(height), 0, count).astype(np.int64)
    winding = np.bincount(
        column * (count + 1) + first_above, weights=sign, minlength=count * count * (count + 1)
    )
    winding = np.cumsum(winding.reshape(count * count, count + 1).astype(np.int8), axis=1, dtype=np.int8)
    return (winding[:, :count] > 0).reshape(count, count, count)


def coverage(
    vertices: np.ndarray, faces: np.ndarray, count: int, lower: np.ndarray, spacing: float
) -> np.ndarray:
    """Fraction of each voxel that is inside a closed surface.

    Exact along z; across, the mean over four shifted lattices (a rotated grid), because one lattice
    quantises the thickness of slabs that are parallel to it.

    Parameters
    ----------
    lower : (3,) array
        Lower corner of voxel (0, 0, 0), whose side is ``spacing``.

    Returns
    -------
    (count,)*3 float32 in [0, 1]
    """
    total = np.zeros((count * count, count), np.float64)
    for shift in ((0.125, 0.375), (0.375, -0.125), (-0.125, -0.375), (-0.375, 0.125)):
        origin = lower + (np.array([*shift, 0.0]) + 0.5) * spacing
        column, height, sign = crossings(vertices, faces, count, origin, spacing)
        position = np.clip(height + 0.5, 0, count - 1e-9)  # in voxels above the grid's lower side
        voxel = position.astype(np.int64)
        above = voxel + 1 - position  # the part of the voxel that lies above the crossing
        size = count * count * (count + 1)
        fill = np.bincount(column * (count + 1) + voxel, weights=sign * above, minlength=size)
        fill += np.bincount(column * (count + 1) + voxel + 1, weights=sign * (1 - above), minlength=size)
        total += np.cumsum(fill.reshape(count * count, count + 1), axis=1)[:, :count]
    total = np.clip(total / 4, 0, 1)
    total[total < 1e-5] = 0  # rounding left by the running sum
    return total.reshape(count, count, count).astype(np.float32)


def _winding(
    points: np.ndarray, faces: np.ndarray, triangle: np.ndarray, i: np.ndarray, j: np.ndarray
) -> np.ndarray:
    """+-1 where column (i, j) passes through the triangle's projection, by its orientation; else 0."""
    winding = np.zeros(len(triangle), np.int64)
    for a in range(3):
        start, stop = faces[triangle, a], faces[triangle, (a + 1) % 3]
        # Always walk an edge from its lower vertex index, so that both its triangles agree exactly.
        swap = start > stop
        p, q = points[np.where(swap, stop, start)], points[np.where(swap, start, stop)]
        p_above, q_above = p[:, 1] > j, q[:, 1] > j
        crosses = np.flatnonzero(p_above != q_above)
        p, q, jj = p[crosses], q[crosses], j[crosses]
        right = p[:, 0] + (jj - p[:, 1]) * (q[:, 0] - p[:, 0]) / (q[:, 1] - p[:, 1]) > i[crosses]
        upward = np.where(swap[crosses], -1, 1) * np.where(q_above[crosses], 1, -1)
        winding[crosses] += np.where(right, upward, 0)
    return winding


def _plane_height(corner: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """z of the triangles' planes at (i, j), clipped to the triangles (steep ones are ill-conditioned)."""
    origin = corner[:, 0]
    normal = np.cross(corner[:, 1] - origin, corner[:, 2] - origin)
    nz = np.where(normal[:, 2] == 0, 1e-300, normal[:, 2])
    with np.errstate(over="ignore", invalid="ignore"):
        z = origin[:, 2] - ((i - origin[:, 0]) * normal[:, 0] + (j - origin[:, 1]) * normal[:, 1]) / nz
    lowest, highest = corner[:, :, 2].min(1), corner[:, :, 2].max(1)
    return np.clip(np.where(np.isfinite(z), z, lowest), lowest, highest)
