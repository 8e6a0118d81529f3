"""Extrusion of planar outlines along z, with rounded edges and an even mesh.

An outline is a closed polygon (N, 2), m, with the solid to its left: counter-clockwise around the outside,
clockwise around a hole.
"""

from collections.abc import Sequence
from itertools import pairwise

import manifold3d
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, QhullError, cKDTree

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.topology import half_edges
from objectfolder.shapes.revolution import arc, polyline

ROUND_STEPS = 3  #: facets of a rounded edge between a side and a flat


def rectangle(length: float, width: float, corner: float = 0.0, steps: int = 5) -> np.ndarray:
    """Return the outline (N, 2) of a rectangle about the origin with corner radius ``corner``, m."""
    x, y = length / 2 - corner, width / 2 - corner
    middles = [(x, y), (-x, y), (-x, -y), (x, -y)]
    if corner == 0:
        return np.array(middles)
    quarters = [arc(c, corner, k * np.pi / 2, (k + 1) * np.pi / 2, steps) for k, c in enumerate(middles)]
    return polyline(*quarters, quarters[0][:1], step=length + width)[:-1]


def polygon(sides: int, radius: float, turn: float = 0.0) -> np.ndarray:
    """Return the outline (sides, 2) of a regular polygon about the origin, first corner at ``turn``, rad."""
    return arc((0.0, 0.0), radius, turn, turn + 2 * np.pi, sides)[:-1]


def round_corners(corners: ArrayLike, radius: float) -> np.ndarray:
    """Round the corners of an outline (N, 2), counter-clockwise, with arcs of ``radius``, m."""
    shape = manifold3d.CrossSection([np.asarray(corners, np.float64)])
    round_ = manifold3d.JoinType.Round
    shape = shape.offset(-radius, round_, circular_segments=32).offset(radius, round_, circular_segments=32)
    return np.asarray(shape.simplify(1e-3 * radius).to_polygons()[0])


def area(outline: np.ndarray) -> float:
    """Compute the signed area, m^2; positive counter-clockwise."""
    x, y = outline.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def deepest_inset(outline: np.ndarray) -> float:
    """Return the distance, m, at which `inset` would let the first side of an outline (N, 2) vanish."""
    side = np.roll(outline, -1, axis=0) - outline
    heading = np.arctan2(side[:, 1], side[:, 0])
    turn = np.tan((heading - np.roll(heading, 1) + np.pi) % (2 * np.pi) / 2 - np.pi / 2)
    shrinks = turn + np.roll(turn, -1)
    return float(np.min(np.linalg.norm(side, axis=1)[shrinks > 0] / shrinks[shrinks > 0]))


def inset(outline: np.ndarray, distance: float) -> np.ndarray:
    """Offset the sides of an outline (N, 2) by ``distance``, m, into the solid, with mitred corners.

    Raises `ObjectFolderError` if a side would vanish.
    """
    side = np.roll(outline, -1, axis=0) - outline
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    after = np.stack([-side[:, 1], side[:, 0]], 1)
    before = np.roll(after, 1, axis=0)
    mitre = (before + after) / (1 + np.sum(before * after, axis=1, keepdims=True))
    moved = outline + distance * mitre
    if np.sum((np.roll(moved, -1, axis=0) - moved) * side, axis=1).min() <= 0:
        raise ObjectFolderError(
            f"an edge rounded by {distance:.4g} m: expected less than the shortest side allows; "
            "round it less or make the part larger"
        )
    return moved


def prism(
    outlines: Sequence[np.ndarray], height: float, spacing: float, bevel: float = 0.0,
    steps: int = ROUND_STEPS,
) -> manifold3d.Manifold:  # fmt: skip
    """Extrude a plate from z = 0 to ``height``, m, with an even mesh on its flats.

    The first outline is the outer one, others are holes. Neighbouring vertices are at most about ``spacing``
    apart. Edges between sides and flats have the radius ``bevel`` and ``steps`` facets: 1 makes a chamfer.
    Raises `ObjectFolderError` if the radius is too large.
    """
    if 2 * bevel >= height:
        raise ObjectFolderError(
            f"edges rounded by {bevel:.4g} m: expected less than half the thickness {height:.4g}"
        )
    rings = [polyline(ring, ring[:1], step=spacing)[:-1] for ring in outlines]
    turn = np.linspace(0, np.pi / 2, steps + 1) if bevel > 0 else np.zeros(1)
    depth, rise = bevel * (1 - np.sin(turn)), bevel * (1 - np.cos(turn))
    rows = max(1, int(np.ceil((height - 2 * bevel) / spacing)))
    straight = np.linspace(bevel, height - bevel, rows + 1)
    depths = np.concatenate([depth, np.zeros(rows - 1), depth[::-1]])
    levels = np.concatenate([rise[:-1], straight, height - rise[:-1][::-1]])

    count = sum(map(len, rings))
    layers = [np.concatenate([inset(ring, d) if d > 0 else ring for ring in rings]) for d in depths]
    vertices = np.concatenate([np.column_stack([xy, np.full(count, z)]) for xy, z in zip(layers, levels)])
    starts = np.cumsum([0, *map(len, rings)])
    here = np.arange(count)
    following = np.concatenate([np.roll(np.arange(a, b), -1) for a, b in pairwise(starts)])
    step = count * np.arange(len(levels) - 1)[:, None]
    a, b = (here + step).ravel(), (following + step).ravel()
    sides = np.concatenate([np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)])

    inner, cap = triangulate(np.split(layers[0], starts[1:-1]), spacing)
    # Vertices of the cap: those of the outline, then the added inner ones.
    extra = len(vertices)
    top_layer = count * (len(levels) - 1)
    bottom = np.where(cap < count, cap, cap - count + extra)
    top = np.where(cap < count, cap + top_layer, cap - count + extra + len(inner))
    lids = [np.column_stack([inner, np.full(len(inner), z)]) for z in (0.0, height)]
    return solid(np.concatenate([vertices, *lids]), np.concatenate([sides, bottom[:, ::-1], top]))


def extrude_y(
    outlines: Sequence[np.ndarray], width: float, spacing: float, bevel: float = 0.0, steps: int = ROUND_STEPS
) -> manifold3d.Manifold:
    """Extrude outlines in x and z along y, from -width / 2 to width / 2, m; parameters of `prism`."""
    plate = prism(outlines, width, spacing, bevel, steps)
    return plate.transform(np.array([[1.0, 0, 0, 0], [0, 0, -1.0, width / 2], [0, 1.0, 0, 0]]))


def solid(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    """Convert a closed mesh to a manifold3d solid that keeps its triangles in Boolean operations."""
    mesh = manifold3d.Mesh64(
        vert_properties=np.ascontiguousarray(vertices, np.float64),
        tri_verts=np.ascontiguousarray(faces, np.uint64),
        face_id=np.arange(len(faces), dtype=np.uint64),  # distinct, so that flat regions keep their even mesh
    )
    made = manifold3d.Manifold(mesh)
    assert made.status() == manifold3d.Error.NoError, made.status()
    return made


def triangulate(rings: Sequence[np.ndarray], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Fill outlines with triangles of about ``spacing``, m, on a side.

    Returns the added inner vertices (M, 2), and triangles (T, 3), counter-clockwise, as indices into the
    outlines' vertices followed by the inner ones.
    """
    border = np.concatenate(rings)
    low, high = border.min(0), border.max(0)
    row = spacing * np.sqrt(3) / 2
    columns, rows = np.ceil((high - low) / [spacing, row]).astype(int) + 1
    j, i = (k.ravel() for k in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    # Centred, so that the mesh of a symmetric outline is nearly symmetric.
    lattice = np.stack([(i + 0.5 * (j % 2) - columns / 2 + 0.25) * spacing, (j - (rows - 1) / 2) * row], 1)
    lattice += (low + high) / 2
    clear = cKDTree(border).query(lattice)[0] > 0.72 * spacing
    inner = lattice[clear]
    inner = inner[_inside(rings, inner)]
    points = np.concatenate([border, inner])
    try:
        triangles = Delaunay(points).simplices
    except QhullError:
        triangles = np.zeros((0, 3), int)
    corners = points[triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles = np.where((twice < 0)[:, None], triangles[:, ::-1], triangles)
    keep = (np.abs(twice) > 1e-7 * spacing**2) & _inside(rings, corners.mean(1))
    triangles = triangles[keep]
    if not _has_border(triangles, rings):  # thin webs, where Delaunay cuts across the outline
        filled = manifold3d.triangulate(list(rings))
        return np.zeros((0, 2)), np.asarray(filled, np.int64)
    used = np.isin(np.arange(len(border), len(points)), triangles)
    index = np.append(np.arange(len(border)), len(border) + np.cumsum(used) - 1)
    return inner[used], index[triangles]


def _has_border(triangles: np.ndarray, rings: Sequence[np.ndarray]) -> bool:
    """Test whether the boundary edges of the triangles are exactly the outlines."""
    starts = np.cumsum([0, *map(len, rings)])
    following = np.concatenate([np.roll(np.arange(a, b), -1) for a, b in pairwise(starts)])
    n = max(starts[-1], triangles.max(initial=0) + 1)
    edges = half_edges(triangles)
    forward, backward = edges @ [n, 1], edges @ [1, n]
    if len(np.unique(forward)) < len(forward):
        return False
    single = np.sort(forward[~np.isin(forward, backward)])
    return np.array_equal(single, np.sort(np.arange(starts[-1]) * n + following))


def _inside(rings: Sequence[np.ndarray], points: np.ndarray) -> np.ndarray:
    """Test whether points (N, 2) lie inside the outlines and outside their holes; (N,) bool."""
    start = np.concatenate(rings)
    stop = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    x, y = points[:, :1], points[:, 1:]
    spans = (start[:, 1] > y) != (stop[:, 1] > y)
    rise = np.where(stop[:, 1] == start[:, 1], 1.0, stop[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) * (stop[:, 0] - start[:, 0]) / rise
    return np.sum(spans & (x < crossing), axis=1) % 2 == 1
