"""Rendered views: of one camera, as a net renders them, and as a batch for the user."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from objectfolder.vision.cameras import Intrinsics


@dataclass(frozen=True)
class Picture:
    """Rendered view of an object; arrays share (H, W).

    Depth and normal are those of one point, not means across a silhouette.
    """

    rgba: np.ndarray  #: (H, W, 4) float32, linear, premultiplied by alpha
    depth: np.ndarray  #: (H, W) float32, along the optical axis, unit frame; infinite where alpha is 0
    normals: np.ndarray  #: (H, W, 3) float32, of unit length, outward, unit frame; zero where alpha is 0


@dataclass(frozen=True)
class Views:
    """Batch of rendered views; arrays share (N, H, W)."""

    rgb: np.ndarray  #: (N, H, W, 3) float32, sRGB on white, in [0, 1]
    rgba: np.ndarray  #: (N, H, W, 4) float32, linear, premultiplied by alpha
    depth: np.ndarray  #: (N, H, W) float32, metres along the optical axis; infinite where alpha is 0
    normals: np.ndarray  #: (N, H, W, 3) float32, of unit length, outward, object frame; zero where alpha is 0

    @property
    def alpha(self) -> np.ndarray:
        """Coverage of each pixel by the object; (N, H, W) float32."""
        return self.rgba[..., 3]


#: Camera-to-world matrix (4, 4), light (3,) or (4,) and intrinsics -> the picture; `lighting.toward` tells
#: lights apart.
Drawer = Callable[[np.ndarray, np.ndarray, Intrinsics], Picture]
