"""Combinatorics of triangle meshes: which faces share which edges, and what that encloses."""

import igl
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Mesh = tuple[np.ndarray, np.ndarray]  #: vertices (V, 3) float64 and faces (F, 3) int64
_SAME_ANGLE = 1e-6  # of faces about an edge, radians
_CUT = 1.0  # where angles about an edge begin: not where faces of aligned meshes lie


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by oriented triangles (divergence theorem)."""
    return float(tetrahedra(vertices, faces).sum())


def tetrahedra(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Signed volumes of the tetrahedra between each face and the origin; (F,)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas; (F,)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def half_edges(faces: np.ndarray) -> np.ndarray:
    """Directed edges (3 F, 2); row ``k * F + i`` leads from corner k of face i to the next one."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edge_defects(faces: np.ndarray) -> tuple[int, int, int]:
    """Count boundary edges, edges with more than two faces, and inconsistently oriented edges."""
    directed = half_edges(faces)
    key = directed.min(1) * (int(faces.max(initial=0)) + 1) + directed.max(1)
    _, inverse, uses = np.unique(key, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse, weights=np.where(directed[:, 0] < directed[:, 1], 1, -1))
    return int((uses == 1).sum()), int((uses > 2).sum()), int(((uses == 2) & (balance != 0)).sum())


def is_closed(faces: np.ndarray) -> bool:
    """Whether every directed edge is matched by exactly one opposite edge."""
    return not any(edge_defects(faces))


def face_components(faces: np.ndarray, count: int) -> np.ndarray:
    """Label of each face's connected piece (pieces share vertices); (F,) int."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    return np.unique(connected(edges, count)[faces[:, 0]], return_inverse=True)[1]


def connected(pairs: np.ndarray, count: int) -> np.ndarray:
    """Label of each of ``count`` nodes' connected component, given edges (N, 2); (count,) int."""
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def compact(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop the vertices that no face uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3).astype(np.int64)


def split(vertices: np.ndarray, faces: np.ndarray) -> list[Mesh]:
    """Return the connected pieces, in the order of their first faces."""
    labels = face_components(faces, len(vertices))
    _, first, sizes = np.unique(labels, return_index=True, return_counts=True)
    groups = np.split(np.argsort(labels, kind="stable"), np.cumsum(sizes)[:-1])
    return [compact(vertices, faces[groups[label]]) for label in np.argsort(first)]


def merged(meshes: list[Mesh]) -> Mesh:
    """One mesh of several, as they are."""
    offsets = np.cumsum([0, *(len(v) for v, _ in meshes)])
    faces = [f + start for (_, f), start in zip(meshes, offsets)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def orient(faces: np.ndarray) -> np.ndarray:
    """Turn faces so that neighbours agree; each patch as a whole may still be inside out."""
    return np.asarray(igl.bfs_orient(np.ascontiguousarray(faces))[0], np.int64)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Vertices around each hole of a manifold mesh, in the direction of its boundary half edges."""
    directed = half_edges(faces)
    count = int(faces.max()) + 1
    forward, backward = directed[:, 0] * count + directed[:, 1], directed[:, 1] * count + directed[:, 0]
    border = directed[~np.isin(forward, backward)]
    follow = dict(zip(border[:, 0].tolist(), border[:, 1].tolist()))
    loops = []
    while follow:
        start, at = follow.popitem()
        loop = [start]
        while at != start:
            loop.append(at)
            at = follow.pop(at)
        # From its lowest vertex on, so that the order of faces does not matter.
        loops.append(np.roll(loop, -int(np.argmin(loop))))
    return sorted(loops, key=lambda loop: int(loop[0]))


def separate_wedges(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Split edges and vertices at which solid wedges merely touch (bow-ties).

    Around an edge with more than two faces, those that bound the same solid wedge are kept together;
    where that leaves the edge shared, because the wedges meet again around its ends, those that bound the
    same hollow. Then corners that no chain of neighbouring faces connects get vertices of their own. Faces
    stay as they are; an edge whose faces do not pair up becomes a boundary.
    """
    directed = half_edges(faces)
    low, high = directed.min(1), directed.max(1)
    _, edge, uses = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    forward = directed[:, 0] == low
    # Angle of each half edge's face about the edge; two faces need no order.
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
        # Turning about an edge, material lies between a backward face and the forward one that follows.
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
    """Order of half edges by edge and angle; (N,) int.

    Where faces coincide, wedges that touch there are closed before others open, unless none is open.
    """
    order = np.lexsort((angle, edge))
    new = np.diff(edge[order], prepend=-1) != 0
    group = np.cumsum(new | (np.diff(angle[order], prepend=0) > _SAME_ANGLE)) - 1
    first = np.flatnonzero(np.diff(group, prepend=-1))
    sign = np.where(forward[order], -1, 1)  # a backward face opens a wedge
    before = np.add.accumulate(np.add.reduceat(sign, first)) - np.add.reduceat(sign, first)
    # Nothing is open where the count is lowest about an edge.
    owner = edge[order][first]
    lowest = np.minimum.reduceat(before, np.flatnonzero(np.diff(owner, prepend=-1)))
    is_open = before > lowest[owner]
    return order[np.lexsort((np.where(is_open[group], sign, -sign), group))]


def _split_corners(vertices: np.ndarray, faces: np.ndarray, one: np.ndarray, other: np.ndarray) -> Mesh:
    """Give corners their own vertices that no chain of paired half edges ``one``, ``other`` connects."""
    size = 3 * len(faces)
    # Half edge k * F + i starts at corner k of face i; corners are numbered the same way.
    end = (np.arange(size) + len(faces)) % max(size, 1)
    corner = connected(np.concatenate([np.stack([one, end[other]], 1), np.stack([end[one], other], 1)]), size)
    source = np.empty(corner.max() + 1, np.int64)
    source[corner] = faces.T.ravel()
    # In the order of the vertices they come from, so that an intact mesh keeps its numbering.
    rank = np.argsort(source, kind="stable")
    renumber = np.empty_like(rank)
    renumber[rank] = np.arange(len(rank))
    return vertices[source[rank]], renumber[corner].reshape(3, -1).T.copy()
