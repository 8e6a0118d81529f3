"""Sharp edges and thin walls in the mesh of marching cubes.

Sharp edges are those of extended marching cubes (Kobbelt et al. 2001).
"""

from dataclasses import dataclass

import numpy as np

from objectfolder.mesh.featurecodec import MARGIN, ORIGIN, REACH, STEPS, Features
from objectfolder.mesh.levelset import zero_level
from objectfolder.mesh.normals import area_vectors, crease_normals, split_vertices, unit_vectors

BESIDE = -0.05  # stored distance instead of 0, so that each vertex lies on one edge of the grid only
ON_EDGE = 1e-4  # voxels off a grid edge by which a vertex is still on it; single precision has 3e-5
MIXED = np.cos(np.deg2rad(3))  # of the angle to the faces' normal from which a normal of the grid is wrong
FOLDED = 0.2  # least cosine between the normals of faces before and after an edge is flipped


def extract_triangles(
    values: np.ndarray, features: Features | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Extract the triangles that a distance grid (R, R, R) int8, negative inside, and its features hold.

    Returns vertices (V, 3) float64 in voxels; faces (F, 3) int64, counter-clockwise seen from outside; and
    which faces have a stored point or vertex, (F,) bool, or None without features.
    """
    if features is None:
        return *zero_level(values), None
    if len(features.sheets):
        values = values.copy()
        values.ravel()[features.sheets] = -127  # deep, so that they join across diagonals
    return insert_features(*zero_level(values, BESIDE), features, len(values))


def insert_features(
    vertices: np.ndarray, faces: np.ndarray, features: Features, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put stored features into a mesh of marching cubes, in voxels, of a grid of ``count`` samples a side.

    Crossings move to their stored places. In a cell with a stored point, the faces become a fan around it;
    an edge between two such fans is flipped, so that it joins their points. Vertices of thin walls move
    last.

    Returns vertices, faces, and which faces are of fans, or have vertices of thin walls, (F',) bool.
    """
    edges = _grid_edges(vertices, count)
    placed = _place_crossings(vertices, edges, features)
    vertices, thin = _move_walls(placed, edges, features, count)
    if not len(features.cells):
        return vertices, faces, thin[faces].any(1)
    cell = np.floor(placed[faces].mean(1)).astype(np.int64) @ [count**2, count, 1]
    chosen, which = _find(cell, features.cells)
    border, owner = _borders(faces[chosen], which, len(vertices))
    low = np.stack(np.unravel_index(features.cells, (count,) * 3), 1)
    points = low + features.points / STEPS * (1 + 2 * MARGIN) - MARGIN
    fans = np.column_stack([border, len(vertices) + owner])
    vertices = np.concatenate([vertices, points])
    fans = _flip_edges(vertices, fans)
    plain = np.delete(faces, chosen, 0)
    touched = np.concatenate([thin[plain].any(1), np.ones(len(fans), bool)])
    used, index = np.unique(np.concatenate([plain, fans]), return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int64), touched


def sharp_normals(
    vertices: np.ndarray, faces: np.ndarray, touched: np.ndarray, smooth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give vertices the normals of their faces where those of the grid are wrong, split at creases.

    Within a voxel of an edge, and in walls of two voxels, distances are those to several faces; their
    gradient belongs to none. ``touched`` (F,) tells the faces of fans; ``smooth`` (V, 3) are unit normals
    of the grid. Returns the vertex of each new one, (V',); faces (F, 3); and normals (V', 3).
    """
    areas = area_vectors(vertices, faces)
    mean = np.stack([np.bincount(faces.ravel(), np.repeat(a, 3), len(vertices)) for a in areas.T], 1)
    own = np.einsum("ij,ij->i", unit_vectors(mean), smooth) < MIXED
    own[faces[touched]] = True
    near = own[faces].any(1)
    index, inverse = np.unique(faces[near], return_inverse=True)
    local = inverse.reshape(-1, 3)
    flat = crease_normals(vertices[index], local)
    corners = np.where(own[faces[near]][..., None], flat, smooth[faces[near]])
    vertex, split, normals = split_vertices(local, corners, len(index))
    extra = len(vertices) + np.arange(len(vertex) - len(index))
    number = np.concatenate([index, extra])
    renumbered = faces.copy()
    renumbered[near] = number[split]
    all_normals = np.concatenate([smooth, np.empty((len(extra), 3), np.float32)])
    all_normals[number] = normals
    return np.concatenate([np.arange(len(vertices)), index[vertex[len(index) :]]]), renumbered, all_normals


@dataclass(frozen=True)
class _GridEdges:
    """Vertices that lie on one edge of the grid."""

    vertex: np.ndarray  # (N,)
    axis: np.ndarray  # (N,)
    number: np.ndarray  # (N,) of the edge; see `Features`


def _grid_edges(vertices: np.ndarray, count: int) -> _GridEdges:
    off = np.abs(vertices - np.rint(vertices)) > ON_EDGE
    single = np.flatnonzero(off.sum(1) == 1)
    axis = off[single].argmax(1)
    low = np.rint(vertices[single])
    low[np.arange(len(single)), axis] = np.floor(vertices[single, axis])
    return _GridEdges(single, axis, 3 * (low.astype(np.int64) @ [count**2, count, 1]) + axis)


def _place_crossings(vertices: np.ndarray, edges: _GridEdges, features: Features) -> np.ndarray:
    """Move the vertices on listed grid edges to their places."""
    rows, which = _find(edges.number, features.edges)
    vertex, axis = edges.vertex[rows], edges.axis[rows]
    placed = vertices.copy()
    placed[vertex, axis] = np.floor(vertices[vertex, axis]) + features.places[which] / STEPS
    return placed


def _move_walls(
    vertices: np.ndarray, edges: _GridEdges, features: Features, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Move the vertices of thin walls, off their edges; return which they are, too."""
    rows, which = _find(edges.number, features.moved)
    vertex = edges.vertex[rows]
    middles = edge_middles(features.moved[which], count)
    moved, thin = vertices.copy(), np.zeros(len(vertices), bool)
    moved[vertex] = middles + REACH * (features.offsets[which] / float(ORIGIN) - 1)
    thin[vertex] = True
    return moved, thin


def edge_middles(numbers: np.ndarray, count: int) -> np.ndarray:
    """Return the middles of grid edges, voxels; (N, 3)."""
    middles = np.stack(np.unravel_index(numbers // 3, (count,) * 3), 1).astype(np.float64)
    middles[np.arange(len(numbers)), numbers % 3] += 0.5
    return middles


def _find(numbers: np.ndarray, listed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of numbers that are in an ascending list, and their places there."""
    if not len(listed):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    place = np.minimum(np.searchsorted(listed, numbers), len(listed) - 1)
    rows = np.flatnonzero(listed[place] == numbers)
    return rows, place[rows]


def _borders(faces: np.ndarray, owner: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the directed edges around each group of faces (E, 2), and their groups (E,)."""
    directed, group = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), np.repeat(owner, 3)
    key = (group * count + directed.min(1)) * count + directed.max(1)
    _, first, uses = np.unique(key, return_index=True, return_counts=True)
    single = np.sort(first[uses == 1])
    return directed[single], group[single]


def _flip_edges(vertices: np.ndarray, fans: np.ndarray) -> np.ndarray:
    """Flip the edges that two fans share, unless the new faces would fold; fans are (edge, point)."""
    low, high = fans[:, :2].min(1), fans[:, :2].max(1)
    _, inverse, uses = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    shared = np.flatnonzero(uses[inverse] == 2)
    pairs = shared[np.argsort(inverse[shared], kind="stable")].reshape(-1, 2)
    one, other = fans[pairs].swapaxes(0, 1)
    opposed = one[:, 0] == other[:, 1]
    one, other, pairs = one[opposed], other[opposed], pairs[opposed]
    (a, b, p), q = one.T, other[:, 2]
    new = np.stack([np.stack([p, a, q], 1), np.stack([q, b, p], 1)])
    before = area_vectors(vertices, one) + area_vectors(vertices, other)
    facing = [
        np.einsum("ij,ij->i", unit_vectors(area_vectors(vertices, faces)), unit_vectors(before))
        for faces in new
    ]
    good = np.minimum(*facing) > FOLDED
    flipped = fans.copy()
    flipped[pairs[good, 0]], flipped[pairs[good, 1]] = new[0][good], new[1][good]
    return flipped
