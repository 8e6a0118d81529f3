"""Gradients beside central finite differences."""

import torch


def slopes(function, x, step):
    """Gradient of a scalar function at x and its central differences, along each element of x."""
    x = x.detach().double().requires_grad_()
    (gradient,) = torch.autograd.grad(function(x), x)
    differences = torch.zeros_like(x).ravel()
    with torch.no_grad():
        for i, away in enumerate(torch.eye(x.numel(), dtype=x.dtype) * step):
            away = away.view(x.shape)
            differences[i] = (function(x + away) - function(x - away)) / (2 * step)
    return gradient, differences.view(x.shape)


def disagreement(function, x, step):
    """Length of the difference of the two over that of the central differences."""
    gradient, differences = slopes(function, x, step)
    return float((gradient - differences).norm() / differences.norm())
