"""sRGB transfer function (IEC 61966-2-1) on numpy arrays of colours in [0, 1]."""

import numpy as np


def decode(x: np.ndarray) -> np.ndarray:
    """Convert sRGB to linear."""
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def encode(x: np.ndarray) -> np.ndarray:
    """Convert linear to sRGB."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0) ** (1 / 2.4) - 0.055)
