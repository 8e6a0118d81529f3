"""Conversion of linear radiance with alpha to the displayed and scored image."""

import numpy as np
import torch

from objectfolder.mesh import srgb

MIN_FOREGROUND_ALPHA = 0.999  #: least alpha of a pixel that the object fills
CHUNK = 2**20  # pixels encoded at once
MIN_LIT_RADIANCE = 0.01  #: least radiance of a lit pixel, relative to white


def on_white(rgba: torch.Tensor) -> torch.Tensor:
    """Composite premultiplied linear RGBA (..., 4) on white and encode; (..., 3) in [0, 1]."""
    pixels = rgba.reshape(-1, 4)
    shown = torch.full((len(pixels), 3), float(srgb.encode(np.ones(1, np.float32))[0]), dtype=rgba.dtype)
    # Encode foreground pixels only, since most are background; a large image in parts, to bound the memory.
    for part, into in zip(pixels.split(CHUNK), shown.split(CHUNK)):
        drawn = (part[:, 3] != 0).nonzero()[:, 0]
        color = part.index_select(0, drawn)
        linear = (color[:, :3] + (1 - color[:, 3:])).clamp_(0, 1)
        # NumPy's powers take half the time of torch's.
        into.index_copy_(0, drawn, torch.from_numpy(srgb.encode(linear.numpy())))
    return shown.view(*rgba.shape[:-1], 3)


def find_lit_foreground(rgba: np.ndarray) -> np.ndarray:
    """Return a mask (...) of the pixels of linear premultiplied RGBA (..., 4) that are covered and lit."""
    return (rgba[..., 3] >= MIN_FOREGROUND_ALPHA) & (rgba[..., :3].max(-1) > MIN_LIT_RADIANCE)


def display_error(radiance: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the displayed error of a linear radiance against an sRGB target of the same shape.

    A small linear term gives a gradient to values outside [0, 1].
    """
    clipped = radiance.clamp(0, 1)
    return srgb.encode(clipped) - target + 0.1 * (radiance - clipped)
