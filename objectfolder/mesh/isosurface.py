"""Surface of the stored distance grid, which queries use in place of the mesh."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sharpen import extract_triangles, sharp_normals

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_NEAR = 0.5  # voxels, within which the gradient of the grid points to the nearest side of a wall
_ASTRAY = 0.1  # voxels by which Newton steps may lead farther than the grid's distance
_NEWTON_STEPS = 3
_VERTICES = 8  # nearest vertices, one of which the nearest triangle has
_PART = 4096  # points that are compared with triangles at a time


@dataclass(frozen=True)
class Shading:
    """Triangles with normals; arrays are read-only."""

    vertices: np.ndarray  #: (V', 3) float64, unit frame
    faces: np.ndarray  #: (F, 3) int64, in the order of the surface's
    normals: np.ndarray  #: (V', 3) float32, outward, of unit length
    tensor: torch.Tensor  #: the normals

    def __post_init__(self) -> None:
        _freeze(self.vertices, self.faces, self.normals)


class Isosurface:
    """Zero level set of a distance grid as triangles in the unit frame, ready for ray casting.

    Everything but the grid is computed on first use. All share its arrays, which are read-only.

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
            raise ObjectFolderError(
                "the distance grid holds no surface: no sample is inside it, or none outside; build the "
                "object again"
            )

    @cached_property
    def _mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Vertices, faces, and which faces have a stored point or vertex; see `extract_triangles`."""
        index, faces, touched = extract_triangles(self.grid.values, self.grid.features)
        vertices = index * self.grid.spacing - BOUND
        _freeze(vertices, faces)
        return vertices, faces, touched

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
    def _normals(self) -> torch.Tensor:
        return self.grid.normals(torch.from_numpy(self.vertices.astype(np.float32)))

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals at the vertices, of the grid; (V, 3) float32."""
        normals = self._normals.numpy()
        _freeze(normals)
        return normals

    @cached_property
    def shading(self) -> Shading:
        """The triangles as they are shaded: a vertex on a sharp edge has a copy for each side of it."""
        vertices, faces, touched = self._mesh
        if touched is None or not touched.any():
            return Shading(vertices, faces, self.normals, self._normals)
        own, split, normals = sharp_normals(vertices, faces, touched, self.normals)
        return Shading(vertices[own], split, normals, torch.from_numpy(normals))

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates of the vertices; (2, 3) float64."""
        bounds = np.stack([self.vertices.min(0), self.vertices.max(0)])
        _freeze(bounds)
        return bounds

    @cached_property
    def caster(self) -> RayCaster:
        """Ray caster of the triangles."""
        return RayCaster(self.vertices, self.faces)

    @cached_property
    def _tree(self) -> "cKDTree":
        from scipy.spatial import cKDTree

        return cKDTree(self.vertices)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (N, 3), unit frame, to the surface; return them and their distances, (N,).

        Within half a voxel of the surface, takes Newton steps along the gradient of the distance. For
        points farther away, where a gradient can lead to the wrong side of a wall, where the steps go
        astray, and beside edges and thin walls, which the grid does not hold, finds the nearest triangle.
        """
        points = np.asarray(points, np.float64)
        voxel = self.grid.spacing
        position = torch.from_numpy(points)
        distance, normals = self.grid.distance_and_normals(position)
        away = distance.abs().numpy()
        far = away >= _NEAR * voxel
        far |= (np.abs(points) > BOUND).any(1)  # the grid is clamped beyond its border
        if self.grid.features is not None:
            far |= self._beside_features(points)
        for step in range(_NEWTON_STEPS):
            if step:
                distance, normals = self.grid.distance_and_normals(position)
            position = position - (distance[:, None] * normals).to(torch.float64)
        projected = position.numpy()
        far |= np.linalg.norm(projected - points, axis=1) > away + _ASTRAY * voxel
        projected[far] = self._nearest_on_triangles(points[far])
        return projected, np.linalg.norm(projected - points, axis=1)

    def _nearest_on_triangles(self, points: np.ndarray) -> np.ndarray:
        """Return the nearest points of the triangles around the nearest vertices; (N, 3)."""
        parts = [points[first : first + _PART] for first in range(0, len(points), _PART)]
        return np.concatenate([self._closest_points(part) for part in parts]) if parts else points

    def _closest_points(self, points: np.ndarray) -> np.ndarray:
        """Do `_nearest_on_triangles` for at most `_PART` points."""
        from trimesh.triangles import closest_point

        nearest = self._tree.query(points, min(_VERTICES, len(self.vertices)))[1]
        around = np.sort(self._around[nearest].reshape(len(points), -1))
        once = around >= 0
        once[:, 1:] &= around[:, 1:] != around[:, :-1]
        row, face = np.nonzero(once)[0], around[once]
        voxel = self.grid.spacing  # the thresholds of trimesh are absolute
        closest = voxel * closest_point(self.vertices[self.faces[face]] / voxel, points[row] / voxel)
        distance = np.linalg.norm(closest - points[row], axis=1)
        order = np.lexsort((distance, row))
        return closest[order[np.searchsorted(row, np.arange(len(points)))]]

    @cached_property
    def _around(self) -> np.ndarray:
        """The triangles around each vertex; (V, most) int32, with -1 for none."""
        order = np.argsort(self.faces, axis=None, kind="stable")
        vertex = self.faces.ravel()[order]
        place = np.arange(len(vertex)) - np.searchsorted(vertex, vertex)
        around = np.full((len(self.vertices), place.max() + 1), -1, np.int32)
        around[vertex, place] = order // 3
        return around

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


def _freeze(*arrays: np.ndarray) -> None:
    """Make arrays read-only."""
    for array in arrays:
        array.flags.writeable = False
