"""Exact crossings of grid columns with a surface, for inside tests and certificates of closedness.

A column is a line along z through sample centres. A half-open edge rule gives both triangles of a shared
edge the same answer, so on a closed surface the winding number along a column always returns to zero. A
residual above the last crossing proves that the surface is open.
"""

from dataclasses import dataclass

import numpy as np

from objectfolder.base.errors import ObjectFolderError

CERTIFICATE_COLUMNS = 128  #: along the longest side
MAX_OUTSIDE = 1e-3  #: accepted `Certificate.outside_fraction`: scans intersect themselves slightly
_CHUNK = 1_000_000  # candidate (triangle, column) pairs processed at once


def crossings(
    vertices: np.ndarray,
    faces: np.ndarray,
    count: int,
    lower: np.ndarray,
    spacing: float,
    shift: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the crossings of ``count`` x ``count`` columns with a triangle surface.

    Column (i, j) passes through ``lower[:2] + (i + shift[0, j], j + shift[1, i]) * spacing``, with shifts
    of the rows of columns in [-1/2, 1/2] samples; ``lower`` is the place of sample (0, 0, 0).

    Returns the columns, (C,) int64, ``i * count + j``; heights, (C,) float64, z of the crossing in units of
    samples; and signs, (C,) int64, +1 where the column enters the solid going up, -1 where it leaves.
    """
    points = (np.asarray(vertices, np.float64) - lower) / spacing
    corner = points[faces]
    x, y = corner[:, :, 0], corner[:, :, 1]
    (dx, dy), reach = (np.zeros((2, count)), 0.0) if shift is None else (shift, 0.5)
    i0 = np.maximum(np.ceil(x.min(1) - reach), 0).astype(np.int64)
    i1 = np.minimum(np.floor(x.max(1) + reach), count - 1).astype(np.int64)
    j0 = np.maximum(np.ceil(y.min(1) - reach), 0).astype(np.int64)
    j1 = np.minimum(np.floor(y.max(1) + reach), count - 1).astype(np.int64)
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
        u, v = i + dx[j], j + dy[i]
        winding = _winding(points, faces, triangle, u, v)
        hit = np.flatnonzero(winding)
        height = _plane_height(corner[triangle[hit]], u[hit], v[hit])
        found.append((i[hit] * count + j[hit], height, -winding[hit]))
    if not found:
        return np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64)
    column, height, sign = (np.concatenate(part) for part in zip(*found))
    return column, height, sign


@dataclass(frozen=True)
class Certificate:
    """Winding statistics of a surface along columns in x, y and z."""

    columns: int  #: columns that hit the surface
    residual_columns: int  #: columns whose winding number does not return to zero: the surface is open
    outside_fraction: float  #: fraction of the length with non-zero winding number where it is not 1

    @property
    def solid(self) -> bool:
        """Whether the surface is closed, oriented outward and nearly free of self-intersection."""
        return self.columns > 0 and self.residual_columns == 0 and self.outside_fraction <= MAX_OUTSIDE


def winding_certificate(
    vertices: np.ndarray, faces: np.ndarray, count: int = CERTIFICATE_COLUMNS
) -> Certificate:
    """Measure whether a surface, in any unit, is closed with winding number 0 or 1 everywhere.

    Columns along each axis cover the bounding box, ``count`` along its longest side. All three axes are
    used, because a column misses holes parallel to it.
    """
    vertices = np.asarray(vertices, np.float64)
    lower, upper = vertices.min(0), vertices.max(0)
    spacing = float((upper - lower).max()) / count
    if spacing == 0:
        return Certificate(0, 0, 0.0)
    columns = residual_columns = 0
    wound = outside = 0.0
    for axis in range(3):
        order = np.roll(np.arange(3), -axis)  # cyclic, to keep the orientation
        # Irrational offsets, so that columns avoid vertices, edges and aligned walls.
        start = lower[order] + spacing * np.array([0.41421356, 0.73205081, 0.0])
        column, height, sign = crossings(vertices[:, order], faces, count, start, spacing)
        residual = column_residual(column, sign, count)
        columns += len(np.unique(column))
        residual_columns += int(np.count_nonzero(residual))
        by_height = np.lexsort((height, column))
        column, height, sign = column[by_height], height[by_height], sign[by_height]
        winding = np.cumsum(sign) - (np.cumsum(residual) - residual)[column]  # columns start at zero
        length = np.diff(height, append=0)
        length[np.diff(column, append=-1) != 0] = 0  # above a column's last crossing
        wound += length[winding != 0].sum()
        outside += length[(winding < 0) | (winding > 1)].sum()
    return Certificate(columns, residual_columns, float(outside / wound) if wound else 0.0)


def check_winding(vertices: np.ndarray, faces: np.ndarray, name: str) -> Certificate:
    """Certify that a surface bounds a solid.

    Raises `ObjectFolderError` if it is open, intersects itself, or is inside out.
    """
    certificate = winding_certificate(vertices, faces)
    if not certificate.columns:
        raise ObjectFolderError(
            f"{name}: no column of a {CERTIFICATE_COLUMNS}^2 grid hits the surface: it is thinner than "
            f"{1 / CERTIFICATE_COLUMNS:.1%} of its size everywhere; thicken the mesh"
        )
    if certificate.residual_columns:
        raise ObjectFolderError(
            f"{name}: the surface is open: the winding number does not return to zero on "
            f"{certificate.residual_columns} of {certificate.columns} columns along x, y and z, expected 0; "
            "rebuild it with stage normalize, or close the mesh's holes"
        )
    if not certificate.solid:
        raise ObjectFolderError(
            f"{name}: the winding number is neither 0 nor 1 in {certificate.outside_fraction:.2%} of the "
            f"space that the surface encloses, expected at most {MAX_OUTSIDE:.1%}: it overlaps itself or is "
            "inside out; rebuild it with stage normalize, or repair the mesh"
        )
    return certificate


def column_residual(column: np.ndarray, sign: np.ndarray, count: int) -> np.ndarray:
    """Compute the winding number above each column's last crossing; (count * count,) int64, 0 if closed."""
    return np.rint(np.bincount(column, weights=sign, minlength=count * count)).astype(np.int64)


def inside(
    vertices: np.ndarray, faces: np.ndarray, count: int, lower: np.ndarray, spacing: float
) -> np.ndarray:
    """Test whether each sample of a cubic grid is inside a closed surface; (count,)*3 bool."""
    column, height, sign = crossings(vertices, faces, count, lower, spacing)
    first_above = np.clip(np.ceil(height), 0, count).astype(np.int64)
    winding = np.bincount(
        column * (count + 1) + first_above, weights=sign, minlength=count * count * (count + 1)
    )
    winding = np.cumsum(winding.reshape(count * count, count + 1).astype(np.int8), axis=1, dtype=np.int8)
    return (winding[:, :count] > 0).reshape(count, count, count)


def _winding(
    points: np.ndarray, faces: np.ndarray, triangle: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return +-1, by orientation, where column (u, v) passes through the triangle, else 0."""
    winding = np.zeros(len(triangle), np.int64)
    for a in range(3):
        start, stop = faces[triangle, a], faces[triangle, (a + 1) % 3]
        # Traverse each edge from its lower vertex index, so that both its triangles agree exactly.
        swap = start > stop
        p, q = points[np.where(swap, stop, start)], points[np.where(swap, start, stop)]
        p_above, q_above = p[:, 1] > v, q[:, 1] > v
        crosses = np.flatnonzero(p_above != q_above)
        p, q, at = p[crosses], q[crosses], v[crosses]
        right = p[:, 0] + (at - p[:, 1]) * (q[:, 0] - p[:, 0]) / (q[:, 1] - p[:, 1]) > u[crosses]
        upward = np.where(swap[crosses], -1, 1) * np.where(q_above[crosses], 1, -1)
        winding[crosses] += np.where(right, upward, 0)
    return winding


def _plane_height(corner: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Compute z of triangles at (u, v), clipped to their extent because steep ones are ill-conditioned."""
    origin = corner[:, 0]
    normal = np.cross(corner[:, 1] - origin, corner[:, 2] - origin)
    nz = np.where(normal[:, 2] == 0, 1e-300, normal[:, 2])
    with np.errstate(over="ignore", invalid="ignore"):
        z = origin[:, 2] - ((u - origin[:, 0]) * normal[:, 0] + (v - origin[:, 1]) * normal[:, 1]) / nz
    lowest, highest = corner[:, :, 2].min(1), corner[:, :, 2].max(1)
    return np.clip(np.where(np.isfinite(z), z, lowest), lowest, highest)
