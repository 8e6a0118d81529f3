"""Sharp edges, corners and thin walls that a distance grid cannot hold, stored beside it.

Near a sharp edge, the distance of a sample is that to another face than the one which a grid edge crosses:
interpolation misplaces the crossing by up to a third of a voxel. And marching cubes cuts off the edge itself.
`find_features` therefore lists crossings that interpolation misplaces, and a point in each cell that an edge
or a corner of the surface passes through; `objectfolder.mesh.sharpen` puts them into the mesh. Walls that
pass between samples are found by `objectfolder.mesh.sheets`.
"""

from dataclasses import dataclass

import igl
import numpy as np

from objectfolder.mesh.featurecodec import MARGIN, STEPS, Features
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sheets import cells_around, find_sheets

MISPLACED = 0.05  #: voxels; rounding to int8 misplaces most crossings by less
ON_FACE = 2  #: stored value, of +-127, up to which a sample may lie on a face
INSET = 0.05  #: voxels by which rays start further inside than such a sample
STEEP = 0.05  #: least cosine between a grid edge and the normal of the face that it crosses
TURN = np.cos(np.deg2rad(25))  #: between the normals in a cell, from which its surface has an edge
FLAT = 0.1  #: singular values below this part of the largest are of directions along an edge
OFF = 0.08  #: voxels, distance from the surface at which a point is no edge: it rounds, or there are two


@dataclass(frozen=True)
class _Crossings:
    """Grid edges between samples of opposite sign, and where they cross the surface."""

    sample: np.ndarray  # (E,) lower
    axis: np.ndarray  # (E,)
    place: np.ndarray  # (E,) float64, 0 at the lower sample
    interpolated: np.ndarray  # (E,) float64, as the grid has it
    normal: np.ndarray  # (E, 3) of the surface there


def find_features(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Features:
    """Find the misplaced crossings of a grid's edges, points of sharp edges in its cells, and thin walls.

    The grid (R, R, R) int8 is that of the surface, unit frame, closed and oriented outward; see
    `objectfolder.mesh.grid.DistanceGrid`.
    """
    count, spacing = len(values), 2 * BOUND / (len(values) - 1)
    scaled = (np.asarray(vertices, np.float64) + BOUND) / spacing
    sheets, moved, offsets = find_sheets(values, scaled, faces)
    crossings = _crossings(values, scaled, faces)
    wrong = np.abs(crossings.place - crossings.interpolated) > MISPLACED
    edges = 3 * crossings.sample[wrong] + crossings.axis[wrong]
    order = np.argsort(edges)
    places = np.rint(STEPS * crossings.place[wrong][order]).astype(np.uint8)
    cells, points = _corners(crossings, count, scaled, faces)
    free = ~np.isin(cells, cells_around(sheets, count))
    return Features(edges[order], places, cells[free], points[free], sheets, moved, offsets)


def _crossings(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> _Crossings:
    """Cast rays along grid edges, from the inner samples; in voxels. Those that miss are left out."""
    count = len(values)
    inside = values <= 0
    found = []
    for axis in range(3):
        apart = np.diff(inside, axis=axis)
        low = np.argwhere(apart)
        sample = low @ [count**2, count, 1]
        up = inside.ravel()[sample]
        upper = sample + count ** (2 - axis)
        first, last = (np.abs(values.ravel()[k].astype(np.float64)) for k in (sample, upper))
        found.append((sample, np.full(len(sample), axis), up, low, first / (first + last)))
    sample, axes, up, low, interpolated = (np.concatenate(parts) for parts in zip(*found))
    sense = np.where(up, 1.0, -1.0)
    along = np.zeros((len(sample), 3))
    along[np.arange(len(sample)), axes] = sense
    start = low.astype(np.float64)
    start[np.arange(len(sample)), axes] += ~up
    normals = unit_vectors(area_vectors(vertices, faces))
    # Samples may lie on a face: rays along it would miss those that it meets.
    inner = np.abs(values.ravel()[np.where(up, sample, sample + count ** (2 - axes))])
    on = np.flatnonzero(inner <= ON_FACE)
    shift = -INSET * along
    if len(on):
        nearest = igl.point_mesh_squared_distance(start[on], vertices, np.asarray(faces, np.int64))[1]
        shift[on] -= INSET * normals[np.asarray(nearest).ravel()]
    caster = RayCaster(vertices, faces)
    reached, face = caster.first_hit(start + shift, along, np.full(len(sample), 1 + 3 * INSET))
    hit = face >= 0
    # Where the line through the sample itself meets the plane of the face.
    normals, shift, along = normals[face[hit]], shift[hit], along[hit]
    steep = np.maximum(np.einsum("ij,ij->i", normals, along), STEEP)
    way = (reached[hit] + np.einsum("ij,ij->i", normals, shift) / steep).clip(0, 1)
    place = np.where(up[hit], way, 1 - way)
    return _Crossings(sample[hit], axes[hit], place, interpolated[hit], normals)


def _corners(
    crossings: _Crossings, count: int, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the cells that sharp edges pass through, and the point of each edge; (C,) int64, (C, 3) uint8.

    The point is the one nearest to the planes through the cell's crossings (Kobbelt et al. 2001), and kept if
    it lies on the surface.
    """
    position = np.stack(np.unravel_index(crossings.sample, (count,) * 3), 1).astype(np.float64)
    position[np.arange(len(position)), crossings.axis] += crossings.place
    # Each edge is one of four cells': those at its lower sample, and one step back along the other axes.
    strides = np.array([count**2, count, 1])
    owner = []
    for back in ((0, 0), (1, 0), (0, 1), (1, 1)):
        others = strides[(crossings.axis[:, None] + [1, 2]) % 3]
        owner.append(crossings.sample - others @ np.array(back))
    cell, edge = np.concatenate(owner), np.tile(np.arange(len(position)), 4)
    order = np.argsort(cell, kind="stable")
    cell, edge = cell[order], edge[order]
    cells, first, size = np.unique(cell, return_index=True, return_counts=True)
    group = np.repeat(np.arange(len(cells)), size)
    normal, point = crossings.normal[edge], position[edge]

    def total(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, first, axis=0)

    # A cell turns if some normal is far from the first one of its cell, or from their mean.
    mean = unit_vectors(total(normal))
    least = np.minimum.reduceat(np.einsum("ij,ij->i", normal, normal[first][group]), first)
    least = np.minimum(least, np.minimum.reduceat(np.einsum("ij,ij->i", normal, mean[group]), first))
    turns = least < TURN
    middle = total(point) / size[:, None]
    offset = point - middle[group]
    quadric = total(normal[:, :, None] * normal[:, None])[turns]
    pull = total(normal * np.einsum("ij,ij->i", normal, offset)[:, None])[turns]
    value, vector = np.linalg.eigh(quadric)
    firm = value > FLAT * value[:, -1:]
    inverse = np.where(firm, 1 / np.maximum(value, 1e-9), 0)
    shift = np.einsum("nij,nj,nkj,nk->ni", vector, inverse, vector, pull)
    inner = middle[turns] + shift - np.stack(np.unravel_index(cells[turns], (count,) * 3), 1)
    edge_like = firm.sum(1) == 2
    inner[edge_like] = _midway(inner[edge_like], vector[edge_like, :, 0])
    kept = (np.abs(inner - 0.5) <= 0.5 + MARGIN).all(1)
    distance = np.full(len(kept), np.inf)
    if kept.any():
        corner = inner[kept] + np.stack(np.unravel_index(cells[turns][kept], (count,) * 3), 1)
        squared = igl.point_mesh_squared_distance(corner, vertices, np.asarray(faces, np.int64))[0]
        distance[kept] = np.sqrt(squared)
    kept &= distance < OFF
    return cells[turns][kept], np.rint((inner[kept] + MARGIN) / (1 + 2 * MARGIN) * STEPS).astype(np.uint8)


def _midway(points: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Move points (N, 3) along lines to the middle of what lies in the cell [0, 1]^3, or nearest to it."""
    slope = np.where(np.abs(along) < 1e-9, 1e-9, along)
    ends = np.sort([-points / slope, (1 - points) / slope], axis=0)
    return points + (ends[0].max(1) + ends[1].min(1))[:, None] / 2 * along
