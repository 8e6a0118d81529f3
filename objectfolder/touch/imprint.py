"""Imprints of a ball in pictures of a sensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.filters import threshold_otsu
from skimage.measure import label, regionprops
from skimage.morphology import reconstruction

from objectfolder.base.errors import ObjectFolderError

_MIN_RADIUS = 4.0  # pixels
_MIN_CONTRAST = 4.0  # brightness of an imprint over the noise
_MIN_FILL = 0.5  # area of an imprint over that of its convex hull
_MAX_ELONGATION = 1.6  # length over width

# A channel that overflowed is dark inside an area where it is as bright as this, by at least this much.
_SATURATED_LEVEL, _MIN_HOLE_DEPTH = 240.0, 16.0  # grey levels

# Without a picture of the untouched sensor, this part of each imprint must be free in another picture.
_MIN_FREE = 0.5


@dataclass(frozen=True)
class Imprint:
    """Position and depth of a pressed ball."""

    row: float  #: pixels, of the centre
    column: float  #: pixels
    depth: float  #: m beyond the undeformed gel, along the gel's normal


def find_imprint(change: np.ndarray, name: str = "picture") -> tuple[float, float, float]:
    """Return row, column and radius, in pixels, of the round spot where a picture changes.

    ``change`` (H, W, 3) is the difference to the untouched sensor, ``name`` that of the picture in errors.
    Raises ObjectFolderError if nothing stands out from the noise, or the spot is not round, too small or cut
    off by the border.
    """
    strength = np.linalg.norm(gaussian_filter(change, (1.5, 1.5, 0)), axis=2)
    noise = np.median(strength)
    remedy = "give its --circle, or leave the picture out"
    level = threshold_otsu(strength)
    above = strength[strength > level]
    if not above.size or above.mean() < _MIN_CONTRAST * noise + 1:
        raise ObjectFolderError(
            f"{name}: no imprint stands out from the untouched gel; press harder, or {remedy}"
        )
    spot = max(regionprops(label(strength > level)), key=lambda region: region.area)
    hull_radius = float(np.sqrt(spot.area_convex / np.pi))
    if hull_radius < _MIN_RADIUS:
        raise ObjectFolderError(
            f"{name}: the imprint is {hull_radius:.1f} pixels in radius, expected at least {_MIN_RADIUS:g}; "
            f"press harder, or {remedy}"
        )
    top, left, bottom, right = spot.bbox
    height, width = bottom - top, right - left
    elongation = max(height, width) / min(height, width)
    if min(top, left) == 0 or bottom == change.shape[0] or right == change.shape[1]:
        raise ObjectFolderError(
            f"{name}: the imprint is cut off by the picture's border; press further inside"
        )
    if elongation > _MAX_ELONGATION or spot.solidity < _MIN_FILL:
        raise ObjectFolderError(
            f"{name}: the change is not the imprint of a ball ({width} x {height} pixels, "
            f"{spot.solidity:.0%} of its hull); {remedy}"
        )
    return (top + bottom - 1) / 2, (left + right - 1) / 2, (height + width) / 4


def check_circles(
    circles: Sequence[tuple[float, float, float]], shape: tuple[int, ...], names: Sequence[str]
) -> None:
    """Raise ObjectFolderError unless each picture has a circle whose centre lies in it."""
    if len(circles) != len(names):
        raise ObjectFolderError(f"{len(circles)} circles for {len(names)} pictures: expected one for each")
    height, width = shape[:2]
    for (row, column, radius), name in zip(circles, names):
        inside = -0.5 <= row <= height - 0.5 and -0.5 <= column <= width - 0.5
        if not (inside and np.isfinite(radius) and radius > 0):
            raise ObjectFolderError(
                f"{name}: the circle is {row:g},{column:g},{radius:g}, expected row and column of a point "
                f"in the picture of {height} x {width} pixels and a positive radius; correct its --circle"
            )


def find_overflow(picture: np.ndarray) -> np.ndarray:
    """Return where a channel of a picture (H, W, 3) overflowed; (H, W) bool.

    Some cameras, or programs behind them, go on from 255 to 0. What is left of that in a picture that was
    made smaller is a dark hole in one channel, enclosed by pixels that are white in it.
    """
    found = np.zeros(picture.shape[:2], bool)
    for channel in np.moveaxis(np.asarray(picture, np.float64), -1, 0):
        seed = np.full_like(channel, channel.max())
        for border in np.s_[[0, -1], :], np.s_[:, [0, -1]]:
            seed[border] = channel[border]
        filled = reconstruction(seed, channel, method="erosion")  # without its holes
        found |= (filled >= _SATURATED_LEVEL) & (filled - channel >= _MIN_HOLE_DEPTH)
    return found


def estimate_untouched(observed: np.ndarray, untouched: np.ndarray | None) -> np.ndarray:
    """Return the untouched sensor for each picture, (K, H, W, 3): the median of all, if it is not given."""
    given = np.median(observed, axis=0) if untouched is None else np.asarray(untouched, np.float32)
    return np.broadcast_to(given, observed.shape)


def check_background_seen(
    circles: Sequence[tuple[float, float, float]], shape: tuple[int, ...], names: Sequence[str]
) -> None:
    """Raise ObjectFolderError if an imprint covers a place that no other picture shows untouched."""
    rows, columns = np.indices(shape)
    spots = np.stack([(rows - r) ** 2 + (columns - c) ** 2 < radius**2 for r, c, radius in circles])
    everywhere = spots.all(axis=0)
    for spot, name in zip(spots, names):
        if everywhere.sum() > (1 - _MIN_FREE) * spot.sum():
            raise ObjectFolderError(
                f"{name}: the ball is at the same position as in all other pictures, so the "
                "background there is unknown; press elsewhere, or give a picture of the untouched sensor"
            )
