"""Vision nets by kind, as an Object File asks them."""

import copy
import threading
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.stored.arguments import finite_rows, usual_modes
from objectfolder.stored.reading import StoredNet, damaged_net, once, report_damage
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.picture import Drawer, Picture
from objectfolder.vision.query import VisionSense, require_near
from objectfolder.vision.view import Shader, draw

if TYPE_CHECKING:
    from objectfolder.vision.surface_net import Baked, SurfaceNet

_CHUNK = 2**17  # points whose base colours are evaluated at once


def vision_sense(stored: StoredNet) -> VisionSense:
    """Load a vision net."""
    return SENSES[stored.answers](stored)


class SurfaceSense(VisionSense):
    """Vision by shading the stored surface."""

    def __init__(self, stored: StoredNet):
        self.net: SurfaceNet = stored.load()
        self._stored = stored
        self._lock = threading.RLock()

    @property
    def surface(self) -> Isosurface:
        """The stored surface, unit frame."""
        return self._stored.surface.read()

    @once
    def baked(self) -> "Baked":
        """What the net knows of the surface alone, on the CPU."""
        surface = self.surface
        with report_damage(self._stored.key, "vision net"):
            return copy.deepcopy(self.net).cpu().bake(surface)

    @once
    def _shader(self) -> Shader:
        return self.net.shader(self.surface, self._stored.device, self.baked)

    @override
    def drawer(self, supersample: bool) -> Drawer:
        picture = partial(draw, self.surface, self._shader, supersample=supersample)
        return _refuse_damage(picture, self._stored.key)

    @usual_modes()
    @torch.no_grad()
    def base_colors(self, points: np.ndarray) -> np.ndarray:
        """Return base colours (N, 3), sRGB uint8, at (N, 3) points near the surface, unit frame."""
        points = finite_rows("points", points, 3)
        require_near("points", points)
        if not len(points):
            return np.zeros((0, 3), np.uint8)
        colors = []
        for part in torch.from_numpy(points.astype(np.float32)).to(self._stored.device).split(_CHUNK):
            color = self.net.base_colors(part)
            colors.append((255 * color.clamp(0, 1)).round().to(torch.uint8))
        return torch.cat(colors).cpu().numpy()


class VolumeSense(VisionSense):
    """Vision by a net that is rendered along rays; every pixel is the ray through its centre.

    These nets know point lights only: a distant light is one at distance 1, where they were trained.
    """

    def __init__(self, stored: StoredNet):
        picture: Drawer = stored.load().picture

        def draw_under_point(pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
            return picture(pose, light[:3], intrinsics)

        self._picture = _refuse_damage(draw_under_point, stored.key)

    @override
    def drawer(self, supersample: bool) -> Drawer:
        return self._picture


def _refuse_damage(drawer: Drawer, key: str) -> Drawer:
    """Return a drawer that refuses pictures that are not finite: weights of a damaged net can overflow."""

    def draw_checked(pose: np.ndarray, light: np.ndarray, intrinsics: Intrinsics) -> Picture:
        picture = drawer(pose, light, intrinsics)
        if not (np.isfinite(picture.rgba).all() and np.isfinite(picture.normals).all()):
            raise damaged_net(key, "vision")
        return picture

    return draw_checked


#: By what a net answers.
SENSES: dict[str, type[SurfaceSense | VolumeSense]] = {"surface": SurfaceSense, "pictures": VolumeSense}
