"""Clean a triangle soup: weld, stitch cracks, drop duplicate faces, orient, split bow-ties."""

import igl
import numpy as np
from scipy.spatial import cKDTree

from objectfolder.mesh.closing.wedges import separate_wedges
from objectfolder.mesh.topology import (
    Mesh,
    compact,
    components,
    edge_defects,
    face_areas,
    half_edges,
    orient,
)

TOLERANCES = (1e-7, 1e-6, 1e-5, 1e-4, 5e-4)  #: of the object's size
OUTSIDE = 0.25  #: winding number below which a point is outside of the other pieces
_MAX_OPEN_EDGES = 100_000  # above which a mesh is a triangle soup, without cracks to stitch
_NO_AREA = 1e-12  # of the size, squared
_FINEST_FEATURE = 0.2  # tolerance limit in median edges, to keep intended gaps


def clean(vertices: np.ndarray, faces: np.ndarray) -> tuple[Mesh, float, float]:
    """Weld with the smallest tolerance that closes the mesh, stitch cracks, orient, split bow-ties.

    Returns the mesh, in the unit frame as the given one, and perhaps empty; the welding distance; and the
    largest displacement of a vertex or split edge.
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
        if 0 < boundary <= _MAX_OPEN_EDGES:
            stitched = stitch_cracks(v, f, tolerance)
            left = edge_defects(stitched[1])[0]
            if len(stitched[1]) and left < 0.5 * boundary:
                boundary, moved, (v, f) = left, max(moved, tolerance), stitched
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
    """Merge vertices connected by steps of at most ``tolerance``, keeping the first of each group."""
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    labels = components(pairs[:, 0], pairs[:, 1], len(vertices))[1]
    _, first = np.unique(labels, return_index=True)
    return vertices[first], labels[faces]


def stitch_cracks(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Split open edges at open vertices on them (T-junctions), and cancel duplicate faces."""
    for _ in range(3):  # the first, second and third edge of every face
        open_edges = _open_edges(faces)
        rim = np.unique(open_edges[1])
        face = np.flatnonzero(open_edges[0][: len(faces)])
        at, point = _points_on_segments(vertices, faces[face, 0], faces[face, 1], rim, tolerance)
        at, point = (part[(faces[face[at]] != point[:, None]).all(1)] for part in (at, point))
        a, b, c = faces[face[at]].T
        along = np.einsum("ij,ij->i", vertices[point] - vertices[a], vertices[b] - vertices[a])
        order = np.lexsort((along, at))
        at, point = at[order], point[order]
        # A fan about the opposite corner: (a, p, c), (p, q, c), ..., (last, b, c).
        last = np.diff(at, append=-1) != 0
        a, b, c = faces[face[at]].T
        fans = np.stack([point, np.where(last, b, np.roll(point, -1)), c], 1)
        faces = faces.copy()
        first = np.diff(at, prepend=-1) != 0
        faces[face[at[first]], 1] = point[first]
        faces = np.roll(np.concatenate([faces, fans]), -1, 1)
    return cancel_copies(vertices, faces)


def _open_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the half edges (3 F,) shared by no other face, and their ends."""
    edges = half_edges(faces)
    key = edges.min(1) * (int(faces.max(initial=0)) + 1) + edges.max(1)
    _, inverse, uses = np.unique(key, return_inverse=True, return_counts=True)
    alone = uses[inverse] == 1
    return alone, edges[alone]


def _points_on_segments(
    vertices: np.ndarray, start: np.ndarray, stop: np.ndarray, points: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Find pairs (segment, vertex) of vertices within a tolerance of a segment's interior."""
    a, b = vertices[start], vertices[stop]
    length = np.linalg.norm(b - a, axis=1)
    if len(points) == 0 or len(start) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    near = cKDTree(vertices[points]).query_ball_point((a + b) / 2, length / 2, return_sorted=True)
    segment = np.repeat(np.arange(len(near)), [len(found) for found in near])
    point = points[np.concatenate([np.asarray(found, np.int64) for found in near])]
    along = (b - a)[segment] / np.maximum(length[segment, None], 1e-300)
    away = vertices[point] - a[segment]
    reach = np.einsum("ij,ij->i", away, along)
    aside = np.linalg.norm(away - reach[:, None] * along, axis=1)
    on = (aside < tolerance) & (reach > tolerance) & (reach < length[segment] - tolerance)
    return segment[on], point[on]


def drop_slivers(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop degenerate faces attached to a closed surface by one edge only."""
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
    """Drop degenerate faces, duplicates, and pairs of opposite faces.

    Of a piece that is two-sided throughout, the first copy of each face is kept, unless the rest encloses it:
    such a piece is a sheet or a solid that its author wanted seen from both sides.
    """
    faces, group, even, net = _copies(faces)
    wanted = np.where(even, net[group] > 0, net[group] < 0)
    pairs = net[group] == 0
    if pairs.any():
        wanted |= _two_sided(vertices, faces, pairs, wanted)
    _, first = np.unique(np.where(wanted, group, -1), return_index=True)
    keep = np.zeros(len(faces), bool)
    keep[first] = True
    return compact(vertices, faces[keep & wanted])


def opposite_pairs(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Return the faces that cancel, after welding: those given as often one way round as the other."""
    welded, faces = weld(vertices, faces, tolerance)
    faces, group, _, net = _copies(faces)
    return welded, faces[net[group] == 0]


def _copies(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Group the faces that are not degenerate by their three vertices.

    Returns the faces, the group of each, which of the two orientations it has, and the excess of one
    orientation over the other in every group.
    """
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    rolled = np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(3)) % 3, 1)
    key = np.sort(faces, 1)
    even = (rolled == key).all(1)  # the two orientations of one triple of vertices
    _, group = np.unique(key, axis=0, return_inverse=True)
    group = group.ravel()
    return faces, group, even, np.bincount(group, weights=np.where(even, 1, -1))


def _two_sided(vertices: np.ndarray, faces: np.ndarray, pairs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Find the faces of pieces (by edges) of opposite pairs only, that reach out of the other faces; (F,)."""
    edges = half_edges(faces)
    key = edges.min(1) * (int(faces.max()) + 1) + edges.max(1)
    edge = np.unique(key, return_inverse=True)[1]
    face = np.tile(np.arange(len(faces)), 3)
    piece = components(face, len(faces) + edge, len(faces) + int(edge.max()) + 1)[1][: len(faces)]
    whole = (np.bincount(piece, ~pairs) == 0)[piece]
    if not whole.any() or not others.any():
        return whole
    chosen = np.flatnonzero(whole)
    centres = vertices[faces[chosen]].mean(1)
    # The other faces may be inside out, or open. Beside a face of theirs the winding number is 1/2.
    wound = np.abs(igl.fast_winding_number(vertices, faces[others], centres))
    outside = np.bincount(piece[chosen], np.asarray(wound) < OUTSIDE, piece.max() + 1) > 0
    return whole & outside[piece]
