"""AudioNet ``spectrogram``: the paper's three branches (supplementary E), one per force axis, each from a
point and a time-frequency bin to the bin's complex value.

It memorises 257 x 201 numbers per point and axis where the gains are M; it is here to compare with.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.audio.spectrogram import SHAPE
from objectfolder.nets.positional import PointwiseNetwork, with_half_weights


class SpectrogramNet(nn.Module):
    """Spectrograms of unit impulses along x, y and z at points of the surface; silent until trained.

    Parameters
    ----------
    damped_frequency : (M,) tensor, rad/s
        Of the modes that it has learnt; for information.
    low, high : float
        Values that the outputs 0 and 1 stand for, m kg^1/2 per N s.
    width, depth, point_octaves, bin_octaves
        See `PointwiseNetwork`; the paper's branches have eight layers of 256 channels.
    """

    damped_frequency: torch.Tensor
    range: torch.Tensor

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        low: float,
        high: float,
        width: int,
        depth: int,
        point_octaves: int,
        bin_octaves: int,
    ):
        super().__init__()
        self.config = {
            "width": width,
            "depth": depth,
            "point_octaves": point_octaves,
            "bin_octaves": bin_octaves,
        }
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("range", torch.tensor([low, high], dtype=torch.float64))
        branches = [PointwiseNetwork(width, depth, point_octaves, bin_octaves, outputs=2) for _ in range(3)]
        for branch in branches:
            nn.init.zeros_(branch.output.weight)
            nn.init.constant_(branch.output.bias, -low / (high - low))
        self.branches = nn.ModuleList(branches)

    def forward(self, points: torch.Tensor, bins: torch.Tensor) -> torch.Tensor:
        """Values in [0, 1] at (N, 3) points of the unit frame and (N,) flat bins; (N, 3 axes, 2)."""
        x = torch.cat([2 * points, _coordinates(points.device)[bins]], 1)
        return torch.stack([branch(x) for branch in self.branches], 1)

    @torch.no_grad()
    def spectrograms(self, points: torch.Tensor) -> torch.Tensor:
        """Complex spectrograms at (N, 3) points of the unit frame, m kg^1/2 per N s; (N, 3, 257, 201)."""
        device = self.range.device
        bins = torch.arange(math.prod(SHAPE), device=device)
        low, high = self.range.tolist()
        out = torch.empty(len(points), 3, *SHAPE, dtype=torch.complex64, device=device)
        for image, point in zip(out, points.to(device, torch.float32)):
            values = self(point.expand(len(bins), 3), bins) * (high - low) + low
            image[:] = torch.view_as_complex(values.transpose(0, 1).contiguous()).view(3, *SHAPE)
        return out

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (weights as float16; the biases hold the level of silence) and configuration."""
        return with_half_weights(self), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SpectrogramNet":
        """Inverse of `to_tensors`."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        net = cls(state["damped_frequency"], *state["range"].tolist(), **config)
        net.load_state_dict(state)
        return net.eval()


def _coordinates(device: torch.device) -> torch.Tensor:
    """Frequency and time of every bin in [-1, 1]; (bins, 2)."""
    axes = [torch.linspace(-1, 1, size, device=device) for size in SHAPE]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).flatten(0, 1)
