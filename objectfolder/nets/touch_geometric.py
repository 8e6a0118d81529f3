"""TouchNet ``geometric``: the stored surface is pressed into a stored sensor.

A net from position to image memorises the training contacts (29 dB in the paper, less off them). The
geometry is in the Object File already, so a touch is simulated from it; what is fitted to images is the
one number that quantising the surface makes uncertain, the effective press depth.
"""

from typing import Any

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import touch_images

_BATCH = 16  # bounds the memory that contacts take beside their images


class GeometricTouch:
    """Tactile images of a stored surface.

    Parameters
    ----------
    surface : Isosurface
    scale : float
        Longest side, metres.
    profile : SensorProfile
    depth_offset : float
        Added to every press depth, metres.
    """

    def __init__(self, surface: Isosurface, scale: float, profile: SensorProfile, depth_offset: float = 0.0):
        self.surface = surface
        self.scale = scale
        self.profile = profile
        self.depth_offset = depth_offset
        self._optics = Optics(profile)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Contact normals at (N, 3) points of the object frame; (N, 3)."""

        def distance(p: np.ndarray) -> np.ndarray:
            return self.surface.grid.distance(torch.from_numpy(p)).numpy()

        return contact_normals(distance, np.asarray(points) / self.scale, NORMAL_RADIUS)

    def images(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> np.ndarray:
        """Tactile images; arguments as in `heightmaps`, object frame; (N, H, W, 3) uint8."""
        pressed = np.clip(depths + self.depth_offset, 0, self.profile.max_indentation)
        images = np.empty((len(pressed), self.profile.height, self.profile.width, 3), np.uint8)
        for start in range(0, len(pressed), _BATCH):
            part = slice(start, start + _BATCH)
            images[part], _ = touch_images(
                self.surface.caster,
                *(points[part], normals[part], angles[part], pressed[part]),
                self.profile,
                self._optics,
                self.scale,
            )
        return images

    def config(self) -> dict[str, Any]:
        """What is stored, besides the surface."""
        return {"sensor": self.profile.to_dict(), "depth_offset": self.depth_offset}

    @classmethod
    def from_config(cls, surface: Isosurface, scale: float, config: dict[str, Any]) -> "GeometricTouch":
        """Inverse of `config`."""
        return cls(surface, scale, SensorProfile.from_dict(config["sensor"]), float(config["depth_offset"]))


def fit_depth_offset(
    net: GeometricTouch,
    train: dict[str, np.ndarray],
    val: dict[str, np.ndarray],
    span: float,
    rounds: int,
    report=lambda point: None,
) -> list[CurvePoint]:
    """Choose the depth offset that reproduces training images best, by repeated bisection of a bracket.

    Parameters
    ----------
    net : GeometricTouch
        Its ``depth_offset`` is set.
    train, val : dict
        As `objectfolder.touch.dataset.render_contacts` returns.
    span : float
        Offsets from -span to span are searched, metres.
    rounds : int
        Each halves the bracket.
    report : callable
        Called with each `CurvePoint`; losses are mean squared errors of images in [0, 1].
    """

    def loss(offset: float, contacts: dict[str, np.ndarray]) -> float:
        net.depth_offset = offset
        normals = net.normals(contacts["points"])
        images = net.images(contacts["points"], normals, contacts["angles"], contacts["depths"])
        return float(np.mean((images / 255.0 - contacts["images"] / 255.0) ** 2))

    best, step = 0.0, span / 2
    best_loss = loss(best, train)
    curve = []
    for index in range(rounds):
        losses = {offset: loss(offset, train) for offset in (best - step, best + step)}
        candidate = min(losses, key=losses.__getitem__)
        if losses[candidate] < best_loss:
            best, best_loss = candidate, losses[candidate]
        step /= 2
        curve.append(CurvePoint(index + 1, best_loss, loss(best, val), 0.0))
        report(curve[-1])
    net.depth_offset = best
    return curve
