"""Net that tells from two pictures of nearby contacts how to move from one to the other.

It does not compare pixels itself: it reads how well the pictures match at shifts and turns, of which a few
hundred contacts suffice to learn.
"""

import math

import torch
from torch import nn
from torch.nn import functional as F

SHIFT = 7  #: greatest shift that is tried, pixels of halved pictures
TURNS = torch.linspace(-math.pi / 6, math.pi / 6, 7)  #: that are tried, radians
BLUR = 7  #: side of the square whose mean is taken off each pixel
SHARPNESS = (5.0, 15.0, 50.0)  #: of the softmax over shifts and turns whose mean is read
POOLED = (4, 3)  #: size at which the pictures themselves are read
FEATURES = 128


def matches(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Correlate pictures (B, C, H, W) with others, turned and shifted; (B, C // 3, 7, 15, 15).

    Each three channels are one picture. The axes of the answer are the turn, the shift up to down, and the
    shift left to right.
    """
    size = (first.shape[2] // 2, first.shape[3] // 2)
    a, b = (_details(pictures).unflatten(1, (-1, 3)) for pictures in (first, second))
    padded = tuple(max(2 * side, 2 * SHIFT + 1) for side in size)
    spectrum = torch.fft.rfft2(a, padded)
    found = []
    for grid in _turned(size, a.device):
        turned = F.grid_sample(b.flatten(1, 2), grid.expand(len(b), -1, -1, -1), align_corners=False)
        other = torch.fft.rfft2(turned.unflatten(1, (-1, 3)), padded)
        found.append(torch.fft.irfft2((spectrum * other.conj()).sum(2), padded))
    shifted = torch.stack(found, 2).roll((SHIFT, SHIFT), (3, 4)) / (3 * size[0] * size[1])
    return shifted[..., : 2 * SHIFT + 1, : 2 * SHIFT + 1]


def _details(pictures: torch.Tensor) -> torch.Tensor:
    """Return halved pictures without what is smooth, each three channels of the same size."""
    half = F.avg_pool2d(pictures, 2)
    edge = (BLUR // 2,) * 4
    rough = (half - F.avg_pool2d(F.pad(half, edge, mode="replicate"), BLUR, 1)).unflatten(1, (-1, 3))
    size = rough.square().mean((2, 3, 4), keepdim=True).add(1e-4).sqrt()
    return (rough / size).flatten(1, 2)


def _turned(size: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Return where pixels of turned pictures are looked up; (7, H, W, 2)."""
    ratio, cos, sin = size[0] / size[1], TURNS.cos(), TURNS.sin()
    rows = torch.stack([cos, -sin * ratio, 0 * cos, sin / ratio, cos, 0 * cos], 1)
    return F.affine_grid(rows.view(-1, 2, 3), [len(TURNS), 1, *size], align_corners=False).to(device)


def compared(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return what `DisplacementNet` reads of two pictures (B, C, H, W) each; (B, D)."""
    maps = matches(first, second)
    steps = torch.linspace(-1, 1, 2 * SHIFT + 1, device=maps.device)
    turns = torch.linspace(-1, 1, len(TURNS), device=maps.device)
    read = [maps.flatten(1)]
    for sharpness in SHARPNESS:
        share = F.softmax(sharpness * maps.flatten(2), 2).view_as(maps)
        read += [(share.sum((2, 3)) * steps).sum(2), (share.sum((2, 4)) * steps).sum(2)]
        read.append((share.sum((3, 4)) * turns).sum(2))
    read += [F.adaptive_avg_pool2d(pictures, POOLED).flatten(1) for pictures in (first, second)]
    return torch.cat(read, 1)


class DisplacementNet(nn.Sequential):
    """What was `compared`, (B, inputs), to the motion (B, 3) from the first contact to the second."""

    def __init__(self, inputs: int):
        super().__init__(
            *(nn.BatchNorm1d(inputs, affine=False), nn.Dropout(0.2), nn.Linear(inputs, FEATURES)),
            *(nn.ReLU(), nn.Dropout(0.2), nn.Linear(FEATURES, 3)),
        )
