"""Pictures taken by a real sensor."""

from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.errors import ObjectFolderError
from objectfolder.pictures import decoded
from objectfolder.touch.profiles import SensorProfile

_ASPECT_TOLERANCE = 0.01  # relative, of width / height


def read_photograph(path: str | Path, profile: SensorProfile) -> np.ndarray:
    """Read a picture of a sensor and scale it to the profile's image size; (H, W, 3) uint8, RGB.

    Raises
    ------
    ObjectFolderError
        If the file is missing, is not a picture, or has another aspect ratio than the sensor's images.
    """
    where = f"picture {path} of sensor {profile.name!r}"
    if not Path(path).is_file():
        raise ObjectFolderError(f"{where} does not exist; expected a PNG or JPEG file")
    return scaled(decoded(Path(path), where), profile, where)


def scaled(picture: Image.Image, profile: SensorProfile, where: str) -> np.ndarray:
    """Scale a picture to the profile's image size; (H, W, 3) uint8, RGB. Errors begin with ``where``."""
    wanted = profile.width / profile.height
    if abs(picture.width / picture.height / wanted - 1) > _ASPECT_TOLERANCE:
        raise ObjectFolderError(
            f"{where} has {picture.width} x {picture.height} pixels, expected width / height = {wanted:.3f} "
            f"as in its {profile.width} x {profile.height} images; crop it to the sensor's view"
        )
    return np.array(picture.resize((profile.width, profile.height), Image.Resampling.BOX))
