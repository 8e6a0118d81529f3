"""Polygons in space: area, projection onto their plane, split into triangles."""

import manifold3d
import numpy as np

REVERSED = 1e-9  #: share of a polygon's area below which a reversed triangle of its fan is rounding

_SHORT_CHORDS = 1e-6  # weight of a chord's square beside the areas


def area_vector(points: np.ndarray) -> np.ndarray:
    """Compute the area vectors (..., 3) of closed loops (..., n, 3), by Newell's method."""
    around = points - points.mean(-2, keepdims=True)
    return np.cross(around, np.roll(around, -1, -2)).sum(-2) / 2


def in_plane(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Project a loop onto its plane, counter-clockwise; (n, 2)."""
    axis = np.eye(3)[np.abs(normal).argmin()]
    u = np.cross(axis, normal)
    v = np.cross(normal, u)
    return np.stack([points @ (u / np.linalg.norm(u)), points @ (v / np.linalg.norm(v))], 1)


def fan(corners: int) -> np.ndarray:
    """Return the triangles (corners - 2, 3) that share the first corner of a polygon."""
    corner = np.arange(1, corners - 1)
    return np.stack([np.zeros_like(corner), corner, corner + 1], 1)


def needs_ears(points: np.ndarray) -> np.ndarray:
    """Tell the polygons (P, n, 3) whose fan leaves them, such as a U; (P,) bool."""
    with np.errstate(all="ignore"):  # coordinates are checked later
        edges = points[:, 1:] - points[:, :1]
        areas = np.cross(edges[:, :-1], edges[:, 1:])
        whole = areas.sum(1, keepdims=True)
        along = (areas * whole).sum(-1)
        return np.asarray((along < -REVERSED * (whole**2).sum(-1)).any(1))


def split(points: np.ndarray) -> np.ndarray:
    """Split polygons (P, n, 3) that are flat or nearly so into triangles of their corners, (P, n - 2, 3) int.

    They are a fan, or where it would leave the polygon, ears cut in its plane.
    """
    count, corners = points.shape[:2]
    triangles = np.tile(fan(corners), (count, 1, 1))
    for i in np.flatnonzero(needs_ears(points)) if corners > 3 else ():
        ears = manifold3d.triangulate([in_plane(points[i], area_vector(points[i]))])
        if len(ears) == corners - 2:  # otherwise the polygon crosses itself
            triangles[i] = ears
    return triangles


def split_tightly(points: np.ndarray, forbidden: np.ndarray) -> np.ndarray | None:
    """Split a loop (n, 3) into the triangles (n - 2, 3) of least area, without ``forbidden`` chords (n, n).

    Dynamic programming after Barequet and Sharir (1995), cubic in n; among equal areas short chords win.
    None if no split avoids the chords.
    """
    count = len(points)
    chord = ((points[:, None] - points) ** 2).sum(-1) * _SHORT_CHORDS
    chord[forbidden] = np.inf
    chord[[0, -1], [-1, 0]] = 0  # the closing edge is no chord
    cost, middle = np.full((count, count), np.inf), np.zeros((count, count), np.int64)
    start = np.arange(count - 1)
    cost[start, start + 1] = 0
    for span in range(2, count):
        i = np.arange(count - span)
        j, k = i + span, i[:, None] + np.arange(1, span)
        area = np.linalg.norm(
            np.cross(points[k] - points[i, None], points[j, None] - points[i, None]), axis=2
        )
        total = cost[i[:, None], k] + cost[k, j[:, None]] + area / 2
        best = total.argmin(1)
        cost[i, j], middle[i, j] = total[i, best] + chord[i, j], k[i, best]
    if not np.isfinite(cost[0, -1]):
        return None
    triangles, pending = [], [(0, count - 1)]
    while pending:
        low, high = pending.pop()
        if high - low > 1:
            between = int(middle[low, high])
            triangles.append((low, between, high))
            pending += [(low, between), (between, high)]
    return np.array(triangles)


def split_loops(points: np.ndarray, vertex: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split polygons of different sizes (P,), whose corners (C,) are some of the points (V, 3).

    Returns triangles of corners (T, 3), and the polygon of each (T,), in order. Those of under three corners
    have none; vertices that there are not are taken for others.
    """
    first = np.cumsum(sizes) - sizes
    known = vertex.clip(0, len(points) - 1)
    triangles, face = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for size in np.unique(sizes[sizes > 2]):
        chosen = np.flatnonzero(sizes == size)
        polygons = first[chosen, None] + np.arange(size)
        local = split(points[known[polygons]])
        triangles.append(np.take_along_axis(polygons[:, None], local, 2).reshape(-1, 3))
        face.append(np.repeat(chosen, size - 2))
    owner = np.concatenate(face)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]
