"""Features of touches for policies: queried from the Object File, or looked up in a bank."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.fingers import Presses, tactile_images

PROBE = 0.0015  #: press depth of a gentle touch, as far as the sensor allows it, m
FEATURES = (8, 6)  #: height and width of an averaged tactile image
CONTRAST = 16.0  #: gain of features, which are small differences of images, and their bound

FeatureFunction = Callable[[Presses], np.ndarray]  #: M presses -> (M, F) float32


class TouchFeatures:
    """Features of tactile images: their difference from the untouched sensor's image, averaged."""

    size = 3 * FEATURES[0] * FEATURES[1]

    def __init__(self, file: ObjectFile):
        self._file, self._depth = file, min(PROBE, file.sensor_profile.max_indentation)
        #: image of the untouched sensor; (H, W, 3) uint8
        self.untouched = file.sensor_background

    def images(self, pressed: Presses) -> np.ndarray:
        """Return tactile images at the depth `PROBE`, or of the one press of the net; (M, H, W, 3) uint8."""
        return tactile_images(self._file, pressed, np.full(len(pressed.points), self._depth))

    def __call__(self, pressed: Presses) -> np.ndarray:
        """Return features of presses; (M, size) float32."""
        if not len(pressed.points):
            return np.zeros((0, self.size), np.float32)
        change = _average(self.images(pressed)) - _average(self.untouched[None])
        return (CONTRAST * change).clamp(-CONTRAST, CONTRAST).numpy()


def _average(images: np.ndarray) -> torch.Tensor:
    """Average images of any size; (M, H, W, 3) uint8 -> (M, size), 0 to 1."""
    channels = torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255
    return torch.nn.functional.adaptive_avg_pool2d(channels, FEATURES).flatten(1)


class TouchBank:
    """Stored features (M, F) of M presses; a query gets those of the nearest, a thousand times faster."""

    _POINT, _OUTWARD = 0.002, 0.05  # differences that count as equally far: m, and of unit vectors

    def __init__(self, pressed: Presses, features: np.ndarray):
        self.pressed, self.features = pressed, features
        self._tree = cKDTree(self._scale_features(pressed))

    def __call__(self, pressed: Presses) -> np.ndarray:
        """Return features of the nearest stored presses; (N, F)."""
        if not len(pressed.points):
            return np.zeros((0, self.features.shape[1]), np.float32)
        return self.features[self._tree.query(self._scale_features(pressed))[1]]

    def save(self, path: str | Path, source: str) -> None:
        """Write the bank with the name of its source."""
        write_npz(path, **vars(self.pressed), features=self.features, source=np.array(source))

    @classmethod
    def load(cls, path: str | Path, source: str) -> "TouchBank | None":
        """Read a bank; None if it has another source."""
        names = ("points", "outward", "up", "features", "source")
        stored = read_npz(path, *names)
        if str(stored["source"]) != source:
            return None
        return cls(Presses(*(stored[name] for name in names[:3])), stored["features"])

    def _scale_features(self, pressed: Presses) -> np.ndarray:
        return np.c_[pressed.points / self._POINT, pressed.outward / self._OUTWARD]
