"""From linear radiance with coverage to the image that is shown and scored."""

from functools import reduce

import numpy as np
import torch

COVERED = 0.999  #: alpha of a pixel that the object fills
CHUNK = 2**20  # pixels that are encoded at once
LIT = 0.01  #: radiance of a lit pixel, relative to white


def linear_to_srgb(x: torch.Tensor) -> torch.Tensor:
    """Gamma of IEC 61966-2-1; values are expected in [0, 1]."""
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=1e-6) ** (1 / 2.4) - 0.055)


def srgb_slope(x: torch.Tensor) -> torch.Tensor:
    """Derivative of `linear_to_srgb`."""
    return torch.where(x <= 0.0031308, 12.92, 1.055 / 2.4 * x.clamp(min=0.0031308) ** (1 / 2.4 - 1))


def srgb_to_linear(x: torch.Tensor) -> torch.Tensor:
    """Inverse of `linear_to_srgb`."""
    return torch.where(x <= 0.04045, x / 12.92, ((x.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)


def on_white(rgba: torch.Tensor) -> torch.Tensor:
    """Composite premultiplied linear RGBA (..., 4) on white and encode; (..., 3) in [0, 1]."""
    pixels = rgba.reshape(-1, 4)
    white = linear_to_srgb(torch.ones(1, dtype=rgba.dtype, device=rgba.device))
    shown = white.repeat(len(pixels), 3)
    # Most of a picture is bare, and a large one is encoded in parts, for the sake of memory.
    for part, into in zip(pixels.split(CHUNK), shown.split(CHUNK)):
        drawn = reduce(torch.logical_or, (part != 0).unbind(1)).nonzero()[:, 0]
        color = part.index_select(0, drawn)
        into.index_copy_(0, drawn, linear_to_srgb((color[:, :3] + (1 - color[:, 3:])).clamp(0, 1)))
    return shown.view(*rgba.shape[:-1], 3)


def lit_foreground(rgba: np.ndarray) -> np.ndarray:
    """Which pixels (...) of linear premultiplied RGBA (..., 4) the object fills with more than black."""
    return (rgba[..., 3] >= COVERED) & (rgba[..., :3].max(-1) > LIT)


def shown_error(radiance: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Error of a linear radiance as it is shown, against an sRGB target; same shapes.

    A small linear term lets samples learn that are beyond black or white.
    """
    clipped = radiance.clamp(0, 1)
    return linear_to_srgb(clipped) - target + 0.1 * (radiance - clipped)
