"""Closed triangle meshes whose volume and distance are known."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sdf import distance_grid

TURN = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()


def box(sides, centre=(0, 0, 0), turn=None):
    """Vertices and outward faces of a box."""
    mesh = trimesh.creation.box(sides)
    vertices = np.array(mesh.vertices) @ (np.eye(3) if turn is None else turn).T + np.asarray(centre)
    return vertices, np.array(mesh.faces, np.int64)


def sphere(radius, level=4, centre=(0, 0, 0)):
    mesh = trimesh.creation.icosphere(level, radius=radius)
    return np.array(mesh.vertices) + np.asarray(centre), np.array(mesh.faces, np.int64)


def join(*solids):
    """One mesh of several, as they are."""
    offsets = np.cumsum([0, *(len(v) for v, _ in solids)])
    faces = np.concatenate([f + start for (_, f), start in zip(solids, offsets)])
    return np.concatenate([v for v, _ in solids]), faces


def flipped(solid):
    return solid[0], np.ascontiguousarray(solid[1][:, ::-1])


def isosurface(solid, resolution=64):
    return Isosurface(DistanceGrid(*distance_grid(*solid, resolution)))
