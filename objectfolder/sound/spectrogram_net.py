"""AudioNet ``spectrogram``: the paper's three branches (supplementary E), one per force axis.

Each maps a point and a time-frequency bin to the bin's complex value. The net memorises 257 x 201 numbers per
point and axis, where kind ``gains`` needs M; it serves as a baseline.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.nets.positional import PointwiseNetwork
from objectfolder.nets.storage import OCTAVES, PAPERS, UNFILLED, NetKind, fill, halve_weights
from objectfolder.sound.spectrogram import SHAPE, phases


class SpectrogramNet(nn.Module):
    """Net from surface points to spectrograms of unit impulses along x, y and z; silent until trained.

    The damped frequencies (M,), rad/s, are for information. ``value_range``, (2,) or (3, 2): values
    represented by outputs 0 and 1, m kg^1/2 per N s, of all axes or of each. Given a frequency for each bin,
    ``turn``, (257,) Hz, outputs are spectrograms over its `phases`. For the sizes see `PointwiseNetwork`; the
    paper's branches have eight layers of 256 channels.
    """

    damped_frequency: torch.Tensor
    range: torch.Tensor
    turn: torch.Tensor | None

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        value_range: torch.Tensor,
        width: int,
        depth: int,
        point_octaves: int,
        bin_octaves: int,
        turn: torch.Tensor | None = None,
    ):
        super().__init__()
        self.config = {"width": width, "depth": depth}
        self.config |= {"point_octaves": point_octaves, "bin_octaves": bin_octaves}
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("range", value_range.double())
        self.register_buffer("turn", turn if turn is None else turn.double())
        branches = [PointwiseNetwork(width, depth, point_octaves, bin_octaves, outputs=2) for _ in range(3)]
        for branch, low, span in zip(branches, *self._scaling()):
            nn.init.zeros_(branch.output.weight)
            nn.init.constant_(branch.output.bias, -float(low) / float(span))
        self.branches = nn.ModuleList(branches)

    @property
    def kind(self) -> str:
        """Kind in Object Files."""
        return "spectrogram" if self.turn is None else "turned_spectrogram"

    def forward(self, points: torch.Tensor, bins: torch.Tensor) -> torch.Tensor:
        """Evaluate at (N, 3) points of the unit frame and (N,) flat bins; (N, 3 axes, 2)."""
        x = torch.cat([2 * points, _coordinates(points.device)[bins]], 1)
        return torch.stack([branch(x) for branch in self.branches], 1)

    def _scaling(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the value of output 0, and the difference to that of output 1; (3,) float64 each."""
        low, high = self.range.expand(3, 2).unbind(1)
        return low, high - low

    def scaled(self, values: torch.Tensor) -> torch.Tensor:
        """Map spectrograms (N, 3 axes, 2), over `phases` if the net has them, to outputs."""
        low, span = self._scaling()
        return ((values - low[:, None]) / span[:, None]).to(values.dtype)

    @torch.no_grad()
    def spectrograms(self, points: torch.Tensor) -> torch.Tensor:
        """Evaluate complex spectrograms, m kg^1/2 per N s, at (N, 3) points of the unit frame.

        Returns (N, 3, 257, 201).
        """
        device = self.range.device
        bins = torch.arange(math.prod(SHAPE), device=device)
        low, span = (x.float()[:, None] for x in self._scaling())
        out = torch.empty(len(points), 3, *SHAPE, dtype=torch.complex64, device=device)
        for image, point in zip(out, points.to(device, torch.float32)):
            values = self(point.expand(len(bins), 3), bins) * span + low
            image[:] = torch.view_as_complex(values.transpose(0, 1).contiguous()).view(3, *SHAPE)
        return out if self.turn is None else out * phases(self.turn)

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors, with weights but not biases as float16 (biases set silence), and configuration."""
        return halve_weights(self), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SpectrogramNet":
        """Invert `to_tensors`."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        with UNFILLED:
            net = cls(state["damped_frequency"], state["range"], **config, turn=state.get("turn"))
        return fill(net, state)


def _coordinates(device: torch.device) -> torch.Tensor:
    """Return the frequency and time of every bin, each from -1 to 1; (bins, 2)."""
    axes = [torch.linspace(-1, 1, size, dtype=torch.float32, device=device) for size in SHAPE]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).flatten(0, 1)


_FIELDS = PAPERS | {"bin_octaves": OCTAVES}
KINDS = {
    "spectrogram": NetKind(SpectrogramNet, "spectrograms", _FIELDS),
    "turned_spectrogram": NetKind(SpectrogramNet, "spectrograms", _FIELDS),
}
