"""Shading normals: validation of given ones, and smooth normals with creases."""

import math

import numpy as np

CREASE = math.radians(40)  #: angle between two faces from which their common edge is a crease
MAX_BAD = 0.5  #: fraction of bad normals above which all given normals are rejected
UP = (0.0, 0.0, 1.0)  # normal of degenerate faces


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Normalise vectors (..., 3); zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def area_vectors(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute face normals (F, 3) whose lengths are twice the faces' areas."""
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def average_normals(normals: np.ndarray, faces: np.ndarray, rounds: int) -> np.ndarray:
    """Average unit normals (V, 3) with those of neighbouring vertices, ``rounds`` times."""
    import scipy.sparse as sp  # takes a quarter of a second

    count = len(normals)
    one, other = faces[:, [0, 1, 1, 2, 2, 0]].ravel(), faces[:, [1, 0, 2, 1, 0, 2]].ravel()
    near = sp.csr_matrix((np.ones(len(one)), (one, other)), (count, count))
    near.data[:] = 1  # an edge occurs in two faces
    near += sp.eye(count, format="csr")
    for _ in range(rounds):
        normals = unit_vectors(near @ normals)
    return normals


def replace_bad_normals(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray | None, float]:
    """Return the normals of the faces' corners, with bad ones replaced by face normals.

    A normal is bad if it is zero, infinite, or does not point to the outer side of its face: shading would
    turn black or use light from behind. The given ones (V, 3) have any length; NaN marks a missing normal,
    which does not count as bad.

    Returns unit normals (F, 3, 3), or None if more than `MAX_BAD` of the given ones are bad; and the
    fraction of bad ones among the corners that have one.
    """
    given = ~np.isnan(normals).any(1)[faces]
    finite = np.isfinite(normals).all(1)
    corners = unit_vectors(np.where(finite[:, None], normals, 0))[faces]
    flat = unit_vectors(area_vectors(vertices, faces))
    no_area = np.logical_not(flat.any(1))
    against = np.einsum("fkc,fc->fk", corners, flat) <= 0
    wrong = np.where(no_area[:, None], ~corners.any(2), against)
    bad = float((wrong & given).sum() / max(given.sum(), 1))
    if bad > MAX_BAD:
        return None, bad
    own = np.where(no_area[:, None], UP, flat)
    return np.where(wrong[..., None], own[:, None], corners), bad


def crease_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute smooth unit normals of the faces' corners, (F, 3, 3), with creases at sharp edges.

    The normal of a corner is the area-weighted mean over the faces around its point whose normals differ
    from its own face's by less than `CREASE`. Coincident vertices count as one point, so that texture
    seams do not show.
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.ravel()[faces].ravel()
    areas = area_vectors(vertices, faces)
    flat = unit_vectors(areas)
    # All pairs of corners at one point.
    count = np.bincount(corner)
    partners, first = count[corner], (np.cumsum(count) - count)[corner]
    one = np.repeat(np.arange(len(corner)), partners)
    step = np.arange(len(one)) - np.repeat(np.cumsum(partners) - partners, partners)
    other = np.argsort(corner, kind="stable")[np.repeat(first, partners) + step]
    near = np.einsum("ij,ij->i", flat[one // 3], flat[other // 3]) > math.cos(CREASE)
    near |= np.logical_not(flat.any(1))[one // 3]  # degenerate faces take the mean of all
    added = np.where(near[:, None], areas[other // 3], 0)
    total = np.stack([np.bincount(one, column, len(corner)) for column in added.T], 1)
    normals = unit_vectors(total)
    return np.where(normals.any(1, keepdims=True), normals, UP).reshape(-1, 3, 3)


def split_vertices(
    faces: np.ndarray, corners: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Duplicate vertices so that each has one normal, given unit normals of the faces' corners, (F, 3, 3).

    Returns the original of each new vertex, (V',), of which the first ``count`` are the originals
    themselves; the faces; and the unit normals (V', 3).
    """
    corner, normals = faces.ravel(), corners.reshape(-1, 3)
    _, group = np.unique(normals, axis=0, return_inverse=True)
    key = corner * (int(group.max()) + 1) + group.ravel()
    _, first, pair = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    owner = corner[first[order]]
    index = np.empty(len(first), np.int64)
    index[order] = owner
    again = np.ones(len(first), bool)
    again[np.unique(owner, return_index=True)[1]] = False  # the first normal stays with the original
    index[order[again]] = count + np.arange(again.sum())
    vertex = np.concatenate([np.arange(count), owner[again]])
    placed = np.tile(np.array(UP), (len(vertex), 1))
    placed[index] = normals[first]
    return vertex, index[pair.ravel()].reshape(-1, 3), placed
