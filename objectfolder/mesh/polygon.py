"""Polygons in space: area, projection onto their plane, split into triangles."""

import manifold3d
import numpy as np

REVERSED = 1e-9  #: share of a polygon's area below which a reversed triangle of its fan is rounding


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
