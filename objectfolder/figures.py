"""Pages of panels drawn with matplotlib's object-oriented interface (no global state, no window)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.io import atomic_stream
from objectfolder.metrics import psnr

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

DPI = 120
ENLARGED = 4  #: amplification of displayed differences


def page(width: float, height: float, title: str) -> "Figure":
    """Return an empty page of this size in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=13, fontweight="bold")
    return figure


def page_rows(figure: "Figure", *heights: float) -> list["SubFigure"]:
    """Divide a page into rows of relative heights."""
    return np.asarray(figure.subfigures(len(heights), 1, height_ratios=heights)).tolist()


def page_columns(figure: "Figure", *widths: float) -> list["SubFigure"]:
    """Divide a page into columns of relative widths."""
    return np.asarray(figure.subfigures(1, len(widths), width_ratios=widths)).tolist()


def save_page(figure: "Figure", path: Path) -> Path:
    """Write a page as PNG and return its path."""
    with atomic_stream(path) as stream:
        figure.savefig(stream, format="png")
    return path


def show_image(axes: "Axes", image: np.ndarray, title: str = "") -> None:
    """Show an (H, W, 3) image without axes."""
    axes.imshow(image)
    axes.set_anchor("N")  # images of different heights line up under their titles
    axes.set_title(title, fontsize=11)
    axes.set_axis_off()


def show_views(figure: "Figure", truth: np.ndarray, answers: np.ndarray, titles: Sequence[str]) -> None:
    """Fill a page with one view per column; ground truth, answer and difference in rows.

    The absolute difference, amplified `ENLARGED` times, is shown dark on white.

    Parameters
    ----------
    truth, answers : (N, H, W, 3) arrays in [0, 1]
    titles : sequence of str
        One per view; the PSNR of the answer stands below it.
    """
    panels = figure.subplots(3, len(truth), squeeze=False)
    for column, image, answer, title in zip(panels.T, truth, answers, titles):
        difference = np.abs(answer - image)
        shown = (image, answer, 1 - np.clip(ENLARGED * difference, 0, 1))
        for axes, values in zip(column, shown):
            show_image(axes, values)
        column[0].set_title(f"{title}\n{float(psnr((difference**2).mean())):.1f} dB", fontsize=9)
    for axes, name in zip(panels[:, 0], ("ground truth", "Object File", f"difference, {ENLARGED} times")):
        axes.set_axis_on()  # for its label alone
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_ylabel(name, fontsize=9)


def tile(images: np.ndarray, columns: int, gap: int = 4) -> np.ndarray:
    """Tile images in rows on white; (N, H, W, 3) uint8 -> (H', W', 3) uint8."""
    count, height, width, _ = images.shape
    rows = -(-count // columns)
    page = np.full((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), 255, np.uint8)
    for i, image in enumerate(images):
        top, left = gap + i // columns * (height + gap), gap + i % columns * (width + gap)
        page[top : top + height, left : left + width] = image
    return page
