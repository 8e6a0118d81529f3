"""Stored geometry: a band-limited signed distance on a cubic grid, quantised to int8."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from objectfolder.mesh.featurecodec import Features
from objectfolder.mesh.gridcodec import BOUND, enclosing_box

#: Corners of a tetrahedron; not of `torch.tensor`, which obeys torch's defaults at the time of import.
_TETRAHEDRON = torch.from_numpy(np.array([[1, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], np.float32))


class DistanceGrid:
    """Signed distance (negative inside) in the unit frame, trilinear between samples.

    Parameters
    ----------
    values : (R, R, R) int8 array, indexed x, y, z
        Distances in units of ``band / 127``.
    band : float
        Distances are clipped to +-band.
    features : Features, optional
        Of the surface's mesh; distances do without them.
    """

    def __init__(self, values: np.ndarray, band: float, features: Features | None = None):
        self.values = np.asarray(values, np.int8)
        self.features = features
        self.band = float(band)
        self.spacing = 2 * BOUND / (len(self.values) - 1)
        box = enclosing_box(self.values < 127)  # beyond it every sample is 127
        volume = self.values[tuple(box)].astype(np.float32)
        volume *= np.float32(self.band / 127)
        # grid_sample expects (batch, channel, z, y, x), with any strides.
        self._volume = torch.from_numpy(volume).permute(2, 1, 0)[None, None]
        first, last = np.array([(side.start, side.stop - 1) for side in box], np.float32).T
        self._centre = torch.from_numpy((first + last) / 2 * self.spacing - BOUND).float()
        self._half = torch.from_numpy((last - first) / 2 * self.spacing).float()

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> "DistanceGrid":
        """Return the grid stored in ``sdf.npz``."""
        return cls(arrays["values"], float(arrays["band"]), Features.from_arrays(arrays))

    def distance(self, points: torch.Tensor) -> torch.Tensor:
        """Interpolate the signed distance at (N, 3) points; (N,)."""
        grid = ((points.to(torch.float32) - self._centre) / self._half).view(1, -1, 1, 1, 3)
        return F.grid_sample(self._volume, grid, align_corners=True, padding_mode="border").view(-1)

    def smooth_distance(self, points: Any) -> Any:
        """Interpolate the signed distance at (N, 3) points by cubic convolution (Keys 1981); (N,) float64.

        Uses 64 samples per point, `distance` 8: slower, and more accurate where the surface bends. Of a
        tensor it returns a tensor, through which gradients flow.
        """
        tensor = isinstance(points, torch.Tensor)
        place: Any = points.double() if tensor else np.asarray(points, np.float64)
        place = (place.reshape(-1, 3) + BOUND) / self.spacing
        first = np.floor(place.detach().numpy() if tensor else place)
        taps = first.astype(np.int64)[..., None] + np.arange(-1, 3)
        x, y, z = np.moveaxis(taps.clip(0, len(self.values) - 1), 1, 0)
        samples: Any = self.values[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
        if tensor:
            first, samples = torch.from_numpy(first), torch.from_numpy(samples)
        weights = _keys(place - first)  # (N, 3, 4)
        # Axis by axis, in a fixed order of summation.
        total = (samples * weights[:, 2, None, None, :]).sum(3)
        total = (total * weights[:, 1, None, :]).sum(2)
        return (total * weights[:, 0]).sum(1) * (self.band / 127)

    def normals(self, points: torch.Tensor) -> torch.Tensor:
        """Compute outward unit normals at (N, 3) points by differences over half a voxel; (N, 3)."""
        return ascent(self.distance, points, self.spacing / 2)

    def distance_and_normals(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return `distance` and `normals` at (N, 3) points, in one pass over the grid."""
        points = points.to(torch.float32)
        corner = _TETRAHEDRON.to(points.device)
        taps = points + corner[:, None] * (self.spacing / 2)
        value = self.distance(torch.cat([points[None], taps]).view(-1, 3)).view(5, -1)
        return value[0], _direction(value[1:], corner)


def _keys(t: Any) -> Any:
    """Return the cubic convolution weights (..., 4) of samples at -1, 0, 1, 2 for t in [0, 1]."""
    near = (t * (t * (2 - t) - 1), t**2 * (3 * t - 5) + 2)
    far = (t * (t * (4 - 3 * t) + 1), t**2 * (t - 1))
    return (torch if isinstance(t, torch.Tensor) else np).stack([*near, *far], -1) / 2


def ascent(field: Callable[[torch.Tensor], torch.Tensor], points: torch.Tensor, step: float) -> torch.Tensor:
    """Compute the normalised gradient of a field (N, 3) -> (N,) by tetrahedral differences; (N, 3).

    Zero where the field is constant.
    """
    corner = _TETRAHEDRON.to(points)
    taps = (points[None] + corner[:, None] * step).reshape(-1, 3)
    return _direction(field(taps).view(4, -1), corner)


def _direction(values: torch.Tensor, corner: torch.Tensor) -> torch.Tensor:
    """Compute the normalised gradient from values (4, N) at the corners of tetrahedra; (N, 3)."""
    return F.normalize((values[..., None] * corner[:, None]).sum(0), dim=-1, eps=1e-20)
