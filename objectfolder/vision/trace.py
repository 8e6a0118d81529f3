"""What camera rays see of a stored surface: hit points, normals, and whether the light reaches them."""

from dataclasses import dataclass, fields

import numpy as np
import torch

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

    def interpolated(self, attributes: torch.Tensor) -> torch.Tensor:
        """Values at the samples of attributes (V, C) at the surface's vertices; (S, C)."""
        return torch.bmm(self.weights[:, None], attributes[self.corners])[:, 0]


def trace(
    surface: Isosurface, origins: np.ndarray, directions: np.ndarray, light: np.ndarray
) -> SurfaceSamples:
    """Cast rays against a surface and shadow rays to a point light.

    Parameters
    ----------
    origins, directions : (N, 3) float32 arrays, unit frame; directions of unit length
    light : (3,) array, unit frame
    """
    ray, distance, face, weights = surface.caster.intersect(origins, directions)
    points = origins[ray] + directions[ray] * distance[:, None]
    corners = surface.faces[face]
    normals = np.einsum("sc,sck->sk", weights, surface.normals[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-20))
    light = np.asarray(light, np.float32)
    lit = ((light - points) * normals).sum(1) > 0
    facing = np.flatnonzero(lit)
    start = points[facing] + normals[facing] * np.float32(SHADOW_OFFSET * surface.grid.spacing)
    to_light = light - start
    length = np.linalg.norm(to_light, axis=1)
    lit[facing] = ~surface.caster.occluded(start, to_light / length[:, None], length)
    return SurfaceSamples(
        ray=torch.from_numpy(ray),
        points=torch.from_numpy(points),
        normals=torch.from_numpy(normals),
        directions=torch.from_numpy(directions[ray]),
        lit=torch.from_numpy(lit),
        corners=torch.from_numpy(corners),
        weights=torch.from_numpy(weights),
    )
