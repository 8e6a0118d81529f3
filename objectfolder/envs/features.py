"""What a policy is told of a touch: features of tactile images, asked of the Object File or kept."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from objectfolder.envs.fingers import Presses, feel, sensor_profile
from objectfolder.io import read_npz, write_npz
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.optics import Optics

PROBE = 0.0015  #: depth at which fingers feel, m
FEATURES = (8, 6)  #: height and width of what a tactile image is averaged to
CONTRAST = 16.0  #: of features: differences of images, which are small; their bound

Feel = Callable[[Presses], np.ndarray]


class TouchFeatures:
    """Features of tactile images: how they differ from those of an untouched sensor, averaged.

    Parameters
    ----------
    file : ObjectFile
    """

    size = 3 * FEATURES[0] * FEATURES[1]

    def __init__(self, file: ObjectFile):
        self._file = file
        #: the image without a touch; (H, W, 3) uint8
        self.untouched = Optics(sensor_profile(file)).background.numpy()

    def images(self, pressed: Presses) -> np.ndarray:
        """(M, H, W, 3) uint8."""
        return feel(self._file, pressed, np.full(len(pressed.points), PROBE))

    def __call__(self, pressed: Presses) -> np.ndarray:
        """(M, size) float32."""
        if not len(pressed.points):
            return np.zeros((0, self.size), np.float32)
        change = (torch.from_numpy(self.images(pressed)).float() - torch.from_numpy(self.untouched)) / 255
        pooled = torch.nn.functional.adaptive_avg_pool2d(change.permute(0, 3, 1, 2), FEATURES)
        return (CONTRAST * pooled.flatten(1)).clamp(-CONTRAST, CONTRAST).numpy()


class TouchBank:
    """Features of many presses, kept; a question gets those of the nearest, which is a thousand times faster.

    Parameters
    ----------
    pressed : Presses
        What is kept, (M, ...) rows.
    features : (M, F) array
    """

    _PLACE, _LEAN = 0.002, 0.05  # m and unit vectors, which count as equally far

    def __init__(self, pressed: Presses, features: np.ndarray):
        self.pressed, self.features = pressed, features
        self._tree = cKDTree(self._place(pressed))

    def __call__(self, pressed: Presses) -> np.ndarray:
        """Features of the nearest presses that are kept; (N, F)."""
        if not len(pressed.points):
            return np.zeros((0, self.features.shape[1]), np.float32)
        return self.features[self._tree.query(self._place(pressed))[1]]

    def save(self, path: str | Path, source: str) -> None:
        """Write the bank, and what it was made of."""
        write_npz(path, **vars(self.pressed), features=self.features, source=np.array(source))

    @classmethod
    def load(cls, path: str | Path, source: str) -> "TouchBank | None":
        """Read a bank; None if it was made of something else."""
        names = ("points", "outward", "up", "features", "source")
        stored = read_npz(path, *names)
        if str(stored["source"]) != source:
            return None
        return cls(Presses(*(stored[name] for name in names[:3])), stored["features"])

    def _place(self, pressed: Presses) -> np.ndarray:
        return np.c_[pressed.points / self._PLACE, pressed.outward / self._LEAN]
