"""Pages of panels drawn with matplotlib's object-oriented interface (no global state, no window)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.base.io import atomic_stream

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

DPI = 120


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


def tile(images: np.ndarray, columns: int, gap: int = 4) -> np.ndarray:
    """Tile images in rows on white; (N, H, W, 3) uint8 -> (H', W', 3) uint8."""
    count, height, width, _ = images.shape
    rows = -(-count // columns)
    page = np.full((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), 255, np.uint8)
    for i, image in enumerate(images):
        top, left = gap + i // columns * (height + gap), gap + i % columns * (width + gap)
        page[top : top + height, left : left + width] = image
    return page
