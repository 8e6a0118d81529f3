"""Net that turns one picture into another of the same size: a small U-Net (Ronneberger et al. 2015)."""

import torch
from torch import nn
from torch.nn import functional as F

DEPTHS = (1, 2, 4, 4)  #: channels at full, half, quarter and eighth of the size, times the width


class Translator(nn.Module):
    """Picture (B, 3, H, W) to a change (B, 3, H, W) of a fixed picture, the answer where nothing is known.

    ``width`` is the number of channels at full size.
    """

    def __init__(self, width: int):
        super().__init__()
        channels = [width * times for times in DEPTHS]
        self.down = nn.ModuleList([_block(a, b) for a, b in zip([3, *channels[:-1]], channels, strict=True)])
        self.up = nn.ModuleList(
            [_block(a + b, b) for a, b in zip(channels[:0:-1], channels[-2::-1], strict=True)]
        )
        self.last = nn.Conv2d(width, 3, 1)
        nn.init.zeros_(self.last.weight)  # the first answer is the fixed picture
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Translate pictures."""
        kept: list[torch.Tensor] = []
        for i, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if i else x)
            kept.append(x)
        kept.pop()
        for block in self.up:
            skipped = kept.pop()
            x = block(torch.cat([F.interpolate(x, skipped.shape[2:]), skipped], 1))
        return self.last(x)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        *(nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()),
        *(nn.Conv2d(outputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()),
    )
