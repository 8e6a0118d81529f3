"""Images as NumPy arrays or torch tensors in one code, and Gaussian filters of them.

NumPy is faster on small images, torch runs on GPUs.
"""

import math
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
import torch

Array = Any  #: NumPy array or torch tensor


def array_library(of: Array) -> ModuleType:
    """Return the module that works on an array: torch or numpy."""
    return torch if isinstance(of, torch.Tensor) else np


def zeros(shape: tuple[int, ...], like: Array) -> Array:
    """Return zeros of the library, the type and the device of an array."""
    return array_library(like).zeros(shape, dtype=like.dtype, device=like.device)


def blur(images: Array, sigma: float) -> Array:
    """Return the Gaussian blur of (N, C, H, W) float images; ``sigma`` in pixels, 0 for none.

    The kernel is cut off at two deviations (rounded up), and images are mirrored at the border. Computed as a
    sum of shifted images, so that an image's bits do not depend on the batch.
    """
    if sigma == 0:
        return images
    weights = gaussian_weights(sigma)
    radius = len(weights) - 1
    count, channels, height, width = images.shape
    padded = zeros((count, channels, height + 2 * radius, width + 2 * radius), images)
    padded[..., radius:-radius, radius:-radius] = images
    flip = array_library(images).flip
    for axis in (-1, -2):
        for side, inner in ((0, radius + 1), (-radius, -2 * radius - 1)):
            margin = _cut(padded, axis, side, radius)
            margin[:] = flip(_cut(padded, axis, inner, radius), (axis,))
    return convolve(padded, weights)


def convolve(images: Array, weights: list[float]) -> Array:
    """Filter (..., H, W) images along both axes with a symmetric kernel.

    ``weights`` are the kernel's centre and right half. Pixels nearer to the border than the kernel's radius
    are cut off.
    """
    for axis in (-1, -2):
        images = _convolve_axis(images, weights, axis)
    return images


def neighbours(images: Array, axis: int) -> tuple[Array, Array]:
    """Return views without the last and without the first row (axis -2) or column (axis -1)."""
    return _cut(images, axis, 0, -1), _cut(images, axis, 1, -1)


@lru_cache(maxsize=64)
def gaussian_weights(sigma: float) -> list[float]:
    """Return centre and right half of a normalised discrete Gaussian; deviation 0 is a point."""
    if sigma == 0:
        return [1.0]
    weights = np.exp(-(np.arange(math.ceil(2 * sigma) + 1) ** 2) / (2 * sigma**2))
    return (weights / (2 * weights.sum() - 1)).tolist()


def _convolve_axis(images: Array, weights: list[float], axis: int) -> Array:
    radius = len(weights) - 1
    size = images.shape[axis] - 2 * radius
    total = _cut(images, axis, radius, size) * weights[0]
    for shift in range(1, radius + 1):
        pair = _cut(images, axis, radius - shift, size) + _cut(images, axis, radius + shift, size)
        pair *= weights[shift]
        total += pair
    return total


def _cut(images: Array, axis: int, start: int, size: int) -> Array:
    """View of part of an image axis (-1 or -2); a negative size counts what to leave out."""
    start %= images.shape[axis]
    stop = start + (size if size >= 0 else images.shape[axis] + size)
    return images[..., start:stop] if axis == -1 else images[..., start:stop, :]
