"""Parts shared by the nets of released ObjectFolder files: the network, its storage and its frame.

Weights stay 32-bit, to reproduce the original's answers.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets.positional import SKIP, SkipNetwork, append_octaves
from objectfolder.nets.storage import UNFILLED, fill


class ReleasedNetwork(SkipNetwork):
    """ReLU network with encoded inputs: each x with sin and cos of 2^k x, for k below ``octaves``."""

    def __init__(self, inputs: int, width: int, depth: int, octaves: int, outputs: int):
        super().__init__(inputs * (1 + 2 * octaves), width, depth)
        self.octaves = octaves
        self.output = nn.Linear(width, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Evaluate the network; (N, inputs) to (N, outputs)."""
        return self.output(super().forward(append_octaves(x, self.octaves, 1.0)))


def build_network(tensors: dict[str, torch.Tensor], inputs: int, prefix: str = "") -> ReleasedNetwork:
    """Build the network described by the tensors of a state dictionary; their shapes define its size.

    Raises ValueError, KeyError or RuntimeError if the tensors describe no such network.
    """
    state = {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}
    width, channels = state["hidden.0.weight"].shape
    octaves, rest = divmod(channels // inputs - 1, 2)
    if rest or channels % inputs or octaves < 0:
        raise ValueError(f"{channels} channels of {inputs} inputs")
    shape = inputs, width, _depth(state), octaves, len(state["output.weight"])
    with UNFILLED:
        net = ReleasedNetwork(*shape)
    return fill(net, state).requires_grad_(False)


def float_tensors(tensors: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    """Convert stored arrays to float32 tensors."""
    return {name: torch.from_numpy(np.array(value, np.float32)) for name, value in tensors.items()}


def stored_tensors(net: nn.Module, prefix: str = "") -> dict[str, np.ndarray]:
    """Return a net's tensors for storing."""
    return {prefix + name: value.cpu().numpy() for name, value in net.state_dict().items()}


def _depth(state: dict[str, torch.Tensor]) -> int:
    depth = sum(name.startswith("hidden.") and name.endswith(".weight") for name in state)
    if depth > 4 * SKIP:
        raise ValueError(f"{depth} layers, expected at most {4 * SKIP}")
    return depth


@dataclass(frozen=True)
class Frame:
    """Map from the unit frame to the coordinates of a released file: origin + unit * point."""

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    def released(self, points: Any) -> np.ndarray:
        """Map (N, 3) points of the unit frame to coordinates of the released file, float64."""
        return np.asarray(self.origin) + self.unit * np.asarray(points, np.float64)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-compatible dictionary for `from_dict`."""
        return {"origin": list(self.origin), "unit": self.unit}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Frame":
        """Invert `to_dict`."""
        x, y, z = map(float, values["origin"])
        unit = float(values["unit"])
        if not (all(map(math.isfinite, (x, y, z))) and 0 < unit < math.inf):
            raise ValueError(f"frame {values}")
        return cls((x, y, z), unit)
