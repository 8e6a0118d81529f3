"""Quantisation of matrices to int8 with a power-of-two scale per row.

With powers of two, every stored value is a float16, and quantising a second time changes nothing.
"""

import numpy as np
import torch

LARGEST = 127


def exponents(matrix: torch.Tensor) -> torch.Tensor:
    """Compute the exponents of the smallest power-of-two scales that fit the rows in int8; (R,) int8."""
    largest = matrix.abs().amax(1) if matrix.shape[1] else torch.zeros(len(matrix))
    return torch.ceil(torch.log2(largest.clamp(min=1e-30) / LARGEST)).to(torch.int8)


def to_codes(matrix: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Quantise a matrix to codes (R, C) and row exponents (R,), both int8."""
    exponent = exponents(matrix)
    return torch.round(torch.ldexp(matrix, -exponent[:, None].int())).to(torch.int8).numpy(), exponent.numpy()


def from_codes(codes: np.ndarray, exponent: np.ndarray) -> torch.Tensor:
    """Return the (R, C) float32 matrix of codes and exponents; see `to_codes`."""
    return torch.ldexp(torch.from_numpy(codes).float(), torch.from_numpy(exponent)[:, None].int())


def round_to_codes(matrix: torch.Tensor) -> torch.Tensor:
    """Round a matrix to the nearest that int8 codes represent exactly."""
    return from_codes(*to_codes(matrix))


def rounded_with(matrix: torch.Tensor, gram: torch.Tensor) -> torch.Tensor:
    """Round a linear layer with little change of its outputs: later weights compensate for earlier errors.

    Frantar et al. 2023 (GPTQ, arXiv:2210.17323). For correlated inputs, such as a net's features, the error
    is several times smaller than with every weight rounded to the nearest.

    Parameters
    ----------
    matrix : (outputs, inputs) tensor
    gram : (inputs, inputs) tensor
        Gram matrix of the inputs over the data, positive definite.

    Returns
    -------
    (outputs, inputs) tensor, represented exactly by int8 codes
    """
    size = torch.ldexp(torch.ones(len(matrix)), exponents(matrix).int()).double()
    left, out = matrix.double().clone(), torch.empty_like(matrix, dtype=torch.float64)
    factor = torch.linalg.cholesky(torch.linalg.inv(gram.double()), upper=True)
    for i, row in enumerate(factor):
        out[:, i] = (left[:, i] / size).round().clamp(-LARGEST, LARGEST) * size
        left[:, i + 1 :] -= torch.outer((left[:, i] - out[:, i]) / row[i], row[i + 1 :])
    return out.float()
