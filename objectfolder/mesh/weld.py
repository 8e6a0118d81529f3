"""Clean a triangle soup into oriented pieces: weld, cancel copies, orient, split bow-ties."""

import numpy as np
from scipy.spatial import cKDTree

from objectfolder.mesh.topology import (
    Mesh,
    compact,
    connected,
    edge_defects,
    face_areas,
    half_edges,
    orient,
    separate_wedges,
)

TOLERANCES = (1e-7, 1e-6, 1e-5, 1e-4, 5e-4)  #: of the object's size
_NO_AREA = 1e-12  # of the size, squared
_FINEST_FEATURE = 0.2  # of the median edge: a larger tolerance would weld what is apart on purpose


def clean(vertices: np.ndarray, faces: np.ndarray) -> tuple[Mesh, float, float]:
    """Weld as little as closes the mesh, cancel copies, orient neighbours alike, split bow-ties.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array

    Returns
    -------
    mesh : vertices and faces
        May be empty.
    tolerance : float
        Distance over which vertices were welded.
    moved : float
        The farthest that a vertex moved by it.
    """
    best = None
    edges = half_edges(faces)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    limit = max(_FINEST_FEATURE * float(np.median(lengths)), TOLERANCES[0])
    for tolerance in TOLERANCES:
        if tolerance > limit:
            break
        welded, f = weld(vertices, faces, tolerance)
        moved = float(np.linalg.norm(welded[f] - vertices[faces], axis=2).max(initial=0))
        v, f = drop_slivers(*cancel_copies(welded, f))
        boundary = edge_defects(f)[0]
        # A larger tolerance must at least halve the open edges.
        if best is None or (len(f) and boundary < 0.5 * best[0]):
            best = (boundary, tolerance, moved, v, f)
        if best[0] == 0:
            break
    assert best is not None
    _, tolerance, moved, v, f = best
    if len(f) == 0:
        return (v, f), tolerance, moved
    if edge_defects(f)[2]:
        f = orient(f)
    return separate_wedges(v, f), tolerance, moved


def weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Merge vertices that a chain of steps up to ``tolerance`` connects; keeps the first of each."""
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    labels = connected(pairs, len(vertices))
    _, first = np.unique(labels, return_index=True)
    return vertices[first], labels[faces]


def drop_slivers(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop faces without area that hang on a closed surface by one edge; those within one stay."""
    thin = face_areas(vertices, faces) < _NO_AREA
    while thin.any():
        edges = np.sort(half_edges(faces), 1)
        _, inverse, uses = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        uses = uses[inverse.ravel()].reshape(3, -1)
        hanging = thin & (uses == 1).any(0) & (uses > 2).any(0)
        if not hanging.any():
            break
        faces, thin = faces[~hanging], thin[~hanging]
    return compact(vertices, faces)


def cancel_copies(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop degenerate faces, repeated faces, and pairs of faces that cancel each other."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    rolled = np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(3)) % 3, 1)
    key = np.sort(faces, 1)
    even = (rolled == key).all(1)  # the two orientations of one triple of vertices
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.ravel()
    net = np.bincount(group, weights=np.where(even, 1, -1))
    wanted = np.where(even, net[group] > 0, net[group] < 0)
    _, first = np.unique(np.where(wanted, group, -1), return_index=True)
    keep = np.zeros(len(faces), bool)
    keep[first] = True
    return compact(vertices, faces[keep & wanted])
