"""Surface of the stored distance grid, which queries use in place of the mesh."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.raycast import RayCaster

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


class Isosurface:
    """Zero level set of a distance grid as triangles in the unit frame, ready for ray casting.

    Everything but the grid is computed on first use.

    Parameters
    ----------
    grid : DistanceGrid

    Raises
    ------
    ObjectFolderError
        If no surface passes through the grid.
    """

    def __init__(self, grid: DistanceGrid):
        self.grid = grid
        if not grid.values.min() < 0 < grid.values.max():
            raise ObjectFolderError("the distance grid holds no surface: all samples are on one side of it")

    @cached_property
    def _mesh(self) -> tuple[np.ndarray, np.ndarray]:
        from skimage.measure import marching_cubes

        box = _box(self.grid.values <= 0)
        values = self.grid.values[tuple(box)]
        vertices, faces, _, _ = marching_cubes(
            values.astype(np.float32), 0.0, allow_degenerate=False, mask=_crossed(values)
        )
        index = vertices.astype(np.float64) + [side.start for side in box]
        return index * self.grid.spacing - BOUND, faces.astype(np.int64)

    @property
    def vertices(self) -> np.ndarray:
        """Vertices; (V, 3) float64."""
        return self._mesh[0]

    @property
    def faces(self) -> np.ndarray:
        """Triangles, counter-clockwise seen from outside; (F, 3) int64."""
        return self._mesh[1]

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals at the vertices; (V, 3) float32."""
        return self.grid.normals(torch.from_numpy(self.vertices.astype(np.float32))).numpy()

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates of the vertices; (2, 3) float64."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @cached_property
    def caster(self) -> RayCaster:
        """Ray caster of the triangles."""
        return RayCaster(self.vertices, self.faces)

    @cached_property
    def _tree(self) -> "cKDTree":
        from scipy.spatial import cKDTree

        return cKDTree(self.vertices)

    def nearest(self, points: np.ndarray, steps: int = 3) -> tuple[np.ndarray, np.ndarray]:
        """Project points to the surface.

        Takes Newton steps along the gradient of the distance, from the point itself inside the band and from
        the nearest vertex outside.

        Parameters
        ----------
        points : (N, 3) array, unit frame

        Returns
        -------
        projected : (N, 3) float64
        distance : (N,) float64, from the given points
        """
        points = np.asarray(points, np.float64)
        far = np.abs(self.grid.distance(torch.from_numpy(points)).numpy()) >= 0.9 * self.grid.band
        far |= (np.abs(points) > BOUND).any(1)  # the grid is clamped beyond its border
        start = points.copy()
        if far.any():
            start[far] = self.vertices[self._tree.query(points[far])[1]]
        position = torch.from_numpy(start)
        for _ in range(steps):
            distance, normals = self.grid.distance_and_normals(position)
            position = position - (distance[:, None] * normals).to(torch.float64)
        projected = position.numpy()
        return projected, np.linalg.norm(projected - points, axis=1)


def _box(inside: np.ndarray) -> list[slice]:
    """Return the range of samples, per axis, that contains the inside and its neighbours."""
    sides = []
    for axis, count in enumerate(inside.shape):
        found = np.flatnonzero(inside.any(tuple({0, 1, 2} - {axis})))
        sides.append(slice(max(int(found[0]) - 1, 0), min(int(found[-1]) + 2, count)))
    return sides


def _crossed(values: np.ndarray) -> np.ndarray:
    """Mark the cells that the surface may cross, at their upper corner; bool.

    Marching cubes skips the others, which are most.
    """
    cells = values.shape[2] - 1
    inside = np.packbits(values <= 0, axis=2)  # eight samples at once
    some, every = inside != 0, inside == 255
    # Cells of a byte extend into the next byte; bits beyond the last sample are 0.
    some[:, :, :-1], every[:, :, :-1] = some[:, :, :-1] | some[:, :, 1:], every[:, :, :-1] & every[:, :, 1:]
    for _ in range(2):
        some, every = (some[:-1] | some[1:]).swapaxes(0, 1), (every[:-1] & every[1:]).swapaxes(0, 1)
    crossed = np.zeros(values.shape, bool)
    crossed[1:, 1:, 1:] = np.repeat(some & ~every, 8, axis=2)[:, :, :cells]
    return crossed
