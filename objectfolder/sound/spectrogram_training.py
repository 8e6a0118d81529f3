"""Training of AudioNet ``spectrogram``."""

import math

import numpy as np
import torch

from objectfolder.nets.fit import CurvePoint, Session, choose_part_size, fit_papers_net, sum_in_parts
from objectfolder.sound.gains_training import ModeSamples
from objectfolder.sound.net_settings import AudioConfig, SpectrogramConfig
from objectfolder.sound.spectrogram import phases, spectrogram
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.sound.synthesis import sinusoid_bank

RANGE_POINTS = 256  # training points that define the range of values
VAL_SAMPLES = 1 << 14
_PART = 1 << 12  # bins whose activations are kept for a gradient


def train(
    samples: ModeSamples, settings: AudioConfig, session: Session
) -> tuple[SpectrogramNet, list[CurvePoint]]:
    """Train a net of this kind, as the stage asks."""
    return train_spectrogram(samples, settings.spectrogram, session)


def train_spectrogram(
    samples: ModeSamples, config: SpectrogramConfig, session: Session
) -> tuple[SpectrogramNet, list[CurvePoint]]:
    """Fit a `SpectrogramNet` to mode shapes at surface points.

    Losses of the curve are squared errors relative to silence, of the target ``paper`` those in its range.

    The loss is the paper's mean squared error over all bins; the target ``paper`` is scaled to [0, 1] for
    each axis. Most bins are nearly silent, so a share of a batch (``loud``; none in the paper) may be
    importance-sampled by loudness and weighted by inverse probability: the same mean with less noise.

    In [0, 1], a sound is a few thousandths of the range, less than one step of Adam moves the output, and its
    phases turn from frame to frame and bin to bin, so that first gradients are noise: the net learns silence.
    Of the target ``turned``, the root mean square is 1 for each axis, and the phases of each bin's loudest
    mode are taken out.
    """
    device, generator = session.device, session.generator
    damped_frequency, damping = samples.damped_frequency, samples.damping
    turned = config.target == "turned"
    spectra = spectrogram(sinusoid_bank(torch.from_numpy(damped_frequency), torch.from_numpy(damping)))
    shape = torch.from_numpy(np.asarray(samples.shapes, np.float32))
    rows = torch.from_numpy(samples.train)
    gram = torch.einsum("nam,nak->amk", shape[rows], shape[rows]) / len(rows)
    turn = None
    if turned and len(damped_frequency):
        loudness = spectra.abs().square().sum(2) * gram.diagonal(dim1=1, dim2=2).sum(0)[:, None]
        turn = torch.from_numpy(damped_frequency)[loudness.argmax(0)] / (2 * math.pi)
        spectra = spectra / phases(turn)
    spectra = torch.view_as_real(spectra).flatten(1, 2)  # (M, bins, 2)
    # With the products of different modes: those of nearly equal frequency share their bins.
    powers = torch.stack(
        [((of_axis @ spectra.flatten(1)).view_as(spectra) * spectra).sum(0) for of_axis in gram]
    )
    powers = powers.mean(2).clamp(min=0)  # (3, bins) of silence
    low, high = torch.zeros(3), powers.mean(1).sqrt()
    if not turned:
        low, high = _extremes(
            shape[rows[torch.randperm(len(rows), generator=generator)[:RANGE_POINTS]]], spectra
        )
    mute = high == low  # no mode below the Nyquist frequency moves along the axis
    with session.initialisation():
        net = SpectrogramNet(
            *(torch.from_numpy(damped_frequency), torch.stack([low, high + mute], 1)),
            *(config.width, config.depth, config.point_octaves, config.bin_octaves),
            turn,
        )
    if mute.all():
        return net.eval(), []
    power = (powers / (high + mute - low)[:, None] ** 2).mean(0)
    loudness = power.sqrt()
    chance = ((1 - config.loud) / len(power) + config.loud * loudness / loudness.sum()).double()
    weight = (1 / (len(power) * chance)).float() / (power.mean() if turned else 1)
    x = torch.from_numpy(np.asarray(samples.points, np.float32))
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
    held_out = draw(torch.from_numpy(samples.val), VAL_SAMPLES)
    part = choose_part_size(_PART, config.batch, device)

    def batch_loss() -> torch.Tensor:
        return sum_in_parts(loss, part, *draw(rows, config.batch))

    return net, fit_papers_net(net, batch_loss, lambda: loss(*held_out).item(), config, session)


def _extremes(gains: torch.Tensor, spectra: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the least and the largest value along each axis, (3,) each, at most and at least 0."""
    low, high = torch.zeros(2, 3)
    for some in gains.split(8):
        values = some.transpose(0, 1) @ spectra.flatten(1)
        low, high = torch.minimum(low, values.amin((1, 2))), torch.maximum(high, values.amax((1, 2)))
    return low, high
