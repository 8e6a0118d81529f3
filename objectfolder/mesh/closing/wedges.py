"""Separation of solid wedges that merely touch at edges or vertices (bow-ties)."""

import numpy as np

from objectfolder.mesh.topology import Mesh, components, half_edges

_SAME_ANGLE = 1e-6  # of faces about an edge, radians
_CUT = 1.0  # where angles about an edge begin: not where faces of aligned meshes lie


def separate_wedges(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Split edges and vertices at which solid wedges merely touch (bow-ties).

    Around an edge with more than two faces, the faces that bound the same solid wedge are paired. Where
    that leaves the edge shared, because the wedges meet again around its ends, the faces that bound the
    same hollow are paired instead. Corners that no chain of paired faces connects get separate vertices.
    The faces themselves are kept; an edge whose faces cannot be paired becomes a boundary.
    """
    directed = half_edges(faces)
    low, high = directed.min(1), directed.max(1)
    _, edge, uses = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    forward = directed[:, 0] == low
    # Angle of each half edge's face about the edge; only needed for more than two faces.
    angle = np.zeros(len(edge))
    crowded = np.flatnonzero(uses[edge] > 2)
    axis = vertices[high[crowded]] - vertices[low[crowded]]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])[crowded]
    arm = vertices[opposite] - vertices[low[crowded]]
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin(1)])
    turn = np.arctan2(np.einsum("ij,ij->i", arm, np.cross(axis, across)), np.einsum("ij,ij->i", arm, across))
    angle[crowded] = (turn + _CUT) % (2 * np.pi)
    order = _around_edges(edge, angle, forward)
    start = np.concatenate([[0], np.cumsum(uses)])[:-1]
    position = np.arange(len(order)) - start[edge[order]]
    following = order[start[edge[order]] + (position + 1) % uses[edge[order]]]
    hollow = np.zeros(len(uses), bool)
    while True:
        # About an edge, material lies between a backward face and the following forward one.
        paired = (forward[order] == hollow[edge[order]]) & (forward[following] != hollow[edge[order]])
        new_vertices, new_faces = _split_corners(vertices, faces, order[paired], following[paired])
        if len(crowded) == 0:
            return new_vertices, new_faces
        _, inverse, shared = np.unique(
            np.sort(half_edges(new_faces), 1), axis=0, return_inverse=True, return_counts=True
        )
        still = np.unique(edge[shared[inverse.ravel()] > 2])
        if hollow[still].all():
            return new_vertices, new_faces
        hollow[still] = True


def _around_edges(edge: np.ndarray, angle: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Sort half edges by edge and angle; (N,) int.

    Among coincident faces, open wedges are closed before others are opened.
    """
    order = np.lexsort((angle, edge))
    new = np.diff(edge[order], prepend=-1) != 0
    group = np.cumsum(new | (np.diff(angle[order], prepend=0) > _SAME_ANGLE)) - 1
    first = np.flatnonzero(np.diff(group, prepend=-1))
    sign = np.where(forward[order], -1, 1)  # a backward face opens a wedge
    before = np.add.accumulate(np.add.reduceat(sign, first)) - np.add.reduceat(sign, first)
    # No wedge is open where the count about an edge is lowest.
    owner = edge[order][first]
    lowest = np.minimum.reduceat(before, np.flatnonzero(np.diff(owner, prepend=-1)))
    is_open = before > lowest[owner]
    return order[np.lexsort((np.where(is_open[group], sign, -sign), group))]


def _split_corners(vertices: np.ndarray, faces: np.ndarray, one: np.ndarray, other: np.ndarray) -> Mesh:
    """Give separate vertices to corners not connected by a chain of paired half edges ``one``, ``other``."""
    size = 3 * len(faces)
    # Half edge k * F + i starts at corner k of face i; corners have the same numbers.
    end = (np.arange(size) + len(faces)) % max(size, 1)
    corner = components(np.concatenate([one, end[one]]), np.concatenate([end[other], other]), size)[1]
    source = np.empty(corner.max() + 1, np.int64)
    source[corner] = faces.T.ravel()
    # Sorted by original vertex, so that an intact mesh keeps its numbering.
    rank = np.argsort(source, kind="stable")
    renumber = np.empty_like(rank)
    renumber[rank] = np.arange(len(rank))
    return vertices[source[rank]], renumber[corner].reshape(3, -1).T.copy()
