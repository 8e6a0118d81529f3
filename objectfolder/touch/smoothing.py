"""Gaussian smoothing of one image."""

from functools import cache

import torch


@cache
def gaussian_matrix(size: int, sigma: float) -> torch.Tensor:
    """Gaussian smoothing of ``size`` samples as a (size, size) float32 matrix.

    Each row sums to one, so a constant stays the same up to the border.

    Parameters
    ----------
    size : int
    sigma : float
        Standard deviation in samples, positive.
    """
    x = torch.arange(size, dtype=torch.float64)
    weights = torch.exp(-((x[:, None] - x) ** 2) / (2 * sigma**2))
    return (weights / weights.sum(dim=1, keepdim=True)).float()


def smooth(image: torch.Tensor, sigma: float) -> torch.Tensor:
    """Smooth an (H, W) float32 image; ``sigma`` in pixels, 0 for none.

    Two small matrix products: at this size faster than a convolution. One image a call, since the kernels
    that batched products choose depend on the size of the batch.
    """
    if sigma == 0:
        return image
    height, width = image.shape
    return gaussian_matrix(height, sigma) @ image @ gaussian_matrix(width, sigma).T
