"""Sinusoidal representation network (Sitzmann et al. 2020)."""

import itertools
import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import nn


class Siren(nn.Module):
    """Fully connected layers with sine activations.

    ``frequency`` is a factor inside every sine; higher values resolve finer detail.
    """

    def __init__(self, inputs: int, widths: Sequence[int], frequency: float):
        super().__init__()
        self.frequency = frequency
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise([inputs, *widths]))
        for i, weight in enumerate(self.weights):
            bound = 1 / inputs if i == 0 else sine_bound(weight.shape[1], frequency)
            nn.init.uniform_(weight, -bound, bound)

    @property
    def weights(self) -> list[nn.Parameter]:
        """Weight matrices of the layers."""
        return [parameter for parameter in self.parameters() if parameter.ndim == 2]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate the layers; (N, inputs) to (N, widths[-1])."""
        for layer in self.layers:
            assert isinstance(layer, nn.Linear)
            # Weights are fewer than the outputs of a batch.
            weight, bias = self.frequency * layer.weight, self.frequency * layer.bias
            x = torch.sin(F.linear(x, weight, bias))
        return x


def sine_bound(inputs: int, frequency: float) -> float:
    """Return the bound b of the uniform initialisation [-b, b] of a layer after sines."""
    return math.sqrt(6 / inputs) / frequency
