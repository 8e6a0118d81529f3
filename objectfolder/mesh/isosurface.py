"""The surface that the stored distance grid describes: what queries see and touch, without the mesh."""

import numpy as np
import torch
from skimage.measure import marching_cubes

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.grid import BOUND, DistanceGrid
from objectfolder.mesh.raycast import RayCaster


class Isosurface:
    """Triangles of a distance grid's zero level, in the unit frame, ready for ray casting.

    Parameters
    ----------
    grid : DistanceGrid

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64, counter-clockwise seen from outside
    normals : (V, 3) float32, outward, of unit length
    bounds : (2, 3) float64, lowest and highest coordinates of the vertices
    caster : RayCaster
    """

    def __init__(self, grid: DistanceGrid):
        self.grid = grid
        if not grid.values.min() < 0 < grid.values.max():
            raise ObjectFolderError("the distance grid holds no surface: every sample is on one side of it")
        v, f, _, _ = marching_cubes(grid.values.astype(np.float32), 0.0, allow_degenerate=False)
        self.vertices = v.astype(np.float64) * grid.spacing - BOUND
        self.faces = f.astype(np.int64)
        self.normals = grid.normals(torch.from_numpy(self.vertices.astype(np.float32))).numpy()
        self.bounds = np.stack([self.vertices.min(0), self.vertices.max(0)])
        self.caster = RayCaster(self.vertices, self.faces)

    def nearest(self, points: np.ndarray, steps: int = 3) -> tuple[np.ndarray, np.ndarray]:
        """Project points to the surface.

        The nearest vertex of the surface, then Newton steps along the distance's gradient.

        Parameters
        ----------
        points : (N, 3) array, unit frame

        Returns
        -------
        projected : (N, 3) float64
        distance : (N,) float64, from the given points
        """
        from scipy.spatial import cKDTree

        if not hasattr(self, "_tree"):
            self._tree = cKDTree(self.vertices)
        points = np.asarray(points, np.float64)
        near = np.abs(self.grid.distance(torch.from_numpy(points)).numpy()) < 0.9 * self.grid.band
        near &= (np.abs(points) <= BOUND).all(1)  # beyond, the grid goes on as at its border
        start = np.where(near[:, None], points, self.vertices[self._tree.query(points)[1]])
        position = torch.from_numpy(start)
        for _ in range(steps):
            step = self.grid.distance(position)[:, None] * self.grid.normals(position.to(torch.float32))
            position = position - step.to(torch.float64)
        projected = position.numpy()
        return projected, np.linalg.norm(projected - points, axis=1)
