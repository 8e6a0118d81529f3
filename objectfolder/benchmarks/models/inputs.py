"""Encoder inputs of each modality, computed from observations, and their augmentation."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.sound.spectrogram import spectrogram

CHANNELS = {"vision": 3, "audio": 1, "touch": 3}  #: of `encoder_inputs`
SUMMED = 65535 // 255  #: pixels at most whose sum fits into 16 bits
FLOOR = 80.0  #: range of spectrograms below their maximum, dB
#: Of ImageNet, sRGB in [0, 1].
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def encoder_inputs(
    modality: str,
    raw: np.ndarray,
    sizes: InputSizes,
    rng: np.random.Generator | None = None,
    device: str | torch.device = "cpu",
) -> torch.Tensor:
    """Compute encoder inputs (B, channels, H, W) float32 from observations (supplementary I.1).

    - "vision": (B, H, W, 3) uint8 sRGB, cropped and normalized as ImageNet. A generator places the crop of
      each view; default: the centre.
    - "audio": (B, samples) float32 at 16 kHz. Its magnitude spectrogram in decibels relative to the sound's
      own maximum, which removes the force, from 0 (80 dB below, or silence) to 1.
    - "touch": (B, h, w, 3) uint8, normalized as views.

    Spectrograms and touches are average-pooled to the sizes. Raises ObjectFolderError if the observations are
    smaller.
    """
    if modality == "vision":
        return _normalised(_crops(raw, sizes.image, rng).to(device))
    if modality == "audio":
        magnitude = spectrogram(torch.from_numpy(raw).to(device)).abs()
        peak = magnitude.amax((1, 2), keepdim=True)
        relative = magnitude / torch.where(peak > 0, peak, 1)
        decibels = 20 * relative.clamp(min=10 ** (-FLOOR / 20)).log10()
        return _pooled(1 + decibels[:, None] / FLOOR, sizes.spectrogram, "spectrogram")
    return _touches(raw, sizes.touch, device)


def _crops(raw: np.ndarray, side: int, rng: np.random.Generator | None) -> torch.Tensor:
    """Crop squares from views, (B, H, W, 3) -> (B, 3, side, side)."""
    spare = np.subtract(raw.shape[1:3], side)
    if spare.min() < 0:
        height, width = raw.shape[1:3]
        raise ObjectFolderError(
            f"views of {height} x {width} pixels are smaller than the encoder's image {side}"
        )
    corner = (
        np.tile(spare // 2, (len(raw), 1)) if rng is None else rng.integers(spare + 1, size=(len(raw), 2))
    )
    windows = np.lib.stride_tricks.sliding_window_view(raw, (side, side), axis=(1, 2))
    return torch.from_numpy(windows[np.arange(len(raw)), corner[:, 0], corner[:, 1]])


def _normalised(pixels: torch.Tensor, most: int = 255) -> torch.Tensor:
    mean, deviation = (torch.tensor(x, device=pixels.device)[:, None, None] for x in (MEAN, DEVIATION))
    return (pixels.float() / most - mean) / deviation


def _touches(raw: np.ndarray, size: tuple[int, int], device: str | torch.device) -> torch.Tensor:
    """Pool and normalize touches, (B, H, W, 3) uint8 -> (B, 3, h, w)."""
    (down, over_rows), (across, over_columns) = (
        divmod(pixels, wanted) for pixels, wanted in zip(raw.shape[1:3], size)
    )
    if over_rows or over_columns or not 1 <= down * across <= SUMMED:
        return _pooled(_normalised(torch.from_numpy(raw).to(device).movedim(-1, 1)), size, "touch")
    # Integers are summed in a third of the time that floats are averaged in.
    total = np.zeros((len(raw), *size, 3), np.uint16)
    for row, column in np.ndindex(down, across):
        total += raw[:, row::down, column::across]
    pixels = torch.from_numpy(total.astype(np.float32)).to(device)
    return _normalised(pixels.movedim(-1, 1), 255 * down * across)


def _pooled(x: torch.Tensor, size: tuple[int, int], name: str) -> torch.Tensor:
    height, width = x.shape[2:]
    if height < size[0] or width < size[1]:
        raise ObjectFolderError(
            f"{name} of {height} x {width} is smaller than the encoder's {size[0]} x {size[1]}"
        )
    return nn.functional.adaptive_avg_pool2d(x, size)


@dataclass(frozen=True)
class Ground:
    """What touches have in common: the sensor's picture without an object, and how far they are from it."""

    median: torch.Tensor  #: (C, H, W), of each pixel
    deviation: torch.Tensor  #: root mean square of the differences, a number; 1 if there is none

    @classmethod
    def of(cls, inputs: torch.Tensor) -> "Ground":
        """Find the ground of encoder inputs of touches, (N, C, H, W).

        In most touches a pixel sees no slope or one of either sign, so that its median is that of flat gel.
        """
        median = inputs.median(0).values
        deviation = (inputs - median).square().mean().sqrt()
        return cls(median, torch.where(deviation > 0, deviation, 1.0))

    def subtracted(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return encoder inputs (B, C, H, W) as differences from the median, in deviations."""
        return (inputs - self.median) / self.deviation


def flip_some(inputs: torch.Tensor, rng: np.random.Generator) -> torch.Tensor:
    """Mirror half of the pictures of (B, C, H, W), at random, left to right.

    A mirrored picture is that of the mirrored object, in the mirrored light.
    """
    chosen = torch.from_numpy(rng.integers(2, size=len(inputs)).astype(bool)).to(inputs.device)
    return torch.where(chosen[:, None, None, None], inputs.flip(3), inputs)


def shift_each(inputs: torch.Tensor, most: int, rng: np.random.Generator) -> torch.Tensor:
    """Move each picture of (B, C, H, W) by up to so many pixels in each direction; its border is repeated."""
    height, width = inputs.shape[2:]
    padded = nn.functional.pad(inputs, (most,) * 4, mode="replicate")
    windows = padded.unfold(2, height, 1).unfold(3, width, 1)
    corner = torch.from_numpy(rng.integers(2 * most + 1, size=(2, len(inputs))))
    return windows[torch.arange(len(inputs)), :, corner[0], corner[1]]
