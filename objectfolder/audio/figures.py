"""Spectrogram panels for pages of `objectfolder.figures`."""

from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.audio.spectrogram import HOP, SAMPLE_RATE, spectrogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

DYNAMIC_RANGE = 80.0  #: displayed range of a spectrogram, dB


def show_spectrogram(
    axes: "Axes", sound: np.ndarray, title: str = "", peak: float | None = None
) -> "AxesImage | None":
    """Show the spectrogram of a sound in decibels below its peak.

    Parameters
    ----------
    sound : (samples,) array at `SAMPLE_RATE`
    title : str
    peak : float, optional
        Reference magnitude; default: the sound's own. If given, no colour bar is added: panels share one.

    Returns
    -------
    AxesImage or None
        None for a silent sound.
    """
    level = magnitudes(sound)
    axes.set(title=title, xlabel="time [s]", ylabel="frequency [kHz]")
    top = level.max() if peak is None else peak
    if not (level.any() and top > 0):
        axes.text(0.5, 0.5, "silent", transform=axes.transAxes, ha="center", va="center")
        return None
    decibels = 20 * np.log10(np.maximum(level / top, 10 ** (-DYNAMIC_RANGE / 20)))
    extent = (0, (level.shape[1] - 1) * HOP / SAMPLE_RATE, 0, SAMPLE_RATE / 2000)
    image = axes.imshow(
        decibels, origin="lower", aspect="auto", extent=extent, cmap="magma", vmin=-DYNAMIC_RANGE, vmax=0
    )
    if peak is None:
        axes.figure.colorbar(image, ax=axes, label="dB relative to the peak")
    return image


def magnitudes(sound: np.ndarray) -> np.ndarray:
    """Return the spectrogram magnitudes of a (samples,) sound; (257, frames)."""
    return spectrogram(torch.from_numpy(np.asarray(sound, np.float32))[None])[0].abs().numpy()
