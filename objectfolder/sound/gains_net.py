"""AudioNet ``gains``: stored frequencies and dampings, and a small net from position to mode shapes.

The spectrogram that the paper's net memorises is linear in the modal gains, so the gains suffice: M numbers
per force axis instead of 257 x 201.

The position and features of a grid near the surface pass through two sine layers; mode shapes are linear in
the second. The large matrices are stored as int8.
"""

import math
import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets.siren import Siren
from objectfolder.nets.spline import SplineGrid
from objectfolder.nets.storage import UNFILLED, NetKind, fill, from_codes, to_codes, whole

# Not the first sine layer: it is small, and its weights for position and features differ in magnitude.
INT8 = ("grid.table", "sines.layers.1.weight", "output.weight")
BLOCK = 32  # points evaluated at once; fixed, so that a row's bits do not depend on its batch


@dataclass(frozen=True)
class GainsShape:
    """Size of a `GainsNet`; fields as in `GainsConfig`."""

    resolution: int
    channels: int
    width: int
    features: int
    frequency: float


class GainsNet(nn.Module):
    """Net from surface points to mode shapes.

    Of M modes it takes damped frequency (rad/s), damping (1/s) and amplitude: the root mean square of each
    mode shape, kg^-1/2; the net predicts shapes relative to it. ``used`` marks nodes of the grid, see
    `SplineGrid`.
    """

    damped_frequency: torch.Tensor
    damping: torch.Tensor
    amplitude: torch.Tensor

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        damping: torch.Tensor,
        amplitude: torch.Tensor,
        used: torch.Tensor,
        shape: GainsShape,
    ):
        super().__init__()
        self.config = asdict(shape)
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("damping", damping.double())
        self.register_buffer("amplitude", amplitude.float())
        self.grid = SplineGrid(shape.resolution, shape.channels, used)
        self.sines = Siren(3 + shape.channels, [shape.width, shape.features], shape.frequency)
        first = self.sines.weights[0].detach()
        if not first.is_meta:
            # Position weights are large from the start; grid features start small and grow in training.
            first[:, :3].uniform_(-1 / 3, 1 / 3)
            first[:, 3:].normal_(0, 1 / (shape.frequency * math.sqrt(first.shape[1])))
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Initializing zero-element tensors")  # an object without modes
            self.output = nn.Linear(shape.features, 3 * len(damping))

    def features(self, points: torch.Tensor, looked_up: torch.Tensor) -> torch.Tensor:
        """Evaluate the second layer at (N, 3) points of the unit frame, given the grid's features there."""
        return self.sines(torch.cat([2 * points, looked_up], 1))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate mode shapes, divided by amplitude, at (N, 3) points of the unit frame; (N, 3, M)."""
        features = self.features(points, self.grid.lookup(*self.grid.nodes(points)))
        return self.output(features).view(len(points), 3, len(self.damping))

    @torch.no_grad()
    def shapes(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate mode shapes, kg^-1/2, at (N, 3) points of the unit frame; (N, 3, M), on the device."""
        out = []
        for block in points.to(self.amplitude.device, torch.float32).split(BLOCK):
            padded = block.new_zeros(BLOCK, 3)
            padded[: len(block)] = block
            out.append(self(padded)[: len(block)])
        empty = self.amplitude.new_zeros(0, 3, len(self.damping))
        return (torch.cat(out) if out else empty) * self.amplitude

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        tensors = {}
        for name, value in self.state_dict().items():
            if name in INT8:
                tensors[name], tensors[f"{name}_exponent"] = to_codes(value)
            elif value.dtype == torch.bool:
                tensors[name] = np.packbits(value.numpy())
            else:
                tensors[name] = value.numpy()
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "GainsNet":
        """Invert `to_tensors`; LookupError, RuntimeError, TypeError or ValueError if anything is invalid."""
        nodes = (config["resolution"] + 2) ** 3
        used = torch.from_numpy(np.unpackbits(tensors["grid.used"], count=nodes).astype(bool))
        state = {}
        for name, value in tensors.items():
            if name.endswith("_exponent"):
                continue
            if value.dtype == np.int8:
                state[name] = from_codes(np.array(value), np.array(tensors[f"{name}_exponent"]))
            else:
                state[name] = torch.from_numpy(np.array(value))
        state["grid.used"] = used
        modes = [state[name] for name in ("damped_frequency", "damping", "amplitude")]
        if any(of_modes.shape != (modes[0].numel(),) for of_modes in modes):
            raise ValueError(f"modes of shapes {', '.join(str(tuple(x.shape)) for x in modes)}")
        if (modes[0] <= 0).any() or (modes[1] < 0).any():
            raise ValueError("modes have frequencies that are not positive, or negative damping")
        with UNFILLED:
            net = cls(modes[0], modes[1], modes[2], used, GainsShape(**config))
        return fill(net, state)


def energy_weights(damped_frequency: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Compute each mode's displacement energy per squared shape value, 1 / (4 c (w^2 + c^2)); (M,).

    The integral of (exp(-c t) sin(w t) / w)^2 over all times t > 0.
    """
    return 1 / (4 * damping * (damped_frequency**2 + damping**2))


_SINES = {"type": "number", "exclusiveMinimum": 0, "maximum": 10000.0, "description": "of the sines"}
_FIELDS = {
    "resolution": whole(1, 128, "cells of the grid a side"),
    "channels": whole(1, 256),
    "width": whole(1, 4096),
    "features": whole(1, 4096),
    "frequency": _SINES,
}
KINDS = {"gains": NetKind(GainsNet, "modes", _FIELDS)}
