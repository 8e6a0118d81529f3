"""The closed physical surface: welding, closing and joining the pieces of a mesh without remeshing it.

Remeshing (alpha wrapping, signed grids) fills cavities and doubles thin walls, so it is the last resort
and is flagged. All lengths are in the unit frame (longest side 1).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import igl
import manifold3d
import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from objectfolder.errors import ObjectFolderError

WELD_TOLERANCES = (1e-7, 1e-6, 1e-5, 1e-4, 5e-4)
GRID_RESOLUTION = 192  # of the flagged fallback


@dataclass(frozen=True)
class Surface:
    """A closed, outward-oriented triangle surface and how it was obtained."""

    vertices: np.ndarray  #: (V, 3) float64
    faces: np.ndarray  #: (F, 3) int64
    steps: list[str] = field(default_factory=list)  #: what was done, in order
    weld_tolerance: float = 0.0
    deviation_max: float = 0.0  #: largest distance of a surface vertex from the source mesh
    deviation_mean: float = 0.0

    @property
    def volume(self) -> float:
        """Enclosed volume."""
        return signed_volume(self.vertices, self.faces)

    @property
    def components(self) -> int:
        """Number of connected pieces."""
        return int(face_components(self.faces, len(self.vertices)).max() + 1)


def close_surface(vertices: np.ndarray, faces: np.ndarray, name: str = "mesh") -> Surface:
    """Turn the triangles of a mesh into a closed surface.

    Weld, cancel opposite duplicate faces, orient; keep what is closed, cap open loops, join the pieces
    with exact booleans; only if that fails, remesh on a grid and say so in ``steps``.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    name : str
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If no closed surface with positive volume results.
    """
    tolerance, v, f = _weld_until_closed(vertices, faces)
    steps = [f"weld {tolerance:g}"]
    if len(f) == 0:
        raise ObjectFolderError(
            f"{name}: no surface is left after welding: every face is degenerate or cancelled by its copy; "
            "expected a mesh with a volume"
        )
    if _edge_defects(f)[2]:
        f = np.asarray(igl.bfs_orient(np.ascontiguousarray(f))[0], np.int64)
        steps.append("orient")
    pieces, capped = [], 0
    labels = face_components(f, len(v))
    for label in range(labels.max() + 1):
        piece_v, piece_f = _compact(v, f[labels == label])
        boundary, non_manifold, _ = _edge_defects(piece_f)
        if boundary and not non_manifold:
            piece_v, piece_f = _cap(piece_v, piece_f)
            capped += 1
        pieces.append((piece_v, piece_f))
    if capped:
        steps.append(f"cap {capped} of {len(pieces)} pieces")
    out_v, out_f = _join(pieces, steps)
    if not is_closed(out_f) or signed_volume(out_v, out_f) <= 0:
        out_v, out_f = _remesh_on_grid(v, f)
        steps.append(f"grid {GRID_RESOLUTION} (remeshed: thin walls and cavities may be lost)")
    if len(out_f) == 0 or not is_closed(out_f) or signed_volume(out_v, out_f) <= 1e-9:
        raise ObjectFolderError(
            f"{name}: could not be closed into a solid ({', '.join(steps)}); "
            "expected a mesh that encloses a volume: close its holes or give it thickness"
        )
    distance = np.sqrt(igl.point_mesh_squared_distance(out_v, v, f)[0])
    return Surface(out_v, out_f, steps, tolerance, float(distance.max()), float(distance.mean()))


def write_surface(path: str | Path, surface: Surface) -> None:
    """Write a surface as binary PLY."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    data: Any = mesh.export(file_type="ply", vertex_normal=False)
    Path(path).write_bytes(data)


def read_surface(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) of a surface, unit frame.

    Raises
    ------
    ObjectFolderError
        If the file is missing or not a mesh.
    """
    if not Path(path).is_file():
        raise ObjectFolderError(f"{path} does not exist; build it with `objectfolder build`")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the reader raises whatever its parser raises
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by oriented triangles (divergence theorem)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def is_closed(faces: np.ndarray) -> bool:
    """Whether every directed edge is matched by exactly one opposite edge."""
    return not any(_edge_defects(faces))


def face_components(faces: np.ndarray, count: int) -> np.ndarray:
    """Label of each face's connected piece (pieces share vertices); (F,) int."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.unique(labels, return_inverse=True)[1]


def _edge_defects(faces: np.ndarray) -> tuple[int, int, int]:
    """Count boundary edges, edges with more than two faces, and inconsistently oriented edges."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, inverse, uses = np.unique(np.sort(directed, 1), axis=0, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse.ravel(), weights=np.where(directed[:, 0] < directed[:, 1], 1, -1))
    return int((uses == 1).sum()), int((uses > 2).sum()), int(((uses == 2) & (balance != 0)).sum())


def _weld_until_closed(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Weld as little as closes the mesh; a larger tolerance must at least halve the open edges."""
    best = None
    for tolerance in WELD_TOLERANCES:
        v, f = _clean(*_weld(vertices, faces, tolerance))
        boundary = _edge_defects(f)[0] if len(f) else 0
        if best is None or (len(f) and boundary < 0.5 * best[0]):
            best = (boundary, tolerance, v, f)
        if best[0] == 0:
            break
    assert best is not None
    return best[1:]


def _weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
    labels = connected_components(graph, directed=False)[1]
    _, first = np.unique(labels, return_index=True)
    return vertices[first], labels[faces]


def _clean(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    return _compact(vertices, faces[keep & wanted])


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3).astype(np.int64)


def _cap(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Close every boundary loop with a fan around its centroid."""
    new_vertices, new_faces = [vertices], [faces]
    count = len(vertices)
    for loop in igl.boundary_loop_all(np.ascontiguousarray(faces)):
        loop = np.asarray(loop, np.int64)
        following = np.roll(loop, -1)
        new_vertices.append(vertices[loop].mean(0, keepdims=True))
        fan = np.stack([following, loop, np.full(len(loop), count)], 1)
        directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        if (directed == fan[0, :2]).all(1).any():  # a closed edge is walked once in each direction
            fan = fan[:, [1, 0, 2]]
        new_faces.append(fan)
        count += 1
    return np.concatenate(new_vertices), np.concatenate(new_faces)


def _join(pieces: list[tuple[np.ndarray, np.ndarray]], steps: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Union of the pieces; one that lies inside another, and is oriented the other way, is its cavity."""
    if len(pieces) == 1:
        v, f = pieces[0]
        if is_closed(f) and signed_volume(v, f) < 0:
            steps.append("flip")
            f = f[:, ::-1]
        return v, np.ascontiguousarray(f)
    closed = []
    for i, (v, f) in enumerate(pieces):
        if is_closed(f):
            closed.append((v, f, signed_volume(v, f)))
        else:
            steps.append(f"drop open piece {i} ({len(f)} faces)")
    solids: list[tuple[np.ndarray, np.ndarray]] = []
    cavities: list[tuple[np.ndarray, np.ndarray]] = []
    for v, f, volume in closed:
        # Not by the sign alone: many meshes are inside out as a whole.
        hollow = any(_contains((w, g), v) for w, g, other in closed if volume * other < 0)
        (cavities if hollow else solids).append((v, f if volume > 0 else f[:, ::-1]))
    if not solids:
        return pieces[0][0], np.empty((0, 3), np.int64)
    union = manifold3d.Manifold.batch_boolean([_manifold(*s) for s in solids], manifold3d.OpType.Add)
    for cavity in cavities:
        union = union - _manifold(*cavity)
    if union.is_empty():
        return pieces[0][0], np.empty((0, 3), np.int64)
    mesh = union.to_mesh64()
    v, f = np.asarray(mesh.vert_properties)[:, :3].copy(), np.asarray(mesh.tri_verts, np.int64)
    # Specks (thin rims that the scan broke off) are below any modality's resolution. A cavity is a part of
    # its own, of negative volume; manifold's own decompose and compose would fill it.
    part = face_components(f, len(v))
    a, b, c = (v[f[:, i]] for i in range(3))
    volumes = np.abs(np.bincount(part, weights=np.einsum("ij,ij->i", a, np.cross(b, c))))
    large = volumes > 1e-3 * volumes.max()
    steps.append(f"union {len(solids)} pieces, {len(cavities)} cavities -> {large.sum()}")
    return _compact(v, f[large[part]])


def _manifold(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces).astype(np.uint64))
    )


def _contains(piece: tuple[np.ndarray, np.ndarray], points: np.ndarray) -> bool:
    """Whether a closed piece encloses all of the points."""
    v, f = piece
    if (points.min(0) < v.min(0)).any() or (points.max(0) > v.max(0)).any():
        return False
    return bool((np.abs(igl.fast_winding_number(v, f, np.ascontiguousarray(points))) > 0.5).all())


def _remesh_on_grid(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    axis = np.linspace(-0.52, 0.52, GRID_RESOLUTION)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    winding = np.asarray(igl.fast_winding_number(vertices, faces, points))
    field_ = winding.reshape((GRID_RESOLUTION,) * 3)
    if field_.max() <= 0.5:
        return vertices, np.empty((0, 3), np.int64)
    v, f, _, _ = marching_cubes(field_, 0.5, allow_degenerate=False)
    v, f = _weld(v * (axis[1] - axis[0]) + axis[0], f.astype(np.int64), 1e-9)
    return v, f[:, ::-1] if signed_volume(v, f) < 0 else f
