"""Surface of the stored distance grid, which queries use in place of the mesh."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.normals import unit_vectors
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sharpen import sharp_normals, stored_triangles

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SEEN = 2.5  # voxels, length of rays that look for the nearest triangle


@dataclass(frozen=True)
class Shading:
    """Triangles with normals."""

    vertices: np.ndarray  #: (V', 3) float64, unit frame
    faces: np.ndarray  #: (F, 3) int64, in the order of the surface's
    normals: np.ndarray  #: (V', 3) float32, outward, of unit length


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
        sheets = grid.features is not None and len(grid.features.sheets) > 0
        if not (grid.values.min() < 0 or sheets) or not grid.values.max() > 0:
            raise ObjectFolderError("the distance grid holds no surface: all samples are on one side of it")

    @cached_property
    def _mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Vertices, faces, and which faces have a stored point or vertex; see `stored_triangles`."""
        index, faces, touched = stored_triangles(self.grid.values, self.grid.features)
        return index * self.grid.spacing - BOUND, faces, touched

    @property
    def vertices(self) -> np.ndarray:
        """Vertices; (V, 3) float64."""
        return self._mesh[0]

    @property
    def faces(self) -> np.ndarray:
        """Triangles, counter-clockwise seen from outside; (F, 3) int64."""
        return self._mesh[1]

    @cached_property
    def _corners(self) -> np.ndarray:
        return self.shading.faces.astype(np.int32)

    def corners(self, face: np.ndarray) -> np.ndarray:
        """Return the vertices in `shading` of triangles (S,); (S, 3) int32, which is faster than int64."""
        return self._corners.take(face, 0)

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals at the vertices, of the grid; (V, 3) float32."""
        return self.grid.normals(torch.from_numpy(self.vertices.astype(np.float32))).numpy()

    @cached_property
    def shading(self) -> Shading:
        """The triangles as they are shaded: a vertex on a sharp edge has a copy for each side of it."""
        vertices, faces, touched = self._mesh
        if touched is None or not touched.any():
            return Shading(vertices, faces, self.normals)
        own, split, normals = sharp_normals(vertices, faces, touched, self.normals)
        return Shading(vertices[own], split, normals)

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
        the nearest vertex outside. Near edges and thin walls, which the grid does not hold, rays find the
        nearest triangle.

        Parameters
        ----------
        points : (N, 3) array, unit frame

        Returns
        -------
        projected : (N, 3) float64
        distance : (N,) float64, from the given points
        """
        points = np.asarray(points, np.float64)
        position = torch.from_numpy(points)
        distance, normals = self.grid.distance_and_normals(position)
        far = distance.abs().numpy() >= 0.9 * self.grid.band
        far |= (np.abs(points) > BOUND).any(1)  # the grid is clamped beyond its border
        if far.any():
            start = points.copy()
            start[far] = self.vertices[self._tree.query(points[far])[1]]
            position = torch.from_numpy(start)
            distance, normals = self.grid.distance_and_normals(position)
        for step in range(steps):
            if step:
                distance, normals = self.grid.distance_and_normals(position)
            position = position - (distance[:, None] * normals).to(torch.float64)
        projected = position.numpy()
        if self.grid.features is not None:
            stored = np.flatnonzero(self._beside_features(points))
            if len(stored):
                projected[stored] = self._nearest_seen(points[stored], projected[stored])
        return projected, np.linalg.norm(projected - points, axis=1)

    @cached_property
    def _refined(self) -> np.ndarray:
        """Numbers, ascending, of the samples around those whose surface is stored beside the grid."""
        features, count = self.grid.features, len(self.grid.values)
        if features is None:
            return np.zeros(0, np.int64)
        around = (np.indices((3, 3, 3)).reshape(3, -1).T - 1) @ [count**2, count, 1]
        listed = np.unique(np.concatenate([features.edges // 3, features.sheets]))
        return np.unique(listed[:, None] + around)

    def _beside_features(self, points: np.ndarray) -> np.ndarray:
        """Return which points lie where the surface is stored beside the grid; (N,)."""
        count = len(self.grid.values)
        place = np.rint((points + BOUND) / self.grid.spacing).clip(0, count - 1).astype(np.int64)
        number, refined = place @ [count**2, count, 1], self._refined
        found = np.searchsorted(refined, number).clip(max=len(refined) - 1)
        return np.asarray(refined[found] == number)

    def _nearest_seen(self, points: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
        """Return the point (N, 3) of the nearest triangle that rays around each point meet, if any does."""
        ways = np.indices((3, 3, 3)).reshape(3, -1).T - 1.0
        ways = unit_vectors(np.delete(ways, len(ways) // 2, 0))
        start, along = np.repeat(points, len(ways), 0), np.tile(ways, (len(points), 1))
        length = np.full(len(start), _SEEN * self.grid.spacing)
        reached, face = (out.reshape(len(points), -1) for out in self.caster.first_hit(start, along, length))
        best = reached.argmin(1)
        each = np.arange(len(points))
        distance, corners = (
            reached[each, best].astype(np.float64),
            self.vertices[self.faces[face[each, best]]],
        )
        found = np.isfinite(distance)
        seen = np.where(
            found[:, None], points + np.where(found, distance, 0)[:, None] * ways[best], otherwise
        )
        # The foot of the perpendicular on that triangle, if it lies within.
        a, b, c = corners.swapaxes(0, 1)
        area = np.cross(b - a, c - a)
        square = np.maximum((area**2).sum(1), 1e-300)
        foot = points - (((points - a) * area).sum(1) / square)[:, None] * area
        within = found.copy()
        for one, other in ((a, b), (b, c), (c, a)):
            within &= (np.cross(other - one, foot - one) * area).sum(1) >= 0
        return np.where(within[:, None], foot, seen)
