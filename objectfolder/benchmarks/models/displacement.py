"""Net that tells from two pictures of nearby contacts how to move from one to the other."""

from itertools import pairwise

import torch
from torch import nn

FEATURES = 128  #: of a pair


class DisplacementNet(nn.Module):
    """Two pictures (B, C, H, W) of nearby contacts, each, to the motion (B, 3) from the first to the second.

    They enter together, so that the first layers can compare the same pixels. ``width`` is the number of
    channels of the first layer, ``size`` (H, W).
    """

    def __init__(self, channels: int, size: tuple[int, int], width: int):
        super().__init__()
        widths = (2 * channels, width, 2 * width, 4 * width, 4 * width)
        layers: list[nn.Module] = []
        for depth, (inputs, outputs) in enumerate(pairwise(widths)):
            kernel, step = (5 if depth == 0 else 3), (1 if depth == 3 else 2)
            layers.append(nn.Conv2d(inputs, outputs, kernel, step, kernel // 2, bias=False))
            layers += [nn.BatchNorm2d(outputs), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            count = self.convolutions(torch.zeros(2, 2 * channels, *size)).shape[1]
        self.head = nn.Sequential(nn.Linear(count, FEATURES), nn.ReLU(), nn.Linear(FEATURES, 3))

    def forward(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Return motions."""
        motions: torch.Tensor = self.head(self.convolutions(torch.cat([first, second], 1)))
        return motions
