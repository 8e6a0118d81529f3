"""TouchNet ``geometric``: the stored surface is pressed into a stored sensor.

A net from position to image memorises the training contacts (29 dB in the paper, less off them). The
geometry is in the Object File already, so a touch is simulated from it; what is fitted to images is the
one number that quantising the surface makes uncertain, the effective press depth, and for TACTO's images how
smooth its normals are.
"""

import threading
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, require_renderer
from objectfolder.touch.simulate import Touches, press

if TYPE_CHECKING:
    from objectfolder.touch.tacto_rays import TactoRays


_OTHERS = 8  # sensors that are kept beside the stored one: their optics take as long as a touch
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
    smoothing : int
        Rounds in which normals of the stored surface are averaged for renderer tacto. TACTO draws a mesh with
        interpolated vertex normals, which its triangles make smoother than the surface is.
    device : str or torch.device
        Where images of renderer gel are drawn. Rays and gels stay on the CPU.
    """

    _rays: "TactoRays | None"

    def __init__(
        self,
        surface: Isosurface,
        scale: float,
        profile: SensorProfile,
        depth_offset: float = 0.0,
        renderer: str = "gel",
        background: np.ndarray | None = None,
        smoothing: int = 0,
        device: str | torch.device = "cpu",
    ):
        self.surface = surface
        self.scale = scale
        self.profile = profile
        self.depth_offset = depth_offset
        self.renderer = renderer
        self._other, self._lock = lru_cache(_OTHERS)(self._new_other), threading.Lock()
        self._optics = Optics(profile, device)
        if background is not None:
            self._optics.background = torch.from_numpy(np.array(background))
        require_renderer(profile, renderer)
        self.smooth(smoothing)

    def smooth(self, rounds: int) -> None:
        """Set ``smoothing``."""
        self.smoothing = rounds
        self._rays = None
        if self.renderer == "tacto":
            # Here, because they load SciPy's sparse matrices, which no other touch needs.
            from objectfolder.mesh.normals import averaged
            from objectfolder.touch.tacto_rays import TactoRays, smooth_normals

            vertices, faces = self.surface.vertices, self.surface.faces
            normals = averaged(smooth_normals(vertices, faces), faces, rounds)
            self._rays = TactoRays(vertices, faces, self.profile, self.scale, normals)
            self._rays.background = self._optics.background.cpu().numpy()

    def with_sensor(self, profile: SensorProfile) -> "GeometricTouch":
        """Press another sensor on the same surface; its gel is rendered, whatever the renderer was."""
        with self._lock:  # threads that come here together get the same
            return self._other(profile)

    def _new_other(self, profile: SensorProfile) -> "GeometricTouch":
        return GeometricTouch(
            self.surface, self.scale, profile, self.depth_offset, device=self._optics.device
        )

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
                images = self._optics.render(torch.from_numpy(contacts.displacement)).cpu().numpy()
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
            tensors["background"] = self._optics.background.cpu().numpy()
            sensor |= {"background_image": "", "background_sha256": ""}
        return tensors, {
            "sensor": sensor,
            "depth_offset": self.depth_offset,
            "renderer": self.renderer,
            "smoothing": self.smoothing,
        }

    @classmethod
    def from_tensors(
        cls,
        surface: Isosurface,
        scale: float,
        tensors: dict[str, np.ndarray],
        config: dict[str, Any],
        device: str | torch.device = "cpu",
    ) -> "GeometricTouch":
        """Inverse of `to_tensors`."""
        profile, background = SensorProfile.from_dict(config["sensor"]), tensors.get("background")
        if background is not None and background.shape != (profile.height, profile.width, 3):
            raise ValueError(f"background of shape {background.shape}")
        offset, smoothing = float(config["depth_offset"]), int(config["smoothing"])
        return cls(surface, scale, profile, offset, config["renderer"], background, smoothing, device)
