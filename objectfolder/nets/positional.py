"""Parts shared by the paper's nets: positional encoding, ReLU network with a skip connection."""

import math
from contextlib import nullcontext

import torch
from torch import nn

from objectfolder.base.settings import Precision

SKIP = 4  # the input is concatenated to the output of this layer (Mildenhall et al. 2020)


def octave_angles(x: torch.Tensor, octaves: int, lowest: float = math.pi) -> torch.Tensor:
    """Compute 2^k lowest x, k = 0 ... octaves - 1; (N, D) to (N, D octaves), with k running fastest."""
    powers = 2.0 ** torch.arange(octaves, dtype=x.dtype, device=x.device)
    return (x[:, :, None] * (lowest * powers)).flatten(1)


def append_octaves(x: torch.Tensor, octaves: int, lowest: float = math.pi) -> torch.Tensor:
    """Append the sines and cosines of `octave_angles` to coordinates; (N, D) to (N, D (1 + 2 octaves))."""
    angle = octave_angles(x, octaves, lowest)
    return torch.cat([x, angle.sin(), angle.cos()], 1)


class SkipNetwork(nn.Module):
    """ReLU layers, in the paper eight of 256 channels; the input is concatenated again after the fifth."""

    precision: torch.dtype = torch.float32  #: of the hidden layers in training (`train_in`), not in answers

    def __init__(self, inputs: int, width: int, depth: int):
        super().__init__()
        sizes = [inputs] + [width + inputs * (i == SKIP + 1) for i in range(1, depth)]
        layers = [nn.Linear(size, width) for size in sizes]
        for layer in layers:
            nn.init.xavier_uniform_(layer.weight, nn.init.calculate_gain("relu"))
            nn.init.zeros_(layer.bias)
        self.hidden = nn.ModuleList(layers)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate the last hidden layer; (N, inputs) to (N, width)."""
        lower = self.training and self.precision != torch.float32
        with torch.autocast(x.device.type, self.precision) if lower else nullcontext():
            x = x.to(self.precision) if lower else x
            hidden = x
            for i, layer in enumerate(self.hidden):
                hidden = torch.relu(layer(torch.cat([x, hidden], 1) if i == SKIP + 1 else hidden))
        return hidden.float() if lower else hidden


class HiddenLinear(nn.Linear):
    """A linear layer between hidden layers, which is trained in their precision (`train_in`)."""

    precision: torch.dtype = torch.float32

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate the layer; (N, inputs) to (N, outputs)."""
        if not self.training or self.precision == torch.float32:
            return super().forward(x)
        with torch.autocast(x.device.type, self.precision):
            return super().forward(x).float()


def train_in(net: nn.Module, precision: Precision) -> None:
    """Set the precision in which a net's `SkipNetwork` and `HiddenLinear` layers are trained.

    Weights, gradients, the optimizer and the output layers stay float32. A processor with AVX-512 BF16
    multiplies matrices of bfloat16 four times as fast; one without takes longer than with float32.
    """
    for part in net.modules():
        if isinstance(part, SkipNetwork | HiddenLinear):
            part.precision = getattr(torch, precision)


class PointwiseNetwork(SkipNetwork):
    """ReLU network from a point and a place (frequency and time, or pixel), positionally encoded, to values.

    Each input x is encoded as x and sin and cos of 2^k pi x, for k below the number of octaves.
    """

    def __init__(self, width: int, depth: int, point_octaves: int, place_octaves: int, outputs: int):
        super().__init__(3 * (1 + 2 * point_octaves) + 2 * (1 + 2 * place_octaves), width, depth)
        self.octaves = (point_octaves, place_octaves)
        self.output = nn.Linear(width, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate at (N, 5) points and places, -1 to 1; (N, outputs)."""
        angle = torch.cat([octave_angles(part, n) for part, n in zip(x.split([3, 2], 1), self.octaves)], 1)
        return self.output(super().forward(torch.cat([x, angle.sin(), angle.cos()], 1)))
