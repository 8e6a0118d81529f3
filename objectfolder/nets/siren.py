"""Sinusoidal representation network (Sitzmann et al. 2020)."""

import itertools
import math

import torch
from torch import nn


class Siren(nn.Module):
    """Fully connected network with sine activations.

    Parameters
    ----------
    inputs, outputs : int
    width, depth : int
        Hidden layers.
    frequency : float
        Factor inside every sine; higher resolves finer detail.
    """

    def __init__(self, inputs: int, outputs: int, width: int, depth: int, frequency: float):
        super().__init__()
        self.frequency = frequency
        sizes = [inputs] + [width] * depth
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.output = nn.Linear(width, outputs)
        with torch.no_grad():
            for i, layer in enumerate([*self.hidden, self.output]):
                bound = 1 / inputs if i == 0 else math.sqrt(6 / width) / frequency
                layer.weight.uniform_(-bound, bound)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate at (N, inputs); (N, outputs)."""
        for layer in self.hidden:
            x = torch.sin(self.frequency * layer(x))
        return self.output(x)
