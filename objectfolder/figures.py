"""Pages of panels, drawn with matplotlib's object interface (no global state, no window)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.audio.spectrogram import HOP, SAMPLE_RATE, spectrogram
from objectfolder.io import atomic
from objectfolder.metrics import psnr

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.image import AxesImage

DPI = 120
ENLARGED = 4  #: times an error is shown
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


def show_views(figure: "Figure", truth: np.ndarray, answers: np.ndarray, titles: Sequence[str]) -> None:
    """Fill a page with views in columns; ground truth, answer and their difference in rows.

    The difference is absolute, `ENLARGED` times, taken from white.

    Parameters
    ----------
    truth, answers : (N, H, W, 3) arrays in [0, 1]
    titles : sequence of str
        One per view; its PSNR is added.
    """
    names = ("ground truth", "Object File", f"difference, {ENLARGED} times")
    panels = figure.subplots(3, len(truth), squeeze=False)
    for column, image, answer, title in zip(panels.T, truth, answers, titles):
        difference = np.abs(answer - image)
        score = float(psnr((difference**2).mean()))
        shown = (image, answer, 1 - np.clip(ENLARGED * difference, 0, 1))
        for axes, values, name in zip(column, shown, names):
            head = f"{title}, {score:.1f} dB\n" if axes is column[0] else ""
            show_image(axes, values)
            axes.set_title(head + name, fontsize=9)


def show_spectrogram(
    axes: "Axes", sound: np.ndarray, title: str = "", peak: float | None = None
) -> "AxesImage | None":
    """Show the level of a sound over time and frequency, relative to its loudest place.

    Parameters
    ----------
    sound : (samples,) array at `objectfolder.audio.spectrogram.SAMPLE_RATE`
    title : str
    peak : float, optional
        Largest magnitude of the spectrogram to which levels are relative instead; the page then has one
        colour bar for several panels.

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
        axes.figure.colorbar(image, ax=axes, label="dB below the peak")
    return image


def magnitudes(sound: np.ndarray) -> np.ndarray:
    """Magnitudes of the spectrogram of a (samples,) sound; (257, frames)."""
    import torch

    return spectrogram(torch.from_numpy(np.asarray(sound, np.float32))[None])[0].abs().numpy()


def show_answers(figure: "Figure", truth: np.ndarray, answers: np.ndarray, titles: Sequence[str]) -> None:
    """Fill a page with spectrograms: sounds in columns; ground truth, answer and their difference in rows.

    Levels of a column are relative to the peak of its ground truth.

    Parameters
    ----------
    truth, answers : (N, samples) arrays
    titles : sequence of str
        One per sound.
    """
    panels = figure.subplots(3, len(truth), sharex=True, sharey=True, squeeze=False)
    shown = None
    for column, sound, answer, title in zip(panels.T, truth, answers, titles):
        peak = float(magnitudes(sound).max())
        for axes, values, name in zip(
            column, (sound, answer, answer - sound), ("ground truth", "Object File", "difference")
        ):
            image = show_spectrogram(axes, values, peak=peak)
            axes.set_title(f"{title}\n{name}" if axes is column[0] else name, fontsize=9)
            shown = image or shown
            axes.label_outer()
    if shown is not None:
        figure.colorbar(shown, ax=panels, label="dB below the peak of the ground truth", aspect=40)


def tile(images: np.ndarray, columns: int, gap: int = 4) -> np.ndarray:
    """Lay images out in rows on white; (N, H, W, 3) uint8 -> (H', W', 3) uint8."""
    count, height, width, _ = images.shape
    rows = -(-count // columns)
    page = np.full((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), 255, np.uint8)
    for i, image in enumerate(images):
        top, left = gap + i // columns * (height + gap), gap + i % columns * (width + gap)
        page[top : top + height, left : left + width] = image
    return page
