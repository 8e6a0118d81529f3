"""Pages of panels, drawn with matplotlib's object interface (no global state, no window)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.artifacts import atomic
from objectfolder.audio.spectrogram import HOP, SAMPLE_RATE, spectrogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

DPI = 120
DYNAMIC_RANGE = 80.0  # dB of a spectrogram that are shown


def page(width: float, height: float, title: str) -> "Figure":
    """Return an empty page; inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=13, fontweight="bold")
    return figure


def rows(figure: "Figure", *heights: float) -> list["SubFigure"]:
    """Divide a page into rows of relative heights."""
    return np.asarray(figure.subfigures(len(heights), 1, height_ratios=heights)).tolist()


def columns(figure: "Figure", *widths: float) -> list["SubFigure"]:
    """Divide a page into columns of relative widths."""
    return np.asarray(figure.subfigures(1, len(widths), width_ratios=widths)).tolist()


def save(figure: "Figure", path: Path) -> Path:
    """Write a page as PNG and return where it is."""
    with atomic(path) as temporary:
        figure.savefig(temporary)
    return path


def show_image(axes: "Axes", image: np.ndarray, title: str = "") -> None:
    """Show an (H, W, 3) image without axes."""
    axes.imshow(image)
    axes.set_anchor("N")  # images of different heights line up under their titles
    axes.set_title(title, fontsize=11)
    axes.set_axis_off()


def show_spectrogram(axes: "Axes", sound: np.ndarray, title: str) -> None:
    """Show the level of a sound over time and frequency, relative to its loudest place.

    Parameters
    ----------
    sound : (samples,) array at `objectfolder.audio.spectrogram.SAMPLE_RATE`
    """
    import torch

    level = spectrogram(torch.from_numpy(np.asarray(sound, np.float32))[None])[0].abs().numpy()
    axes.set(title=title, xlabel="time [s]", ylabel="frequency [kHz]")
    if not level.any():
        axes.text(0.5, 0.5, "silent", transform=axes.transAxes, ha="center", va="center")
        return
    decibels = 20 * np.log10(np.maximum(level / level.max(), 10 ** (-DYNAMIC_RANGE / 20)))
    extent = (0, (level.shape[1] - 1) * HOP / SAMPLE_RATE, 0, SAMPLE_RATE / 2000)
    image = axes.imshow(
        decibels, origin="lower", aspect="auto", extent=extent, cmap="magma", vmin=-DYNAMIC_RANGE, vmax=0
    )
    axes.figure.colorbar(image, ax=axes, label="dB below the peak")
