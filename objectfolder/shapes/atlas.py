"""Charts of a surface, packed into one texture and baked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from objectfolder.base.errors import ObjectFolderError

MARGIN = 4  #: texels painted beyond each border of a chart, to hide seams from bilinear filtering


Paint = Callable[[np.ndarray], np.ndarray]  #: points (N, 3), m -> sRGB (N, 3) in [0, 1]


@dataclass(frozen=True)
class Chart:
    """Flat map, in metres, of one part of a surface."""

    size: tuple[float, float]  #: width and height of the map, m
    locate: Callable[[np.ndarray], np.ndarray]  #: (M, 2) map coordinates, m -> (M, 3) surface points, m
    paint: Paint


@dataclass(frozen=True)
class Atlas:
    """Charts laid out in a square texture, all at the same texel density."""

    charts: tuple[Chart, ...]
    origins: np.ndarray  #: (C, 2) lower left corner of each chart, texels from the texture's lower left
    density: float  #: texels per metre
    resolution: int  #: side of the texture, texels

    def uv(self, chart: int, xy: np.ndarray) -> np.ndarray:
        """Convert map coordinates ``xy`` (N, 2), m, of a chart to texture coordinates (N, 2)."""
        return (self.origins[chart] + self.density * xy) / self.resolution

    def bake(self) -> np.ndarray:
        """Paint every chart into a texture (resolution, resolution, 3) uint8, first row at the top.

        Charts are painted beyond their borders, where the map continues over the neighbouring surface. The
        space between charts takes the nearest painted colour, which keeps mipmaps clean.
        """
        n = self.resolution
        image = np.zeros((n, n, 3))
        painted = np.zeros((n, n), bool)
        for origin, chart in zip(self.origins, self.charts):
            low = np.maximum(np.floor(origin - MARGIN), 0).astype(int)
            high = np.minimum(np.ceil(origin + self.density * np.array(chart.size) + MARGIN), n).astype(int)
            columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
            xy = (np.stack([columns.ravel(), rows.ravel()], 1) + 0.5 - origin) / self.density
            window = np.s_[low[1] : high[1], low[0] : high[0]]
            image[window] = chart.paint(chart.locate(xy)).reshape(*columns.shape, 3)
            painted[window] = True
        nearest = distance_transform_edt(~painted, return_distances=False, return_indices=True)
        filled = image[tuple(nearest)]
        return np.round(255 * np.clip(filled, 0, 1)).astype(np.uint8)[::-1].copy()


def _shelves(sizes: np.ndarray, resolution: int) -> np.ndarray | None:
    """Pack boxes on shelves, tallest first; lower left corners (C, 2), or None if they do not fit."""
    corners = np.zeros(sizes.shape)
    x = y = shelf = 0.0
    for k in np.argsort(-sizes[:, 1], kind="stable"):
        width, height = sizes[k]
        if x + width > resolution:
            x, y, shelf = 0.0, y + shelf, 0.0
        if x + width > resolution or y + height > resolution:
            return None
        corners[k] = x, y
        x, shelf = x + width, max(shelf, height)
    return corners


def pack_charts(charts: Sequence[Chart], resolution: int) -> Atlas:
    """Pack charts at the largest common texel density that fits a ``resolution`` x ``resolution`` square.

    Raises `ObjectFolderError` if the square is too small.
    """
    sizes = np.array([chart.size for chart in charts])
    low, high = 0.0, resolution / sizes.max()
    for _ in range(40):
        middle = (low + high) / 2
        fits = _shelves(middle * sizes + 2 * MARGIN, resolution) is not None
        low, high = (middle, high) if fits else (low, middle)
    corners = _shelves(low * sizes + 2 * MARGIN, resolution)
    if corners is None or low * sizes.max() < 1:
        raise ObjectFolderError(
            f"texture_size={resolution}: expected room for {len(charts)} charts; make it larger"
        )
    return Atlas(tuple(charts), corners + MARGIN, low, resolution)
