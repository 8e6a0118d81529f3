"""AudioNet ``spectrogram``: the paper's three branches (supplementary E), one per force axis, each from a
point and a time-frequency bin to the bin's complex value.

It memorises 257 x 201 numbers per point and axis where the gains are M; it is here to compare with.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.audio.spectrogram import SHAPE, spectrogram
from objectfolder.audio.synthesis import sinusoid_bank
from objectfolder.nets.audio_config import SpectrogramConfig
from objectfolder.nets.fit import CurvePoint, fit
from objectfolder.nets.positional import PointwiseNetwork, with_half_weights

RANGE_POINTS = 256  # training points whose extremes span the range of values
VAL_SAMPLES = 1 << 14


class SpectrogramNet(nn.Module):
    """Spectrograms of unit impulses along x, y and z at points of the surface; silent until trained.

    Parameters
    ----------
    damped_frequency : (M,) tensor, rad/s
        Of the modes that it has learnt; for information.
    low, high : float
        Values that the outputs 0 and 1 stand for, m kg^1/2 per N s.
    width, depth, point_octaves, bin_octaves
        See `PointwiseNetwork`; the paper's branches have eight layers of 256 channels.
    """

    damped_frequency: torch.Tensor
    range: torch.Tensor

    def __init__(
        self,
        damped_frequency: torch.Tensor,
        low: float,
        high: float,
        width: int,
        depth: int,
        point_octaves: int,
        bin_octaves: int,
    ):
        super().__init__()
        self.config = {
            "width": width,
            "depth": depth,
            "point_octaves": point_octaves,
            "bin_octaves": bin_octaves,
        }
        self.register_buffer("damped_frequency", damped_frequency.double())
        self.register_buffer("range", torch.tensor([low, high], dtype=torch.float64))
        branches = [PointwiseNetwork(width, depth, point_octaves, bin_octaves, outputs=2) for _ in range(3)]
        for branch in branches:
            nn.init.zeros_(branch.output.weight)
            nn.init.constant_(branch.output.bias, -low / (high - low))
        self.branches = nn.ModuleList(branches)

    def forward(self, points: torch.Tensor, bins: torch.Tensor) -> torch.Tensor:
        """Values in [0, 1] at (N, 3) points of the unit frame and (N,) flat bins; (N, 3 axes, 2)."""
        x = torch.cat([2 * points, _coordinates(points.device)[bins]], 1)
        return torch.stack([branch(x) for branch in self.branches], 1)

    @torch.no_grad()
    def spectrograms(self, points: torch.Tensor) -> torch.Tensor:
        """Complex spectrograms at (N, 3) points of the unit frame, m kg^1/2 per N s; (N, 3, 257, 201)."""
        device = self.range.device
        bins = torch.arange(math.prod(SHAPE), device=device)
        low, high = self.range.tolist()
        out = torch.empty(len(points), 3, *SHAPE, dtype=torch.complex64, device=device)
        for image, point in zip(out, points.to(device, torch.float32)):
            values = self(point.expand(len(bins), 3), bins) * (high - low) + low
            image[:] = torch.view_as_complex(values.transpose(0, 1).contiguous()).view(3, *SHAPE)
        return out

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors (weights as float16; the biases hold the level of silence) and configuration."""
        return with_half_weights(self), dict(self.config)

    @classmethod
    def from_tensors(cls, tensors: dict[str, np.ndarray], config: dict[str, Any]) -> "SpectrogramNet":
        """Inverse of `to_tensors`."""
        state = {name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}
        net = cls(state["damped_frequency"], *state["range"].tolist(), **config)
        net.load_state_dict(state)
        return net.eval()


def _coordinates(device: torch.device) -> torch.Tensor:
    """Frequency and time of every bin in [-1, 1]; (bins, 2)."""
    axes = [torch.linspace(-1, 1, size, device=device) for size in SHAPE]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).flatten(0, 1)


def train_spectrogram(
    points: np.ndarray,
    shapes: np.ndarray,
    damped_frequency: np.ndarray,
    damping: np.ndarray,
    train: np.ndarray,
    val: np.ndarray,
    config: SpectrogramConfig,
    generator: torch.Generator,
    report: Callable[[CurvePoint], None] = lambda point: None,
    device: str | torch.device = "cpu",
) -> tuple[SpectrogramNet, list[CurvePoint]]:
    """Fit a `SpectrogramNet` to mode shapes at surface points; the parameters are those of `train_gains`.

    Parameters
    ----------
    device : str or torch.device
        Where to train; the net comes back on the CPU. The size of the paper takes a GPU.
    report : callable
        Called with each `CurvePoint`; its losses are squared errors relative to those of silence.

    Notes
    -----
    The loss is the mean squared error over all bins, as the paper's. Most bins are next to silent, so half
    of a batch is drawn by loudness and weighed by one over its probability: the same mean, less noise.
    """
    bank = sinusoid_bank(torch.from_numpy(damped_frequency), torch.from_numpy(damping))
    spectra = torch.view_as_real(spectrogram(bank)).flatten(1, 2)  # (M, bins, 2)
    shape = torch.from_numpy(np.asarray(shapes, np.float32))
    rows = torch.from_numpy(train)
    some = rows[torch.randperm(len(rows), generator=generator)[:RANGE_POINTS]]
    low, high = 0.0, 0.0
    for gains in shape[some].flatten(0, 1).split(16):
        values = gains @ spectra.flatten(1)
        low, high = min(low, values.min().item()), max(high, values.max().item())
    silent = high == low  # no mode, or none that the sample rate can carry
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = SpectrogramNet(
            torch.from_numpy(damped_frequency),
            low,
            high + silent,
            config.width,
            config.depth,
            config.point_octaves,
            config.bin_octaves,
        )
    if silent:
        return net.eval(), []
    power = torch.einsum("m,mbc->b", shape[some].square().mean((0, 1)), spectra.square()) / 2
    loudness = power.sqrt()
    chance = (0.5 / len(power) + 0.5 * loudness / loudness.sum()).double()
    weight = (1 / (len(power) * chance)).float() / (power.mean() / (high - low) ** 2)
    x = torch.from_numpy(np.asarray(points, np.float32))
    net = net.to(device)
    x, shape, spectra, weight = (tensor.to(device) for tensor in (x, shape, spectra, weight))

    def draw(choice: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        drawn = choice[torch.randint(len(choice), (count,), generator=generator)]
        # `multinomial` is limited to 2^24 categories and slow; this inverts the distribution.
        place = torch.rand(count, generator=generator, dtype=torch.float64)
        bins = torch.searchsorted(cumulative, place * cumulative[-1]).clamp(max=len(chance) - 1)
        return drawn.to(device), bins.to(device)

    def loss(index: torch.Tensor, bins: torch.Tensor) -> torch.Tensor:
        truth = torch.einsum("nam,mnc->nac", shape[index], spectra[:, bins])
        error = net(x[index], bins) - (truth - low) / (high - low)
        return (error.square().mean((1, 2)) * weight[bins]).mean()

    cumulative = chance.cumsum(0)
    held_out = draw(torch.from_numpy(val), VAL_SAMPLES)
    curve = fit(
        net,
        batch_loss=lambda: loss(*draw(rows, config.batch)),
        val_loss=lambda: loss(*held_out).item(),
        steps=config.steps,
        learning_rate=config.learning_rate,
        report=report,
    )
    return net.cpu().eval(), curve
