"""Pictures of truth, answer and their difference: on pages, and joined in a row."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.base.figures import show_image
from objectfolder.sound.spectrogram import (
    DYNAMIC_RANGE,
    FFT,
    HOP,
    SAMPLE_RATE,
    magnitudes,
    show_spectrogram,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from objectfolder.sound.query import SoundQueries

NAMES = ("ground truth", "Object File", "difference")
ENLARGED = 4  #: amplification of displayed differences of images
#: matplotlib's colours of that name, every 32nd, RGB: a report needs no matplotlib.
MAGMA = bytes.fromhex("000004 1d1147 51127c 832681 b73779 e55064 fb8761 fec287 fcfdbf")
SHOWN_RATE = 40000  #: Hz, of sounds whose spectrograms are shown: up to 20 kHz
SHOWN_SECONDS = (0.1, 0.2, 0.5, 1.0)  # of a spectrogram in a row: the shortest in which the sound decays


def compare_images(truth: np.ndarray, answer: np.ndarray) -> list[np.ndarray]:
    """Return truth, answer and their difference, `ENLARGED` and dark on white; (H, W, 3) in [0, 1]."""
    return [truth, answer, 1 - (ENLARGED * np.abs(answer - truth)).clip(0, 1)]


def show_views(
    figure: "Figure", truth: np.ndarray, answers: np.ndarray, scores: np.ndarray, titles: Sequence[str]
) -> None:
    """Fill a page with one view per column, and its score, dB, below its title.

    Views are (N, H, W, 3) arrays in [0, 1].
    """
    panels = figure.subplots(3, len(truth), squeeze=False)
    for column, image, answer, score, title in zip(panels.T, truth, answers, scores, titles):
        for axes, values in zip(column, compare_images(image, answer)):
            show_image(axes, values)
        column[0].set_title(f"{title}\n{score:.1f} dB", fontsize=9)
    for axes, name in zip(panels[:, 0], (*NAMES[:2], f"{NAMES[2]}, {ENLARGED} times")):
        axes.set_axis_on()  # for its label alone
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_ylabel(name, fontsize=9)


def shown_rate(file: "SoundQueries") -> int:
    """Return `SHOWN_RATE`, or that of the spectrograms that a file stores, Hz."""
    return SHOWN_RATE if file.has_modes else SAMPLE_RATE


def show_sound(
    axes: "Axes", sound: np.ndarray, rate: int, title: str = "", peak: float | None = None
) -> "AxesImage | None":
    """Show the spectrogram of a sound (samples,) as `show_spectrogram`, of any sample rate, Hz."""
    image = show_spectrogram(axes, sound, title, peak)
    if image is not None:
        _, seconds, _, kilohertz = image.get_extent()
        image.set_extent((0, seconds * SAMPLE_RATE / rate, 0, kilohertz * rate / SAMPLE_RATE))
    return image


def show_sounds(
    figure: "Figure", truth: np.ndarray, answers: np.ndarray, rate: int, titles: Sequence[str]
) -> None:
    """Fill a page with the spectrograms of one sound per column, in decibels below the peak of its truth.

    Sounds are (N, samples) arrays; the rate is in Hz.
    """
    panels = figure.subplots(3, len(truth), sharex=True, sharey=True, squeeze=False)
    shown = None
    for column, sound, answer, title in zip(panels.T, truth, answers, titles):
        peak = float(magnitudes(sound).max())
        for axes, values, name in zip(column, (sound, answer, answer - sound), NAMES):
            image = show_sound(axes, values, rate, peak=peak)
            axes.set_title(f"{title}\n{name}" if axes is column[0] else name, fontsize=9)
            shown = image or shown
            axes.label_outer()
    if shown is not None:
        figure.colorbar(shown, ax=panels, label="dB relative to the peak of the ground truth", aspect=40)


def join_images(truth: np.ndarray | None, answer: np.ndarray) -> np.ndarray:
    """Join truth, answer and difference in a row; without a truth return the answer."""
    return answer if truth is None else np.concatenate(compare_images(truth, answer), 1)


def join_spectrograms(truth: np.ndarray | None, answer: np.ndarray, rate: int) -> tuple[np.ndarray, float]:
    """Draw spectrograms of truth, answer and difference in a row: (H, W, 3) in [0, 1], and their seconds.

    They end at half of `SHOWN_RATE`. Decibels are relative to the peak of the truth.
    """
    sounds = [answer] if truth is None else [truth, answer, answer - truth]
    rows = 1 + round(min(SHOWN_RATE / rate, 1) * FFT / 2)
    levels = [magnitudes(sound)[:rows][::-1] for sound in sounds]
    top = levels[0].max()
    floor, peak = 10 ** (-DYNAMIC_RANGE / 20), top if top > 0 else 1
    ringing = np.flatnonzero(levels[0].max(0) > floor * top)
    lasts = ringing.max(initial=0) * HOP / rate
    seconds = next((shown for shown in SHOWN_SECONDS if shown > lasts), SHOWN_SECONDS[-1])
    levels = [level[:, : round(seconds * rate / HOP)] / peak for level in levels]
    shown = [20 * np.log10(np.maximum(level, floor)) / DYNAMIC_RANGE + 1 for level in levels]
    gap = np.ones((len(shown[0]), 2))
    panels = [part for level in shown for part in (gap, level)][1:]
    joined, colours = np.concatenate(panels, 1), np.frombuffer(MAGMA, np.uint8).reshape(-1, 3) / 255
    steps = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(joined, steps, channel) for channel in colours.T], -1), seconds
