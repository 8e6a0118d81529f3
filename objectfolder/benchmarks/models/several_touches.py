"""An encoder of several touches of one object."""

from typing import Any, cast

import torch
from torch import nn

from objectfolder.benchmarks.models.inputs import Ground


class SeveralTouches(nn.Module):
    """Encode several touches of an object by the mean of their features; where they are is not told.

    Parameters
    ----------
    encoder : nn.Module
        Of one touch, with an attribute ``features``.
    size : (int, int)
        Height and width of its inputs.
    """

    def __init__(self, encoder: nn.Module, size: tuple[int, int]):
        super().__init__()
        self.encoder = encoder
        self.features = int(cast(Any, encoder).features)
        self.median: torch.Tensor
        self.deviation: torch.Tensor
        self.register_buffer("median", torch.zeros(3, *size))
        self.register_buffer("deviation", torch.ones(()))

    def set_ground(self, ground: Ground) -> None:
        """Subtract what touches have in common from all inputs."""
        self.median.copy_(ground.median)
        self.deviation.copy_(ground.deviation)

    def forward(self, touches: torch.Tensor) -> torch.Tensor:
        """Encode (B, K, 3, H, W) inputs; (B, features)."""
        inputs = Ground(self.median, self.deviation).subtracted(touches.flatten(0, 1))
        encoded: torch.Tensor = self.encoder(inputs)
        return encoded.unflatten(0, touches.shape[:2]).mean(1)
