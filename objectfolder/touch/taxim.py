"""Files of the simulator Taxim (Si and Yuan 2022): its calibration photographs, and its tables of colours."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from objectfolder.errors import ObjectFolderError
from objectfolder.io import atomic_stream
from objectfolder.touch.optics import Optics
from objectfolder.touch.photographs import scaled
from objectfolder.touch.profiles import SensorProfile

BINS = 120  #: of slope and of its direction, as NVIDIA's Isaac Lab reads them

_ARRAYS = ("f0", "imgs", "touch_center", "touch_radius")
_SAMPLES = 10  # at least; pixels along the shorter side at which the table's polynomials are fitted
_STEEPEST = np.radians(85)


@dataclass(frozen=True)
class Pack:
    """Photographs of a pressed ball."""

    pictures: np.ndarray  #: (K, H, W, 3) uint8
    untouched: np.ndarray  #: (H, W, 3) uint8
    circles: list[tuple[float, float, float]]  #: row, column and radius of the imprints, pixels


def read_pack(path: str | Path, profile: SensorProfile) -> Pack:
    """Read Taxim's ``dataPack.npz`` and scale it to the profile's image size.

    Its arrays are ``f0`` (H, W, 3), the untouched sensor; ``imgs`` (K, H, W, 3); ``touch_center`` (K, 2),
    column and row; ``touch_radius`` (K,). Channels are taken as red, green and blue, in which order
    ObjectFolder 2.0 and Isaac Lab use Taxim's tables.

    Raises
    ------
    ObjectFolderError
        If the file is not such a pack, or its pictures have another aspect ratio than the sensor's.
    """
    if not Path(path).is_file():
        raise ObjectFolderError(f"calibration pack {path} does not exist; expected Taxim's dataPack.npz")
    try:
        # Not `read_npz`: Taxim's packs hold more arrays, some of them pickled.
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            untouched, pictures, centres, radii = (archive[name] for name in _ARRAYS)
    except Exception as error:  # numpy's are of many types
        raise ObjectFolderError(
            f"{path} is not a calibration pack of Taxim: {error}; expected arrays {', '.join(_ARRAYS)}"
        ) from error
    count = radii.size
    if not (
        radii.shape == (count,)
        and count
        and untouched.shape[2:] == (3,)
        and pictures.shape == (count, *untouched.shape)
        and centres.shape == (count, 2)
    ):
        raise ObjectFolderError(
            f"{path}: arrays of shapes f0 {untouched.shape}, imgs {pictures.shape}, touch_center "
            f"{centres.shape}, touch_radius {radii.shape} do not fit; expected (H, W, 3), (K, H, W, 3), "
            "(K, 2), (K,) with K at least 1"
        )
    for name, values in (("f0", untouched), ("imgs", pictures)):
        if values.dtype.kind not in "uif" or not (values.min() >= 0 and 1 < values.max() <= 255):
            raise ObjectFolderError(
                f"{path}: {name} has values of type {values.dtype} from {values.min()} to {values.max()}; "
                "expected grey levels from 0 to 255"
            )
    factor = profile.height / untouched.shape[0]
    where = f"calibration pack {path} for sensor {profile.name!r}"
    resized = [scaled(Image.fromarray(image.astype(np.uint8)), profile, where) for image in pictures]
    circles = [
        (float(y + 0.5) * factor - 0.5, float(x + 0.5) * factor - 0.5, float(radius) * factor)
        for (x, y), radius in zip(centres, radii)
    ]
    rest = scaled(Image.fromarray(untouched.astype(np.uint8)), profile, where)
    return Pack(np.stack(resized), rest, circles)


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
    angle = np.minimum((np.arange(bins) + 0.5) * np.pi / 2 / (bins - 1), _STEEPEST)
    angle[0] = 0
    direction = (np.arange(bins) + 0.5) * 2 * np.pi / (bins - 1) - np.pi
    rows, columns = (
        (np.arange(n) + 0.5) * full / n - 0.5
        for n, full in ((coarse.height, profile.height), (coarse.width, profile.width))
    )
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
    _write(table, lambda stream: np.savez(stream, bins=BINS, grad_r=red, grad_g=green, grad_b=blue))
    _write(
        picture, lambda stream: Image.fromarray(background).save(stream, "JPEG", quality=95, subsampling=0)
    )
    _write(rest, lambda stream: np.save(stream, background.astype(np.float64)))
    return [table, picture, rest]


def _coarse(profile: SensorProfile) -> SensorProfile:
    """Return the profile with the same view in few pixels, without its background."""
    shorter, longer = sorted((profile.height, profile.width))
    # The number whose ratio to the rounded longer side is the nearest: an exact one if there is any.
    pixels = min(
        range(_SAMPLES, 3 * _SAMPLES),
        key=lambda n: abs(round(n * longer / shorter) * shorter - n * longer) / n,
    )
    factor = pixels / shorter
    height, width = (max(2, round(n * factor)) for n in (profile.height, profile.width))
    return replace(
        profile,
        height=height,
        width=width,
        slope_smoothing=0.0,
        image_smoothing=0.0,
        background_image="",  # of another aspect ratio than these few pixels
        background_sha256="",
    )


def _write(path: Path, save: Callable[[BinaryIO], object]) -> None:
    with atomic_stream(path) as stream:
        save(stream)
