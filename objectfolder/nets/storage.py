"""Storage of nets: int8 with a power-of-two scale per row, float16, and nets filled with stored tensors.

With powers of two, every stored int8 value is a float16, and quantising a second time changes nothing.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn

_Net = TypeVar("_Net", bound=nn.Module)

LARGEST_CODE = 127
#: Nets are made here to be filled (`fill`): a wrong size allocates nothing before it is compared with the
#: tensors.
UNFILLED = torch.device("meta")


@dataclass(frozen=True)
class NetKind:
    """A kind of net in Object Files. A module ``NAME_net.py`` of a sense names its own in ``KINDS``."""

    net: Any  #: its class, which has ``from_tensors``
    answers: str  #: what it is asked for: a key of ``SENSES`` beside it
    fields: dict[str, Any]  #: JSON Schema of each field of ``net`` in the header; all are required
    slow: bool = False  #: whether answers take minutes on a CPU

    @property
    def schema(self) -> dict[str, Any]:
        """JSON Schema of a part with such a net."""
        net = {"type": "object", "required": sorted(self.fields), "properties": self.fields}
        return {"required": ["net"], "properties": {"net": net}}


def whole(low: int, high: int, description: str = "") -> dict[str, Any]:
    """Return the JSON Schema of a whole number in a header: its limits bound what a reader allocates."""
    return {"type": "integer", "minimum": low, "maximum": high} | _described(description)


def real(low: float, high: float, description: str = "") -> dict[str, Any]:
    """Return the JSON Schema of a number in a header."""
    return {"type": "number", "minimum": low, "maximum": high} | _described(description)


def _described(description: str) -> dict[str, str]:
    return {"description": description} if description else {}


OCTAVES = whole(0, 24, "of the positional encoding")
#: Fields of the paper's nets.
PAPERS = {"width": whole(1, 1024), "depth": whole(1, 32), "point_octaves": OCTAVES}


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
