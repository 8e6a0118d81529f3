"""What camera rays see of a stored surface: hit points, normals, and whether the light reaches them."""

from dataclasses import dataclass, fields

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.mesh.isosurface import Isosurface

SHADOW_OFFSET = 0.05  # voxels along the normal where shadow rays start: further off, shadows move


@dataclass(frozen=True)
class SurfaceSamples:
    """Visible points of a surface; tensors share their first dimension S.

    What `trace` returns holds each of the three columns of a vector in one piece of memory, where operations
    on them are several times faster than on rows of three.
    """

    ray: torch.Tensor  #: (S,) int64, which ray saw the point
    points: torch.Tensor  #: (S, 3) float32, unit frame
    normals: torch.Tensor  #: (S, 3) float32, outward
    directions: torch.Tensor  #: (S, 3) float32, from the camera, of unit length
    distance: torch.Tensor  #: (S,) float32, from the camera, in lengths of the ray's direction as it was given
    lit: torch.Tensor  #: (S,) bool, faces the light and is not in shadow
    corners: torch.Tensor  #: (S, 3) int64, vertices of the triangle that holds the point
    weights: torch.Tensor  #: (S, 3) float32, barycentric

    def select(self, index: torch.Tensor) -> "SurfaceSamples":
        """Return some of the samples."""
        return SurfaceSamples(*(_rows(getattr(self, field.name), index) for field in fields(self)))

    def joined(self, others: "SurfaceSamples") -> "SurfaceSamples":
        """Return these samples, then the others."""
        if not len(others.ray):
            return self
        pairs = ((getattr(self, field.name), getattr(others, field.name)) for field in fields(self))
        return SurfaceSamples(*(_appended(*pair) for pair in pairs))

    def interpolated(self, attributes: torch.Tensor) -> torch.Tensor:
        """Values at the samples of attributes (V, C) at the surface's vertices; (S, C)."""
        return weighted_rows(attributes, self.corners, self.weights)


def weighted_rows(table: torch.Tensor, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Sum of rows of a table (R, C), K for each of S points, by weights; rows and weights are (S, K)."""
    return F.embedding_bag(rows, table, mode="sum", per_sample_weights=weights)


def unit(vectors: torch.Tensor) -> torch.Tensor:
    """Vectors (S, 3) at unit length; zero stays zero."""
    return vectors / dot(vectors, vectors).sqrt().clamp(min=1e-12)


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Scalar products of vectors (S, 3); (S, 1)."""
    return (a * b).sum(-1, keepdim=True)


def columns(rows: torch.Tensor) -> torch.Tensor:
    """Vectors (S, 3), each column in one piece of memory."""
    return rows.T.contiguous().T


def trace(
    surface: Isosurface, origins: np.ndarray, directions: np.ndarray, light: np.ndarray
) -> SurfaceSamples:
    """Cast rays against a surface and shadow rays to a point light.

    Parameters
    ----------
    origins, directions : (N, 3) float32 arrays, unit frame
    light : (3,) array, unit frame
    """
    ray, distance, face, barycentric = surface.caster.intersect(origins, directions)
    index, t = torch.from_numpy(ray), torch.from_numpy(distance)
    start, away = (torch.from_numpy(v.T.take(ray, 1)).T for v in (origins, directions))
    points = start + away * t[:, None]
    corners, weights = torch.from_numpy(surface.faces[face]), torch.from_numpy(barycentric)
    normals = unit(columns(weighted_rows(torch.from_numpy(surface.normals), corners, weights)))
    lit = is_lit(surface, points, normals, torch.from_numpy(np.asarray(light, np.float32)))
    return SurfaceSamples(index, points, normals, unit(away), t, lit, corners, weights)


def is_lit(
    surface: Isosurface, points: torch.Tensor, normals: torch.Tensor, light: torch.Tensor
) -> torch.Tensor:
    """Which points of the surface face a light that nothing hides; (S,) bool.

    Parameters
    ----------
    points, normals : (S, 3) float32 tensors, unit frame
    light : (3,) float32 tensor, unit frame
    """
    lit = dot(light - points, normals)[:, 0] > 0
    facing = lit.nonzero()[:, 0]
    start = _rows(points, facing) + _rows(normals, facing) * (SHADOW_OFFSET * surface.grid.spacing)
    # The ray's direction is as long as the way to the light.
    end = np.ones(len(facing), np.float32)
    lit[facing] = torch.from_numpy(~surface.caster.occluded(start.numpy(), (light - start).numpy(), end))
    return lit


def _appended(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Rows of two tensors, with columns in one piece where they have them so."""
    if _in_columns(first):
        return torch.cat([first.T, second.T], 1).T
    return torch.cat([first, second])


def _in_columns(tensor: torch.Tensor) -> bool:
    return tensor.dim() > 1 and tensor.stride(0) < tensor.stride(1)


def _rows(tensor: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """Some rows of a tensor, with columns in one piece where it has them so."""
    if _in_columns(tensor):
        return tensor.T.index_select(1, index).T
    return tensor.index_select(0, index)
