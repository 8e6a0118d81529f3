"""Storage of nets: int8 with a power-of-two scale per row, float16, and nets filled with stored tensors.

With powers of two, every stored int8 value is a float16, and quantising a second time changes nothing.
"""

from typing import TypeVar

import numpy as np
import torch
from torch import nn

_Net = TypeVar("_Net", bound=nn.Module)

LARGEST_CODE = 127
#: Nets are made here to be filled (`fill`): a wrong size allocates nothing before it is compared with the
#: tensors.
UNFILLED = torch.device("meta")


def fill(net: _Net, state: dict[str, torch.Tensor]) -> _Net:
    """Give a net made on device `UNFILLED` its state dictionary, and return it for evaluation.

    Parameters become single precision on the CPU, whatever the default type and device of torch are. Buffers
    have explicit types; those outside the state dictionary are on the CPU. Raises RuntimeError if the tensors
    are not those of the net, or of other shapes.
    """
    types = {name: buffer.dtype for name, buffer in net.named_buffers()}
    typed = {name: value.to(types.get(name, torch.float32)) for name, value in state.items()}
    net.load_state_dict(typed, assign=True)
    return net.eval()


def halve_weights(net: nn.Module) -> dict[str, np.ndarray]:
    """Return a net's tensors for storing: weights as float16, others unchanged."""
    return {
        name: (value.half() if name.endswith("weight") else value).cpu().numpy()
        for name, value in net.state_dict().items()
    }


def find_exponents(matrix: torch.Tensor) -> torch.Tensor:
    """Compute the exponents of the smallest power-of-two scales that fit the rows in int8; (R,) int8."""
    largest = matrix.abs().amax(1) if matrix.shape[1] else torch.zeros(len(matrix))
    return torch.ceil(torch.log2(largest.clamp(min=1e-30) / LARGEST_CODE)).to(torch.int8)


def to_codes(matrix: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Quantise a matrix to codes (R, C) and row exponents (R,), both int8."""
    exponent = find_exponents(matrix)
    return torch.round(torch.ldexp(matrix, -exponent[:, None].int())).to(torch.int8).numpy(), exponent.numpy()


def from_codes(codes: np.ndarray, exponent: np.ndarray) -> torch.Tensor:
    """Return the (R, C) float32 matrix of codes and exponents; see `to_codes`."""
    return torch.ldexp(torch.from_numpy(codes).float(), torch.from_numpy(exponent)[:, None].int())


def round_to_codes(matrix: torch.Tensor) -> torch.Tensor:
    """Round a matrix to the nearest that int8 codes represent exactly."""
    return from_codes(*to_codes(matrix))


def round_with(matrix: torch.Tensor, gram: torch.Tensor) -> torch.Tensor:
    """Round a linear layer with little change of its outputs: later weights compensate for earlier errors.

    Frantar et al. 2023 (GPTQ, arXiv:2210.17323). For correlated inputs, such as a net's features, the error
    is several times smaller than with every weight rounded to the nearest. Takes an (outputs, inputs) matrix
    and the positive definite Gram matrix of the inputs over the data; int8 codes represent the result
    exactly.
    """
    size = torch.ldexp(torch.ones(len(matrix)), find_exponents(matrix).int()).double()
    left, out = matrix.double().clone(), torch.empty_like(matrix, dtype=torch.float64)
    factor = torch.linalg.cholesky(torch.linalg.inv(gram.double()), upper=True)
    for i, row in enumerate(factor):
        out[:, i] = (left[:, i] / size).round().clamp(-LARGEST_CODE, LARGEST_CODE) * size
        left[:, i + 1 :] -= torch.outer((left[:, i] - out[:, i]) / row[i], row[i + 1 :])
    return out.float()
