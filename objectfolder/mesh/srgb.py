"""sRGB transfer function (IEC 61966-2-1) on NumPy arrays or torch tensors of colours in [0, 1]."""

from typing import Any

import numpy as np

Colors = Any  #: NumPy array or torch tensor, of any shape


def decode(x: Colors) -> Colors:
    """Convert sRGB to linear."""
    return _where(x <= 0.04045, x / 12.92, ((x.clip(0.04045) + 0.055) / 1.055) ** 2.4)


def encode(x: Colors) -> Colors:
    """Convert linear to sRGB."""
    # Without the bound, the power's gradient at 0 is infinite.
    return _where(x <= 0.0031308, 12.92 * x, 1.055 * x.clip(1e-6) ** (1 / 2.4) - 0.055)


def encode_slope(x: Colors) -> Colors:
    """Return the derivative of `encode`."""
    return _where(x <= 0.0031308, 12.92, 1.055 / 2.4 * x.clip(0.0031308) ** (1 / 2.4 - 1))


def _where(condition: Colors, low: Colors | float, high: Colors) -> Colors:
    """Select by a condition; does not import torch, which the preparation of meshes has no need of."""
    if isinstance(high, np.ndarray | np.generic):
        return np.where(condition, low, high)
    return high.where(~condition, low)
