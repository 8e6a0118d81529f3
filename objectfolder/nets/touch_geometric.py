"""TouchNet ``geometric``: the stored surface is pressed into a stored sensor.

A net from position to image memorises the training contacts (29 dB in the paper, less off them). The
geometry is in the Object File already, so a touch is simulated from it; what is fitted to images is the
one number that quantising the surface makes uncertain, the effective press depth.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.fit import CurvePoint
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, require_renderer
from objectfolder.touch.simulate import Touches, press
from objectfolder.touch.tacto_rays import TactoRays

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
    renderer : {"gel", "tacto"}
        Who draws the images; see `objectfolder.touch.dataset.render_contacts`.
    background : (H, W, 3) uint8 array, optional
        The untouched sensor; default: what the profile says.
    """

    def __init__(
        self,
        surface: Isosurface,
        scale: float,
        profile: SensorProfile,
        depth_offset: float = 0.0,
        renderer: str = "gel",
        background: np.ndarray | None = None,
    ):
        self.surface = surface
        self.scale = scale
        self.profile = profile
        self.depth_offset = depth_offset
        self.renderer = renderer
        self._optics = Optics(profile)
        if background is not None:
            self._optics.background = torch.from_numpy(np.array(background))
        require_renderer(profile, renderer)
        self._rays: TactoRays | None = None
        if renderer == "tacto":
            self._rays = TactoRays(surface.vertices, surface.faces, profile, scale)
            self._rays.background = self._optics.background.numpy()

    def with_sensor(self, profile: SensorProfile) -> "GeometricTouch":
        """Press another sensor on the same surface; its gel is rendered, whatever the renderer was."""
        return GeometricTouch(self.surface, self.scale, profile, self.depth_offset)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Contact normals at (N, 3) points of the object frame; (N, 3)."""
        distance, places = self.surface.grid.smooth_distance, np.asarray(points, np.float64) / self.scale
        parts = [places[i : i + _BATCH] for i in range(0, max(len(places), 1), _BATCH)]
        return np.concatenate([contact_normals(distance, part, NORMAL_RADIUS) for part in parts])

    def touches(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> Iterator[Touches]:
        """Everything about contacts, a few at a time; arguments as in `heightmaps`, object frame."""
        pressed = np.clip(depths + self.depth_offset, 0, self.profile.max_indentation)
        for start in range(0, max(len(pressed), 1), _BATCH):
            part = slice(start, start + _BATCH)
            contact = points[part], normals[part], angles[part], pressed[part]
            contacts = press(self.surface.caster, *contact, self.profile, self.scale)
            if self._rays is None:
                images = self._optics.render(torch.from_numpy(contacts.displacement)).numpy()
            else:
                images, _ = self._rays.render(*contact)
            yield Touches(**vars(contacts), images=images, profile=self.profile)

    def images(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> np.ndarray:
        """Tactile images; arguments as in `heightmaps`, object frame; (N, H, W, 3) uint8."""
        return np.concatenate([part.images for part in self.touches(points, normals, angles, depths)])

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Tensors and configuration: what is stored, besides the surface.

        A background picture goes along as a tensor, so that no other file is needed.
        """
        sensor = self.profile.to_dict()
        tensors = {}
        if self.profile.background_image:
            tensors["background"] = self._optics.background.numpy()
            sensor |= {"background_image": "", "background_sha256": ""}
        config = {"sensor": sensor, "depth_offset": self.depth_offset, "renderer": self.renderer}
        return tensors, config

    @classmethod
    def from_tensors(
        cls, surface: Isosurface, scale: float, tensors: dict[str, np.ndarray], config: dict[str, Any]
    ) -> "GeometricTouch":
        """Inverse of `to_tensors`."""
        profile, background = SensorProfile.from_dict(config["sensor"]), tensors.get("background")
        if background is not None and background.shape != (profile.height, profile.width, 3):
            raise ValueError(f"background of shape {background.shape}")
        offset = float(config["depth_offset"])
        return cls(surface, scale, profile, offset, config["renderer"], background)


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

    train, val = (c | {"normals": net.normals(c["points"])} for c in (train, val))

    def loss(offset: float, contacts: dict[str, np.ndarray]) -> float:
        net.depth_offset = offset
        normals = contacts["normals"]
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
