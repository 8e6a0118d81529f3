"""Triangle meshes as vertices and faces: volumes, edges, connected pieces, boundary loops, distances."""

import igl
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from objectfolder.mesh.normals import area_vectors

Mesh = tuple[np.ndarray, np.ndarray]  #: vertices (V, 3) float64 and faces (F, 3) int64


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Compute the volume enclosed by oriented triangles (divergence theorem)."""
    return float(face_volumes(vertices, faces).sum())


def face_volumes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute the signed volumes of the tetrahedra between each face and the origin; (F,)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute face areas; (F,)."""
    return np.linalg.norm(area_vectors(vertices, faces), axis=1) / 2


def half_edges(faces: np.ndarray) -> np.ndarray:
    """Return the directed edges (3 F, 2); row ``k * F + i`` runs from corner k of face i to the next."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edge_defects(faces: np.ndarray) -> tuple[int, int, int]:
    """Count boundary edges, edges with more than two faces, and inconsistently oriented edges."""
    directed = half_edges(faces)
    key = directed.min(1) * (int(faces.max(initial=0)) + 1) + directed.max(1)
    _, inverse, uses = np.unique(key, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse, weights=np.where(directed[:, 0] < directed[:, 1], 1, -1))
    return int((uses == 1).sum()), int((uses > 2).sum()), int(((uses == 2) & (balance != 0)).sum())


def is_closed(faces: np.ndarray) -> bool:
    """Test whether every directed edge is matched by exactly one opposite edge."""
    return not any(edge_defects(faces))


def components(first: np.ndarray, second: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Count and label the components of a graph of ``count`` nodes; edges join two lists (E,)."""
    graph = coo_array((np.ones(len(first), bool), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)


def face_components(faces: np.ndarray, count: int) -> np.ndarray:
    """Label each face with its connected piece (pieces share vertices); (F,) int."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    return np.unique(components(edges[:, 0], edges[:, 1], count)[1][faces[:, 0]], return_inverse=True)[1]


def outer_shells(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Return a closed, outward-oriented surface without the shells of its cavities."""
    shell = face_components(faces, len(vertices))
    outer = np.bincount(shell, face_volumes(vertices, faces)) > 0
    return (vertices, faces) if outer.all() else compact(vertices, faces[outer[shell]])


def compact(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop unused vertices."""
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3).astype(np.int64)


def connected_pieces(vertices: np.ndarray, faces: np.ndarray) -> list[Mesh]:
    """Return the connected pieces, in the order of their first faces."""
    labels = face_components(faces, len(vertices))
    _, first, sizes = np.unique(labels, return_index=True, return_counts=True)
    groups = np.split(np.argsort(labels, kind="stable"), np.cumsum(sizes)[:-1])
    return [compact(vertices, faces[groups[label]]) for label in np.argsort(first)]


def join_meshes(meshes: list[Mesh]) -> Mesh:
    """Concatenate meshes."""
    offsets = np.cumsum([0, *(len(v) for v, _ in meshes)])
    faces = [f + start for (_, f), start in zip(meshes, offsets)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def orient(faces: np.ndarray) -> np.ndarray:
    """Orient neighbouring faces alike; each connected patch may still be inside out."""
    return np.asarray(igl.bfs_orient(np.ascontiguousarray(faces))[0], np.int64)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Return the vertices around each hole of a manifold mesh, along its boundary half edges."""
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
        # Start at the lowest vertex, independent of the order of faces.
        loops.append(np.roll(loop, -int(np.argmin(loop))))
    return sorted(loops, key=lambda loop: int(loop[0]))


def distance(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Compute exact unsigned distances of points (N, 3) to a surface; (N,)."""
    return np.sqrt(igl.point_mesh_squared_distance(np.ascontiguousarray(points), *mesh)[0])
