"""Ray casting of a stored surface: hit points, normals and shadows."""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.vision.lighting import toward
from objectfolder.vision.vectors import column_major, concatenate, dot, normalize_rows, take_rows

HORIZON = 0.035  # sine of the angle behind a surface from which light may still reach it
REACH = 2.0  # unit frame; beyond the cube of any point of the surface
SHADOW_OFFSET = 0.05  # voxels along the normal where shadow rays start; more would move shadows


@dataclass(frozen=True)
class SurfaceSamples:
    """Visible points of a surface; tensors share their first dimension S.

    `trace` returns column-major tensors; see `objectfolder.vision.vectors`.
    """

    ray: torch.Tensor  #: (S,) int64, index of the ray
    points: torch.Tensor  #: (S, 3) float32, unit frame
    normals: torch.Tensor  #: (S, 3) float32, outward
    directions: torch.Tensor  #: (S, 3) float32, from the camera, of unit length
    distance: torch.Tensor  #: (S,) float32, from the camera, in units of the given ray direction's length
    lit: torch.Tensor  #: (S,) bool, whether the outer side faces the light and is not in shadow
    corners: torch.Tensor  #: (S, 3) int32, vertices of the point's triangle in `Isosurface.shading`
    weights: torch.Tensor  #: (S, 3) float32, barycentric

    def select(self, index: torch.Tensor) -> "SurfaceSamples":
        """Return some of the samples."""
        return SurfaceSamples(*(take_rows(getattr(self, field.name), index) for field in fields(self)))

    def join(self, others: "SurfaceSamples") -> "SurfaceSamples":
        """Return these samples, then the others."""
        if not len(self.ray):
            return others
        pairs = ((getattr(self, field.name), getattr(others, field.name)) for field in fields(self))
        return SurfaceSamples(*(concatenate(pair) for pair in pairs))

    def to(self, device: torch.device | str) -> "SurfaceSamples":
        """Return these samples on a device."""
        return SurfaceSamples(*(getattr(self, field.name).to(device) for field in fields(self)))

    @cached_property
    def nearest_corner(self) -> torch.Tensor:
        """Nearest vertex of `Isosurface.shading`; (S,) int32."""
        return nearest_corners(self.corners, self.weights)

    def interpolate(self, attributes: torch.Tensor) -> torch.Tensor:
        """Interpolate attributes (V', C) of the vertices of `Isosurface.shading` at the samples; (S, C)."""
        return weighted_rows(attributes, self.corners, self.weights)


def weighted_rows(table: torch.Tensor, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Return weighted sums (S, C) of rows of a table (R, C); rows and weights are (S, K)."""
    return F.embedding_bag(rows, table, mode="sum", per_sample_weights=weights)


def nearest_corners(corners: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Return the nearest corner of each triangle, (S,), from barycentric weights (S, 3)."""
    (a, b, c), (first, second, third) = weights.unbind(1), corners.unbind(1)
    nearest = torch.where(b > a, second, first)  # several times faster than an argmax of three
    return torch.where(c > torch.maximum(a, b), third, nearest)


def trace(
    surface: Isosurface, origins: np.ndarray, directions: np.ndarray, light: np.ndarray
) -> SurfaceSamples:
    """Cast rays, origins (N, 3) or (3,), directions (N, 3), float32, and shadow rays to a light; unit frame.

    The light is a point light (3,) or a distant one (4,), see `objectfolder.vision.lighting.toward`.
    """
    ray, distance, face, barycentric = surface.caster.intersect(origins, directions)
    index, t = torch.from_numpy(ray), torch.from_numpy(distance)
    away = torch.from_numpy(directions.T.take(ray, 1)).T
    start = torch.tensor(origins) if origins.ndim == 1 else torch.from_numpy(origins.T.take(ray, 1)).T
    points = start + away * t[:, None]
    corners, weights = torch.from_numpy(surface.corners(face)), torch.from_numpy(barycentric)
    normals = normalize_rows(column_major(weighted_rows(surface.shading.tensor, corners, weights)))
    lit = is_lit(surface, points, normals, torch.from_numpy(np.asarray(light, np.float32)))
    return SurfaceSamples(index, points, normals, normalize_rows(away), t, lit, corners, weights)


def is_lit(
    surface: Isosurface, points: torch.Tensor, normals: torch.Tensor, light: torch.Tensor
) -> torch.Tensor:
    """Return which points (S, 3) of the surface face the light and are not in shadow; (S,) bool.

    Float32, unit frame; lights are those of `objectfolder.vision.lighting.toward`.
    """
    to_light = toward(light, points)
    # Stored normals are off by a degree; shadow rays and shading normals tell what is behind the horizon.
    lit = dot(to_light, normals)[:, 0] > -HORIZON * to_light.square().sum(1).sqrt()
    facing = lit.nonzero()[:, 0]
    start = take_rows(points, facing) + take_rows(normals, facing) * (SHADOW_OFFSET * surface.grid.spacing)
    # Directions reach to the light, at distance 1, or out of the cube.
    end = np.full(len(facing), 1 if len(light) == 3 else REACH, np.float32)
    way = toward(light, start).numpy()
    lit[facing] = torch.from_numpy(~surface.caster.occluded(start.numpy(), way, end))
    return lit
