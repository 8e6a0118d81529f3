"""Tables of colours for the simulator Taxim (Si and Yuan 2022) and what reads its files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.base.io import atomic_stream
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile

BINS = 120  #: of slope and of its direction, as NVIDIA's Isaac Lab reads them

_SAMPLES = 10  # at least; pixels along the shorter side at which the table's polynomials are fitted
_MAX_SLOPE_ANGLE = np.radians(85)


def color_table(profile: SensorProfile, bins: int = BINS, sign: float = 1.0) -> np.ndarray:
    """Return Taxim's table of a profile: colour changes over the gel's slope; (3, bins, bins, 6) float64.

    The bins of the first axis are those of the slope's angle, 0 to π/2 in bins - 1 steps; those of the second
    of its direction, atan2(∂h/∂row, ∂h/∂column), -π to π in bins - 1 steps, h being the height towards the
    camera, or away from it if ``sign`` is -1. The last axis has the coefficients of x², y², x y, x, y, 1,
    with x the column and y the row of the profile's images, and yields grey levels. The first bin of the
    angle is an untouched gel. What such a table cannot hold is left out: optical blur, and that a displaced
    gel is nearer to the lights.
    """
    coarse = _coarse(profile)
    optics = Optics(coarse)
    angle = np.minimum((np.arange(bins) + 0.5) * np.pi / 2 / (bins - 1), _MAX_SLOPE_ANGLE)
    angle[0] = 0
    direction = (np.arange(bins) + 0.5) * 2 * np.pi / (bins - 1) - np.pi
    sizes = (coarse.height, profile.height), (coarse.width, profile.width)
    rows, columns = ((np.arange(n) + 0.5) * full / n - 0.5 for n, full in sizes)
    y, x = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))
    solve = np.linalg.pinv(np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1))
    table = np.empty((3, bins, bins, 6))
    for i, slope in enumerate(sign * np.tan(angle)):
        # Columns run against y of the camera's frame, rows against z.
        change = optics.tilted(-slope * np.cos(direction), -slope * np.sin(direction))
        table[:, i] = change.reshape(3, bins, -1).astype(float) @ solve.T
    return table


def export_taxim(profile: SensorProfile, folder: str | Path, isaac: bool = False) -> list[Path]:
    """Write ``polycalib.npz``, ``bg.jpg`` and ``real_bg.npy`` as Taxim or Isaac Lab's tactile sensor read.

    Both look a colour up by the slope of a height map in pixels. Taxim (``simulator.simulating`` in
    ``OpticalSimulation/simOptical.py``) has heights that grow towards the camera. Isaac Lab's sensor hands
    its renderer such heights, too, but ``GelsightRender.render`` in ``visuotactile_render.py`` turns their
    sign before it looks up: with ``isaac``, directions are turned by half a circle. Returns the files
    written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    background = Optics(profile).background.numpy()
    red, green, blue = color_table(profile, sign=-1.0 if isaac else 1.0)
    table, picture, rest = (folder / name for name in ("polycalib.npz", "bg.jpg", "real_bg.npy"))
    with atomic_stream(table) as stream:
        np.savez(stream, bins=BINS, grad_r=red, grad_g=green, grad_b=blue)
    with atomic_stream(picture) as stream:
        Image.fromarray(background).save(stream, "JPEG", quality=95, subsampling=0)
    with atomic_stream(rest) as stream:
        np.save(stream, background.astype(np.float64))
    return [table, picture, rest]


def _coarse(profile: SensorProfile) -> SensorProfile:
    """Return the profile with the same view in few pixels, without its background."""
    shorter, longer = sorted((profile.height, profile.width))

    def apart(n: int) -> float:
        return abs(round(n * longer / shorter) * shorter - n * longer) / n

    # The number whose ratio to the rounded longer side is the nearest: an exact one if there is any.
    factor = min(range(_SAMPLES, 3 * _SAMPLES), key=apart) / shorter
    height, width = (max(2, round(n * factor)) for n in (profile.height, profile.width))
    sharp = replace(profile, height=height, width=width, slope_smoothing=0.0, image_smoothing=0.0)
    return replace(sharp, background_image="", background_sha256="")  # of another aspect ratio
