"""Closed triangle meshes with known volume and distance."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from objectfolder.base.materials import Material
from objectfolder.mesh.features import find_features
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND, quantise
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sdf import distance_grid
from objectfolder.mesh.topology import signed_volume
from objectfolder.sound.fem.cutcell import CutCells
from objectfolder.sound.fem.hex20 import NODES
from objectfolder.sound.fem.tetrahedra import quadratic
from objectfolder.sound.fem.voxel import lattice_connectivity

STUFF = Material("stuff", 1000.0, 1e9, 0.3, 0.0, 0.0)
TURN = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()


def box(sides, centre=(0, 0, 0), turn=None):
    """Vertices and outward faces of a box."""
    mesh = trimesh.creation.box(sides)
    vertices = np.array(mesh.vertices) @ (np.eye(3) if turn is None else turn).T + np.asarray(centre)
    return vertices, np.array(mesh.faces, np.int64)


def sphere(radius, level=4, centre=(0, 0, 0)):
    mesh = trimesh.creation.icosphere(level, radius=radius)
    return np.array(mesh.vertices) + np.asarray(centre), np.array(mesh.faces, np.int64)


def pretzel():
    """A closed tube along a figure of eight: one piece that overlaps itself in the middle."""
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    path = np.stack([0.3 * np.sin(2 * turn), 0.35 * np.sin(turn), 0 * turn], 1)
    ahead = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    side = np.cross(ahead / np.linalg.norm(ahead, axis=1, keepdims=True), [0, 0, 1.0])
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.cos(angle)[:, None] * np.array([0, 0, 1.0]) + np.sin(angle)[:, None] * side[:, None]
    i, j = (k.ravel() for k in np.indices((200, 24)))
    a, b, c, d = ((i + di) % 200 * 24 + (j + dj) % 24 for di, dj in ((0, 0), (0, 1), (1, 1), (1, 0)))
    vertices = (path[:, None] + 0.06 * ring).reshape(-1, 3)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return vertices, faces if signed_volume(vertices, faces) > 0 else faces[:, ::-1]


def join(*solids):
    """Concatenate meshes."""
    offsets = np.cumsum([0, *(len(v) for v, _ in solids)])
    faces = np.concatenate([f + start for (_, f), start in zip(solids, offsets)])
    return np.concatenate([v for v, _ in solids]), faces


def united(*solids):
    """Unite solids that overlap, so that no material counts twice."""
    mesh = trimesh.boolean.union([trimesh.Trimesh(*solid) for solid in solids])
    return np.array(mesh.vertices), np.array(mesh.faces, np.int64)


def flipped(solid):
    return solid[0], np.ascontiguousarray(solid[1][:, ::-1])


def isosurface(solid, resolution=64):
    return Isosurface(DistanceGrid(*distance_grid(*solid, resolution)))


def stored(distance, resolution=64):
    """The stored surface of a signed distance, a function of x, y and z."""
    axis = np.linspace(-BOUND, BOUND, resolution)
    band = 2.5 * (axis[1] - axis[0])
    values = distance(*np.meshgrid(axis, axis, axis, indexing="ij"))
    return Isosurface(DistanceGrid(quantise(values, band), band))


def sharp_isosurface(solid, resolution=64):
    """The stored surface with its features."""
    values, band = distance_grid(*solid, resolution)
    return Isosurface(DistanceGrid(values, band, find_features(values, *solid)))


def full_cells(index, resolution):
    """Full cells of a grid, connected wherever they touch."""
    occupancy = np.zeros((len(index), 5, 5, 5), np.float32)
    occupancy[:, 0, 0, 0] = 8  # the volume of [-1, 1]^3
    return CutCells(index, occupancy, lattice_connectivity(index, NODES), resolution)


def tetrahedral_box(sides, counts):
    """Each brick of a grid in six tetrahedra around its diagonal."""
    shape = np.array(counts) + 1
    points = (np.indices(shape).reshape(3, -1).T / counts - 0.5) * sides
    corner = np.indices(counts).reshape(3, -1).T
    paths = [[0, a, a + b, 7] for a in (1, 2, 4) for b in (1, 2, 4) if a != b]
    offset = np.array([[(code >> 2) & 1, (code >> 1) & 1, code & 1] for code in range(8)])
    cells = (corner[:, None, None] + offset[np.array(paths)]).reshape(-1, 4, 3)
    return quadratic(points, np.ravel_multi_index(cells.transpose(2, 0, 1), shape), max(counts))
