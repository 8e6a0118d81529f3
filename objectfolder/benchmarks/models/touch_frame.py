"""Touches in a frame of their own: the shape of the gel as at one depth, upright.

How deep the sensor is pressed and how it is turned about the contact normal say nothing about the object, but
change every pixel. The shape of the gel (`objectfolder.touch.inverse`) is raised as if the press were `DEPTH`
deep (`levelled`), and turned until its second moments stand upright (`upright`). Four poses are left, mirror
images of each other: training draws one of them, and `Mirrored` answers for all.
"""

from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from torch import nn
from torch.nn.functional import affine_grid, grid_sample

if TYPE_CHECKING:
    from objectfolder.touch.inverse import PhotometricInverse

DEPTH = 1.0  #: of all touches once they are levelled, mm
DEEPEST = 3.0  #: displacement that is kept of a levelled touch, mm


def levelled(displacement: torch.Tensor) -> torch.Tensor:
    """Raise or sink displacements (B, h, w), mm, to `DEPTH` in the middle, where the object is pressed.

    What is then below the gel at rest, or above `DEEPEST`, is cut.
    """
    height, width = displacement.shape[1:]
    rows, columns = (slice((pixels - 1) // 2, pixels // 2 + 1) for pixels in (height, width))
    middle = displacement[:, rows, columns].mean((1, 2), keepdim=True)
    return (displacement + DEPTH - middle).clamp(0, DEEPEST)


def upright(displacement: torch.Tensor, ratio: float) -> torch.Tensor:
    """Turn displacements (B, h, w) until the longer axis of their second moments is upright.

    Only the largest disc in the middle is looked at; what was outside the image is continued from its border.
    ``ratio`` is the height of the images by their width, on the gel. Half a turn stays open.
    """
    height, width = displacement.shape[1:]
    # Centres of pixels; the disc has radius 1.
    down = torch.linspace(-1, 1, 2 * height + 1)[1::2, None] * max(ratio, 1)
    across = torch.linspace(-1, 1, 2 * width + 1)[1::2] * max(1 / ratio, 1)
    weight = displacement * (down**2 + across**2 < 1)
    xx, yy, xy = ((weight * of).sum((1, 2)) for of in (across**2, down**2, down * across))
    angle = torch.atan2(2 * xy, xx - yy) / 2 - torch.pi / 2
    cos, sin, zero = angle.cos(), angle.sin(), torch.zeros_like(angle)
    turn = torch.stack([cos, -sin * ratio, zero, sin / ratio, cos, zero], 1).reshape(-1, 2, 3)
    grid = affine_grid(turn, [len(displacement), 1, height, width], align_corners=False)
    turned = grid_sample(displacement[:, None], grid, padding_mode="border", align_corners=False)
    return turned[:, 0]


def own_shapes(images: np.ndarray, inverse: "PhotometricInverse") -> torch.Tensor:
    """Return the gel of touches (B, H, W, 3) uint8 in their own frame; (B, h, w), mm."""
    height, width = images.shape[1:3]
    return upright(levelled(inverse.displacement(images)), height / width)


def gel_inputs(displacement: torch.Tensor) -> torch.Tensor:
    """Return the encoder inputs (B, 3, h, w) of displacements (B, h, w), mm: these, and their differences.

    The differences between pixels are those along columns and rows, in tenths of a millimetre.
    """
    return torch.stack([displacement, *(10 * of for of in torch.gradient(displacement, dim=(2, 1)))], 1)


def mirrored(inputs: torch.Tensor, across: bool, down: bool) -> torch.Tensor:
    """Mirror `gel_inputs` (B, 3, h, w) left to right, upside down, or both; slopes change their sign."""
    signs = inputs.new_tensor([1, -1 if across else 1, -1 if down else 1])
    return inputs.flip([axis for axis, chosen in ((2, down), (3, across)) if chosen]) * signs[:, None, None]


def mirror_each(inputs: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Mirror each of `gel_inputs` (B, 3, h, w) at random in one of the four ways."""
    chosen = torch.from_numpy(rng.integers(2, size=(2, len(inputs), 1, 1, 1)).astype(bool)).to(inputs.device)
    for axis, some in zip((3, 2), chosen):
        inputs = torch.where(some, mirrored(inputs, axis == 3, axis == 2), inputs)
    return inputs


class Mirrored(nn.Module):
    """An encoder of `gel_inputs`; but in training, its features are means over the four mirror images."""

    def __init__(self, encoder: nn.Module):
        super().__init__()
        self.encoder = encoder
        self.features = cast(int, encoder.features)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(B, 3, h, w) -> (B, features)."""
        if self.training:
            return cast(torch.Tensor, self.encoder(inputs))
        ways = [(across, down) for across in (False, True) for down in (False, True)]
        return torch.stack([self.encoder(mirrored(inputs, *way)) for way in ways]).mean(0)
