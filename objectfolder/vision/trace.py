"""What camera rays see of a stored surface: hit points, normals, and whether the light reaches them."""

from dataclasses import dataclass, fields

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.mesh.isosurface import Isosurface

SHADOW_OFFSET = 0.05  # voxels along the normal where shadow rays start: further off, shadows move


@dataclass(frozen=True)
class SurfaceSamples:
    """Visible points of a surface; tensors share their first dimension S."""

    ray: torch.Tensor  #: (S,) int64, which ray saw the point
    points: torch.Tensor  #: (S, 3) float32, unit frame
    normals: torch.Tensor  #: (S, 3) float32, outward
    directions: torch.Tensor  #: (S, 3) float32, from the camera
    lit: torch.Tensor  #: (S,) bool, faces the light and is not in shadow
    corners: torch.Tensor  #: (S, 3) int64, vertices of the triangle that holds the point
    weights: torch.Tensor  #: (S, 3) float32, barycentric

    def select(self, index: torch.Tensor) -> "SurfaceSamples":
        """Return some of the samples."""
        return SurfaceSamples(*(getattr(self, field.name)[index] for field in fields(self)))

    def joined(self, others: "SurfaceSamples") -> "SurfaceSamples":
        """Return these samples, then the others."""
        pairs = ((getattr(self, field.name), getattr(others, field.name)) for field in fields(self))
        return SurfaceSamples(*map(torch.cat, pairs))

    def interpolated(self, attributes: torch.Tensor) -> torch.Tensor:
        """Values at the samples of attributes (V, C) at the surface's vertices; (S, C)."""
        return weighted_rows(attributes, self.corners, self.weights)


def weighted_rows(table: torch.Tensor, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Sum of rows of a table (R, C), K for each of S points, by weights; rows and weights are (S, K)."""
    return F.embedding_bag(rows, table, mode="sum", per_sample_weights=weights)


def trace(
    surface: Isosurface, origins: np.ndarray, directions: np.ndarray, light: np.ndarray
) -> SurfaceSamples:
    """Cast rays against a surface and shadow rays to a point light.

    Parameters
    ----------
    origins, directions : (N, 3) float32 arrays, unit frame; directions of unit length
    light : (3,) array, unit frame
    """
    ray, distance, face, barycentric = surface.caster.intersect(origins, directions)
    directions = directions[ray]
    points = origins[ray] + directions * distance[:, None]
    corners, weights = torch.from_numpy(surface.faces[face]), torch.from_numpy(barycentric)
    normals = F.normalize(weighted_rows(torch.from_numpy(surface.normals), corners, weights), dim=1).numpy()
    lit = is_lit(surface, points, normals, light)
    return SurfaceSamples(
        ray=torch.from_numpy(ray),
        points=torch.from_numpy(points),
        normals=torch.from_numpy(normals),
        directions=torch.from_numpy(directions),
        lit=torch.from_numpy(lit),
        corners=corners,
        weights=weights,
    )


def is_lit(surface: Isosurface, points: np.ndarray, normals: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Which points of the surface face a light that nothing hides; (S,) bool.

    Parameters
    ----------
    points, normals : (S, 3) float32 arrays, unit frame
    light : (3,) array, unit frame
    """
    light = np.asarray(light, np.float32)
    lit = _dot(light - points, normals) > 0
    facing = np.flatnonzero(lit)
    start = points[facing] + normals[facing] * np.float32(SHADOW_OFFSET * surface.grid.spacing)
    to_light = light - start
    length = np.sqrt(_dot(to_light, to_light))
    lit[facing] = ~surface.caster.occluded(start, to_light / length[:, None], length)
    return lit


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("sk,sk->s", a, b)
