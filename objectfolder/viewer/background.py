"""Pictures of untouched sensors, small enough for a page."""

import base64
import lzma

import numpy as np

from objectfolder.touch.photographs import read_photograph
from objectfolder.touch.profiles import SensorProfile

#: Levels of 255 between the values that are kept; finer ones would fill the page with the photographs' noise.
STEP = 5
_FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]


def pack_background(profile: SensorProfile) -> str:
    """Return a profile's background as ``viewer/core/background.ts`` unpacks it, within 2 levels of 255.

    It is an xz stream in base64: multiples of `STEP`, of which all rows after the first are differences,
    modulo 256, to the row above.
    """
    picture = read_photograph(profile.background_image, profile)
    steps = (picture + np.uint16(STEP // 2)) // STEP
    rows = np.diff(steps.astype(np.uint8), axis=0, prepend=np.uint8(0))
    return base64.b64encode(lzma.compress(rows.tobytes(), filters=_FILTERS)).decode()
