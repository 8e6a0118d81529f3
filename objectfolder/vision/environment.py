"""Equirectangular pictures of surroundings, as a few distant lights."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.checks import real_array
from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.vision.lighting import MAX_COLOR, DistantLight, Lamp, choose_lamps
from objectfolder.vision.radiance import RADIANCE_SUFFIXES, read_radiance

LIGHTS = 64  #: that stand for a picture
MAX_PIXEL = MAX_COLOR / 10  #: radiance; a light has up to four times that of its pixels
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec. 709


def read_environment(path: str | Path) -> np.ndarray:
    """Read an equirectangular picture; (H, W, 3) linear radiance.

    Radiance, OpenEXR and PFM files are read as `objectfolder.vision.radiance.read_radiance` says, others are
    taken for sRGB. Raises ObjectFolderError if the picture cannot be read, or mitsuba is missing.
    """
    path = Path(path)
    if path.suffix.lower() in RADIANCE_SUFFIXES:
        return read_radiance(path)
    from objectfolder.base.pictures import decoded  # loads PIL

    return srgb.decode(np.asarray(decoded(path, str(path), upright=True)) / 255)


def environment_lamps(picture: str | Path | np.ndarray, count: int = LIGHTS) -> list[DistantLight]:
    """Return distant lights that stand for the surroundings of an object.

    The picture is cut into regions of equal light by Debevec's median cut (2005): each becomes one light from
    the centre of its light. It keeps all of the light, and no random numbers are drawn.

    Parameters
    ----------
    picture : path, or (H, W, 3) array
        Linear radiance. The upper edge is the direction z, the centre of the picture x, a point a quarter of
        the width to the left of it y.
    count : int
        Number of lights: a power of two. Regions of a single pixel are not cut.

    Raises
    ------
    ObjectFolderError
        If the picture cannot be read, or its values are negative, not finite, beyond `MAX_PIXEL`, or
        all 0.
    """
    where = str(picture) if isinstance(picture, str | Path) else "environment"
    values = read_environment(picture) if isinstance(picture, str | Path) else real_array(where, picture)
    if values.ndim != 3 or values.shape[2] != 3 or not values.size:
        raise ObjectFolderError(f"{where} has shape {values.shape}, expected (H, W, 3)")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ObjectFolderError(f"{where} holds values that are negative or not finite, expected radiances")
    if values.max() > MAX_PIXEL:
        raise ObjectFolderError(
            f"{where} holds the radiance {values.max():g}, expected at most {MAX_PIXEL:g}"
        )
    height, width = values.shape[:2]
    edges = np.linspace(0, np.pi, height + 1)
    solid_angle = -np.diff(np.cos(edges)) * 2 * np.pi / width  # of a pixel of each row
    light = values * solid_angle[:, None, None] / np.pi
    energy = light @ _LUMINANCE
    if energy.sum() == 0:
        raise ObjectFolderError(f"{where} is black, expected some light")
    ways = pixel_directions(height, width)
    regions = [(slice(0, height), slice(0, width))]
    for _ in range(max(count, 1).bit_length() - 1):
        regions = [half for region in regions for half in _halves(energy, region)]
    lamps = []
    for region in regions:
        color, share = light[region].sum((0, 1)), energy[region]
        middle = (ways[region] * share[..., None]).sum((0, 1))
        if share.sum() > 0 and np.linalg.norm(middle) > 0:
            lamps.append(DistantLight(middle, color))
    return lamps


def gather_lamps(
    lights: str | Sequence[Any] | None, environment: str | Path | np.ndarray | None
) -> list[Lamp]:
    """Return the lights that a query names and those of its surroundings.

    Parameters and errors are those of `objectfolder.vision.lighting.choose_lamps` and `environment_lamps`.
    """
    chosen = choose_lamps(lights)
    return chosen if environment is None else [*chosen, *environment_lamps(environment)]


def pixel_directions(height: int, width: int) -> np.ndarray:
    """Return the unit vectors to the pixels of an equirectangular picture; (H, W, 3)."""
    down = (np.arange(height)[:, None] + 0.5) * np.pi / height
    around = np.pi - (np.arange(width)[None] + 0.5) * 2 * np.pi / width
    x, y = np.sin(down) * np.cos(around), np.sin(down) * np.sin(around)
    return np.stack([x, y, np.broadcast_to(np.cos(down), x.shape)], -1)


def _halves(energy: np.ndarray, region: tuple[slice, slice]) -> list[tuple[slice, slice]]:
    """Cut a region across its longer side on the sphere, so that both parts have nearly equal energy."""
    rows, columns = region
    tall, wide = rows.stop - rows.start, columns.stop - columns.start
    height, width = energy.shape
    middle = np.pi * (rows.start + rows.stop) / (2 * height)
    across = wide * 2 * np.pi / width * np.sin(middle)
    along_columns = (across > tall * np.pi / height and wide > 1) or tall == 1
    if tall == wide == 1:
        return [region]
    sums = energy[region].sum(0 if along_columns else 1).cumsum()
    # Rounding leaves at least one line on each side.
    cut = int(np.abs(sums[:-1] - sums[-1] / 2).argmin()) + 1
    if along_columns:
        place = columns.start + cut
        return [(rows, slice(columns.start, place)), (rows, slice(place, columns.stop))]
    place = rows.start + cut
    return [(slice(rows.start, place), columns), (slice(place, rows.stop), columns)]
