"""Shading normals: which of a file's can be used, and smooth ones with creases for a mesh without."""

import math

import numpy as np

CREASE = math.radians(40)  #: between two faces, from which on their common edge is seen as one
MOSTLY = 0.5  #: of a file's normals that are of no use: then the others are not believed either
UP = (0.0, 0.0, 1.0)  # of what has no direction: a face without area


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length 1; zeros where they have no length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def area_vectors(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vectors (F, 3) along the outward normals of faces (F, 3), twice the faces' areas long."""
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def averaged(normals: np.ndarray, faces: np.ndarray, rounds: int) -> np.ndarray:
    """Unit normals (V, 3), each the mean of its own and its neighbours', so many times over."""
    import scipy.sparse as sp  # a quarter of a second

    count = len(normals)
    one, other = faces[:, [0, 1, 1, 2, 2, 0]].ravel(), faces[:, [1, 0, 2, 1, 0, 2]].ravel()
    near = sp.csr_matrix((np.ones(len(one)), (one, other)), (count, count))
    near.data[:] = 1  # an edge is an edge of two faces
    near += sp.eye(count, format="csr")
    for _ in range(rounds):
        normals = unit(near @ normals)
    return normals


def usable(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray | None, float]:
    """Normals of the corners of faces, with the face's own where the given one would spoil a picture.

    A normal is bad if it is zero, not finite, or does not point to its face's outer side: shading turns
    black there, or takes light from behind. NaN is no normal, and not counted as a bad one.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
    normals : (V, 3) array
        Of any length; NaN where there is none.

    Returns
    -------
    corners : (F, 3, 3) array, unit; None if more than `MOSTLY` of the given normals are bad
    bad : float
        Fraction of the corners with a normal whose normal is bad.
    """
    given = ~np.isnan(normals).any(1)[faces]
    finite = np.isfinite(normals).all(1)
    corners = unit(np.where(finite[:, None], normals, 0))[faces]
    flat = unit(area_vectors(vertices, faces))
    no_area = np.logical_not(flat.any(1))
    against = np.einsum("fkc,fc->fk", corners, flat) <= 0
    wrong = np.where(no_area[:, None], ~corners.any(2), against)
    bad = float((wrong & given).sum() / max(given.sum(), 1))
    if bad > MOSTLY:
        return None, bad
    own = np.where(no_area[:, None], UP, flat)
    return np.where(wrong[..., None], own[:, None], corners), bad


def creased(vertices: np.ndarray, faces: np.ndarray, angle: float = CREASE) -> np.ndarray:
    """Smooth normals, with creases at sharp edges, of the corners of faces.

    The normal of a corner is the mean, by area, of the faces around its point that are turned against its
    own by less than an angle. Vertices in one place are one point: texture seams do not show.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
    angle : float
        rad

    Returns
    -------
    (F, 3, 3) array, unit
    """
    _, point = np.unique(vertices, axis=0, return_inverse=True)
    corner = point.ravel()[faces].ravel()
    areas = area_vectors(vertices, faces)
    flat = unit(areas)
    # All pairs of corners in one point.
    count = np.bincount(corner)
    partners, first = count[corner], (np.cumsum(count) - count)[corner]
    one = np.repeat(np.arange(len(corner)), partners)
    step = np.arange(len(one)) - np.repeat(np.cumsum(partners) - partners, partners)
    other = np.argsort(corner, kind="stable")[np.repeat(first, partners) + step]
    near = np.einsum("ij,ij->i", flat[one // 3], flat[other // 3]) > math.cos(angle)
    near |= np.logical_not(flat.any(1))[one // 3]  # a face without area goes along with all
    added = np.where(near[:, None], areas[other // 3], 0)
    total = np.stack([np.bincount(one, column, len(corner)) for column in added.T], 1)
    normals = unit(total)
    return np.where(normals.any(1, keepdims=True), normals, UP).reshape(-1, 3, 3)


def split(faces: np.ndarray, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give every normal of a vertex its own copy of that vertex.

    Parameters
    ----------
    faces : (F, 3) int array
    corners : (F, 3, 3) array
        Unit normals of the corners.
    count : int
        Vertices.

    Returns
    -------
    vertex : (V',) int array
        Which vertex each is a copy of. The first `count` are the vertices themselves.
    faces : (F, 3) int array
    normals : (V', 3) array, unit
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
    again[np.unique(owner, return_index=True)[1]] = False  # the first normal stays with the vertex
    index[order[again]] = count + np.arange(again.sum())
    vertex = np.concatenate([np.arange(count), owner[again]])
    placed = np.tile(np.array(UP), (len(vertex), 1))
    placed[index] = normals[first]
    return vertex, index[pair.ravel()].reshape(-1, 3), placed
