"""Pictures taken by a real sensor: single ones, and calibration packs of the simulator Taxim."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.pictures import decoded
from objectfolder.touch.profiles import SensorProfile

_ARRAYS = ("f0", "imgs", "touch_center", "touch_radius")
_ASPECT_TOLERANCE = 0.01  # relative, of width / height


def read_photograph(path: str | Path, profile: SensorProfile) -> np.ndarray:
    """Read a picture of a sensor and scale it to the profile's image size; (H, W, 3) uint8, RGB.

    Raises ObjectFolderError if the file is missing, is not a picture, or has another aspect ratio than the
    sensor's images.
    """
    where = f"picture {path} of sensor {profile.name!r}"
    if not Path(path).is_file():
        raise ObjectFolderError(f"{where} does not exist; expected a PNG or JPEG file")
    return scale_picture(decoded(Path(path), where), profile, where)


def scale_picture(picture: Image.Image, profile: SensorProfile, where: str) -> np.ndarray:
    """Scale a picture to the profile's image size; (H, W, 3) uint8, RGB. Errors begin with ``where``."""
    wanted = profile.width / profile.height
    if abs(picture.width / picture.height / wanted - 1) > _ASPECT_TOLERANCE:
        raise ObjectFolderError(
            f"{where} has {picture.width} x {picture.height} pixels, expected width / height = {wanted:.3f} "
            f"as in its {profile.width} x {profile.height} images; crop it to the sensor's view"
        )
    return np.array(picture.resize((profile.width, profile.height), Image.Resampling.BOX))


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
    ObjectFolder 2.0 and Isaac Lab use Taxim's tables. Raises ObjectFolderError if the file is not such a
    pack, or its pictures have another aspect ratio than the sensor's.
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
    resized = [scale_picture(Image.fromarray(image.astype(np.uint8)), profile, where) for image in pictures]
    circles = [
        (float(y + 0.5) * factor - 0.5, float(x + 0.5) * factor - 0.5, float(radius) * factor)
        for (x, y), radius in zip(centres, radii)
    ]
    rest = scale_picture(Image.fromarray(untouched.astype(np.uint8)), profile, where)
    return Pack(np.stack(resized), rest, circles)
