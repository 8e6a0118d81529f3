"""Training of AudioNet ``spectrogram``."""

from collections.abc import Callable

import numpy as np
import torch

from objectfolder.audio.spectrogram import spectrogram
from objectfolder.audio.synthesis import sinusoid_bank
from objectfolder.nets.adam import papers_adam
from objectfolder.nets.audio_config import SpectrogramConfig
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.checkpoint import Checkpoint
from objectfolder.nets.fit import CurvePoint, fit, in_parts, part_size
from objectfolder.nets.positional import train_in

RANGE_POINTS = 256  # training points that define the range of values
VAL_SAMPLES = 1 << 14
_PART = 1 << 12  # bins whose activations are kept for a gradient


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
    checkpoint: Checkpoint | None = None,
) -> tuple[SpectrogramNet, list[CurvePoint]]:
    """Fit a `SpectrogramNet` to mode shapes at surface points; other parameters as in `train_gains`.

    Parameters
    ----------
    device : str or torch.device
        Training device; the net is returned on the CPU. The paper's size needs a GPU.
    report : callable
        Called with each `CurvePoint`; its losses are squared errors relative to silence.
    checkpoint : Checkpoint, optional
        With the same generator.

    Notes
    -----
    The loss is the paper's mean squared error over all bins, of spectrograms that are scaled to [0, 1] for
    each axis. Most bins are nearly silent, so a share of a batch (``loud``; none in the paper) may be
    importance-sampled by loudness and weighted by inverse probability: the same mean with less noise.
    """
    bank = sinusoid_bank(torch.from_numpy(damped_frequency), torch.from_numpy(damping))
    spectra = torch.view_as_real(spectrogram(bank)).flatten(1, 2)  # (M, bins, 2)
    shape = torch.from_numpy(np.asarray(shapes, np.float32))
    rows = torch.from_numpy(train)
    some = rows[torch.randperm(len(rows), generator=generator)[:RANGE_POINTS]]
    low, high = torch.zeros(2, 3)
    for gains in shape[some].split(8):
        values = gains.transpose(0, 1) @ spectra.flatten(1)
        low, high = torch.minimum(low, values.amin((1, 2))), torch.maximum(high, values.amax((1, 2)))
    mute = high == low  # no mode below the Nyquist frequency moves along the axis
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        net = SpectrogramNet(
            torch.from_numpy(damped_frequency),
            torch.stack([low, high + mute], 1),
            config.width,
            config.depth,
            config.point_octaves,
            config.bin_octaves,
        )
    if mute.all():
        return net.eval(), []
    power = torch.einsum("am,mbc->ab", shape[some].square().mean(0), spectra.square()) / 2
    power = (power / (high + mute - low)[:, None] ** 2).mean(0)  # of silence, scaled
    loudness = power.sqrt()
    chance = ((1 - config.loud) / len(power) + config.loud * loudness / loudness.sum()).double()
    weight = (1 / (len(power) * chance)).float() / power.mean()
    x = torch.from_numpy(np.asarray(points, np.float32))
    net = net.to(device)
    train_in(net, config.precision)
    x, shape, spectra, weight = (tensor.to(device) for tensor in (x, shape, spectra, weight))

    def draw(choice: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        drawn = choice[torch.randint(len(choice), (count,), generator=generator)]
        # Inverse transform sampling: `multinomial` is slow and limited to 2^24 categories.
        place = torch.rand(count, generator=generator, dtype=torch.float64)
        bins = torch.searchsorted(cumulative, place * cumulative[-1]).clamp(max=len(chance) - 1)
        return drawn.to(device), bins.to(device)

    def loss(index: torch.Tensor, bins: torch.Tensor) -> torch.Tensor:
        truth = torch.einsum("nam,mnc->nac", shape[index], spectra[:, bins])
        error = net(x[index], bins) - net.scaled(truth)
        return (error.square().mean((1, 2)) * weight[bins]).mean()

    cumulative = chance.cumsum(0)
    held_out = draw(torch.from_numpy(val), VAL_SAMPLES)
    part = part_size(_PART, config.batch, device)
    curve = fit(
        net,
        batch_loss=lambda: in_parts(loss, part, *draw(rows, config.batch)),
        val_loss=lambda: loss(*held_out).item(),
        steps=config.steps,
        learning_rate=config.learning_rate,
        final_rate=config.final_rate,
        optimizer=papers_adam(net),
        report=report,
        checkpoint=checkpoint,
    )
    return net.cpu().eval(), curve
