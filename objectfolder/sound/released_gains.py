"""AudioNet of a released ObjectFolder 2.0 file: frequencies, dampings and a net from a point to gains."""

import math
from typing import Any

import numpy as np
import torch

from objectfolder.nets.released_network import (
    Frame,
    ReleasedNetwork,
    build_network,
    float_tensors,
    stored_tensors,
)
from objectfolder.sound.released_spectrogram import AXES

BLOCK = 16  # points evaluated at once; fixed, so that a row's bits do not depend on its batch


class ReleasedGains:
    """Modes of an object, and their gains for unit forces along x, y and z.

    The original's sound is the sum of gain * exp(-abs(damping) t) * sin(2 pi frequency t). A mode of shape g
    is displaced by g / w exp(-c t) sin(w t), so g = gain * w gives the original's sound as displacement.

    The three branches are nets from a point to normalised gains, one per axis; ``low`` and ``high``, (3, M),
    are the gains that outputs 0 and 1 represent. Frequencies (M,) are in Hz, dampings in 1/s. ``config``
    holds ``frame`` and ``bounds`` (2, 3): the released coordinates that inputs 0 and 1 represent.
    """

    def __init__(
        self,
        branches: list[ReleasedNetwork],
        config: dict[str, Any],
        frequencies: torch.Tensor,
        dampings: torch.Tensor,
        low: torch.Tensor,
        high: torch.Tensor,
    ):
        count = len(frequencies)
        shapes = [tuple(low.shape), tuple(high.shape), *((3, len(b.output.weight)) for b in branches)]
        if dampings.shape != frequencies.shape or any(shape != (3, count) for shape in shapes):
            raise ValueError(f"{count} frequencies, {len(dampings)} dampings, gains of {shapes}")
        self.branches = branches
        self.config = config
        self.frame = Frame.from_dict(config["frame"])
        self._bounds = checked_bounds(config["bounds"])
        self._frequencies, self._dampings, self._low, self._high = frequencies, dampings, low, high
        self.damped_frequency = 2 * math.pi * frequencies.double()  #: (M,) rad/s
        self.damping = dampings.double().abs()  #: (M,) 1/s

    def to(self, device: str | torch.device) -> "ReleasedGains":
        """Move to a device and return self."""
        self.branches = [branch.to(device) for branch in self.branches]
        for name in ("_frequencies", "_dampings", "_low", "_high", "damped_frequency", "damping"):
            setattr(self, name, getattr(self, name).to(device))
        return self

    @torch.no_grad()
    def shapes(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate gain times angular frequency at (N, 3) points of the unit frame; (N, 3, M) float32."""
        low, high = self._bounds
        x = torch.from_numpy((self.frame.released(points.cpu()) - low) / (high - low)).float().to(self._low)
        out = x.new_empty(len(x), 3, len(self.damping))
        for rows, block in zip(out.split(BLOCK), x.split(BLOCK)):
            padded = x.new_zeros(BLOCK, 3)
            padded[: len(block)] = block
            answers = torch.stack([branch(padded) for branch in self.branches], 1)
            rows[:] = (answers * (self._high - self._low) + self._low)[: len(block)]
        return out * self.damped_frequency.float()

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing."""
        names = "frequencies", "dampings", "low", "high"
        tensors = {name: getattr(self, f"_{name}").cpu().numpy() for name in names}
        for axis, branch in zip(AXES, self.branches):
            tensors |= stored_tensors(branch, f"{axis}.")
        return tensors, dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "ReleasedGains":
        """Invert `to_tensors`."""
        state = float_tensors(tensors)
        modes = [state.pop(name) for name in ("frequencies", "dampings", "low", "high")]
        return cls([build_network(state, 3, f"{axis}.") for axis in AXES], dict(config), *modes)


def checked_bounds(bounds: Any) -> np.ndarray:
    """Return the lowest and highest coordinates as a (2, 3) array.

    Raises ValueError if they are not finite, or the lowest are not below the highest.
    """
    array = np.array(bounds, np.float64).reshape(2, 3)
    if not np.isfinite(array).all() or not (array[0] < array[1]).all():
        raise ValueError(f"bounds {array.tolist()}, expected finite ones, the lowest first")
    return array
