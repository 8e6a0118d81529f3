"""What the paper's nets share: positional encoding, a ReLU network that its input joins again, storing."""

import math

import numpy as np
import torch
from torch import nn

SKIP = 4  # the layer whose output the input joins again (Mildenhall et al. 2020)


def octave_angles(x: torch.Tensor, octaves: int, lowest: float = math.pi) -> torch.Tensor:
    """2^k lowest x for k from 0 below ``octaves``; (N, D) to (N, D octaves), the octave running fastest."""
    return (x[:, :, None] * (lowest * 2.0 ** torch.arange(octaves, device=x.device))).flatten(1)


def encoded(x: torch.Tensor, octaves: int, lowest: float = math.pi) -> torch.Tensor:
    """Coordinates with sines and cosines of their octaves; (N, D) to (N, D (1 + 2 octaves))."""
    angle = octave_angles(x, octaves, lowest)
    return torch.cat([x, angle.sin(), angle.cos()], 1)


class SkipNetwork(nn.Module):
    """ReLU layers; the input joins again after the fifth.

    Parameters
    ----------
    inputs, width, depth : int
        The paper's have eight layers of 256 channels.
    """

    def __init__(self, inputs: int, width: int, depth: int):
        super().__init__()
        sizes = [inputs] + [width + inputs * (i == SKIP + 1) for i in range(1, depth)]
        layers = [nn.Linear(size, width) for size in sizes]
        for layer in layers:
            nn.init.xavier_uniform_(layer.weight, nn.init.calculate_gain("relu"))
            nn.init.zeros_(layer.bias)
        self.hidden = nn.ModuleList(layers)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Last hidden layer; (N, inputs) to (N, width)."""
        hidden = x
        for i, layer in enumerate(self.hidden):
            hidden = torch.relu(layer(torch.cat([x, hidden], 1) if i == SKIP + 1 else hidden))
        return hidden


class PointwiseNetwork(SkipNetwork):
    """ReLU network from a point and a place (time and frequency, or pixel), positionally encoded, to values.

    Parameters
    ----------
    width, depth : int
        Hidden layers.
    point_octaves, place_octaves : int
        Each input x comes with sin and cos of 2^k pi x, k from 0 below this.
    outputs : int
    """

    def __init__(self, width: int, depth: int, point_octaves: int, place_octaves: int, outputs: int):
        super().__init__(3 * (1 + 2 * point_octaves) + 2 * (1 + 2 * place_octaves), width, depth)
        self.octaves = (point_octaves, place_octaves)
        self.output = nn.Linear(width, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate at (N, 5) point and place in [-1, 1]; (N, outputs)."""
        angle = torch.cat([octave_angles(part, n) for part, n in zip(x.split([3, 2], 1), self.octaves)], 1)
        return self.output(super().forward(torch.cat([x, angle.sin(), angle.cos()], 1)))


def with_half_weights(net: nn.Module) -> dict[str, np.ndarray]:
    """Tensors of a net for storing: weights as float16, all others as they are."""
    return {
        name: (value.half() if name.endswith("weight") else value).cpu().numpy()
        for name, value in net.state_dict().items()
    }
