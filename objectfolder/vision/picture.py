"""What a net answers for one view, and what draws it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from objectfolder.vision.cameras import Intrinsics


@dataclass(frozen=True)
class Picture:
    """One view of an object; arrays share (H, W)."""

    rgba: np.ndarray  #: (H, W, 4) float32, linear, premultiplied by alpha
    depth: np.ndarray  #: (H, W) float32, along the optical axis, unit frame; infinite where alpha is 0


#: Camera-to-world matrix (4, 4), light (3,) and intrinsics -> (H, W, 4) float32, linear, premultiplied.
Drawer = Callable[[np.ndarray, np.ndarray, Intrinsics], np.ndarray]
