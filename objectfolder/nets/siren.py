"""Sinusoidal representation network (Sitzmann et al. 2020)."""

import itertools
import math
from collections.abc import Sequence

import torch
from torch import nn


class Siren(nn.Module):
    """Fully connected network with sine activations.

    Parameters
    ----------
    inputs, outputs : int
    widths : sequence of int
        Of the hidden layers.
    frequency : float
        Factor inside every sine; higher resolves finer detail.
    """

    def __init__(self, inputs: int, outputs: int, widths: Sequence[int], frequency: float):
        super().__init__()
        self.frequency = frequency
        sizes = [inputs, *widths]
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.output = nn.Linear(sizes[-1], outputs)
        with torch.no_grad():
            for i, layer in enumerate([*self.hidden, self.output]):
                bound = 1 / inputs if i == 0 else math.sqrt(6 / layer.in_features) / frequency
                layer.weight.uniform_(-bound, bound)

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate the last hidden layer at (N, inputs)."""
        for layer in self.hidden:
            x = torch.sin(self.frequency * layer(x))
        return x

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate at (N, inputs); (N, outputs)."""
        return self.output(self.features(x))
