"""TouchNet ``geometric``: the stored surface is pressed into a stored sensor.

A net from position to image memorises the training contacts (29 dB in the paper, less elsewhere). The Object
File already holds the geometry, so a touch is simulated from it. Only two parameters are fitted to images:
an offset of the press depth, which compensates for the quantised surface, and, for TACTO, the smoothing of
the normals.
"""

import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.recent import Recent
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, require_renderer
from objectfolder.touch.simulate import Touches, press

if TYPE_CHECKING:
    from objectfolder.touch.tacto_rays import TactoRays


_OTHERS = 8  # other sensors that are cached: making their optics takes as long as a touch
_BATCH = 16  # contacts simulated at once, to bound memory


class GeometricTouch:
    """Simulator of tactile images of a stored surface.

    Parameters
    ----------
    surface : Isosurface
    scale : float
        Longest side, metres.
    profile : SensorProfile
    depth_offset : float
        Added to every press depth, metres.
    renderer : {"gel", "tacto"}
        Renderer of the images; see `objectfolder.touch.dataset.render_contacts`.
    background : (H, W, 3) uint8 array, optional
        Image of the untouched sensor; default: that of the profile.
    smoothing : int
        Rounds of averaging the surface normals, for renderer tacto. TACTO interpolates the vertex normals of
        a mesh, which smooths them across each triangle.
    device : str or torch.device
        Device of renderer gel. Ray casting and gel deformation stay on the CPU.
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
        self._others, self._lock = Recent[GeometricTouch](_OTHERS), threading.Lock()
        self._optics = Optics(profile, device)
        if background is not None:
            self._optics.background = torch.from_numpy(np.array(background))
        require_renderer(profile, renderer)
        self.smooth(smoothing)

    @property
    def background(self) -> torch.Tensor:
        """Image of the untouched sensor; (H, W, 3) uint8."""
        return self._optics.background

    def smooth(self, rounds: int) -> None:
        """Set ``smoothing`` and recompute the normals."""
        self.smoothing = rounds
        self._rays = None
        if self.renderer == "tacto":
            # Imported here, because they load scipy.sparse, which renderer gel does not need.
            from objectfolder.mesh.normals import average_normals
            from objectfolder.touch.tacto_rays import TactoRays, smooth_normals

            vertices, faces = self.surface.vertices, self.surface.faces
            normals = average_normals(smooth_normals(vertices, faces), faces, rounds)
            self._rays = TactoRays(vertices, faces, self.profile, self.scale, normals)
            self._rays.background = self._optics.background.cpu().numpy()

    def with_sensor(self, profile: SensorProfile) -> "GeometricTouch":
        """Return the simulator of a sensor on the same surface; it always uses renderer gel.

        The stored sensor's own profile keeps the stored background, which the profile does not name.
        """
        with self._lock:  # concurrent threads get the same instance
            return self._others.of(profile, lambda: self._new_other(profile))

    def _new_other(self, profile: SensorProfile) -> "GeometricTouch":
        background = self.background.cpu().numpy() if profile == self.profile else None
        return GeometricTouch(
            *(self.surface, self.scale, profile, self.depth_offset),
            background=background,
            device=self._optics.device,
        )

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Compute contact normals at (N, 3) points of the object frame; (N, 3)."""
        places = np.asarray(points, np.float64) / self.scale
        normals: np.ndarray = contact_normals(self.surface.grid.smooth_distance, places, NORMAL_RADIUS)
        return normals

    def touches(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> Iterator[Touches]:
        """Yield full results of contacts in batches; arguments as in `heightmaps`, object frame."""
        pressed = np.clip(depths + self.depth_offset, 0, self.profile.max_indentation)
        for start in range(0, max(len(pressed), 1), _BATCH):
            part = slice(start, start + _BATCH)
            contact = points[part], normals[part], angles[part], pressed[part]
            contacts = press(self.surface.caster, *contact, self.profile, self.scale)
            if self._rays is None:
                images = self.shown(contacts.displacement)
            else:
                images, _ = self._rays.render(*contact)
            yield Touches(**vars(contacts), images=images, profile=self.profile)

    def shown(self, displacement: np.ndarray) -> np.ndarray:
        """Return images (N, H, W, 3) of a gel displaced by (N, H, W) metres."""
        return self._optics.render(torch.from_numpy(displacement)).cpu().numpy()

    def images(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> np.ndarray:
        """Render tactile images, (N, H, W, 3) uint8; arguments as in `heightmaps`, object frame."""
        return np.concatenate([part.images for part in self.touches(points, normals, angles, depths)])

    def to_tensors(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return tensors and configuration for storing, without the surface.

        A background image is stored as a tensor, so that no other file is needed.
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
        """Invert `to_tensors`."""
        profile = SensorProfile.from_dict(config["sensor"], stored=True)
        background = tensors.get("background")
        if background is not None and background.shape != (profile.height, profile.width, 3):
            raise ValueError(
                f"background of shape {background.shape}, expected {(profile.height, profile.width, 3)}"
            )
        offset, smoothing = float(config["depth_offset"]), int(config["smoothing"])
        return cls(surface, scale, profile, offset, config["renderer"], background, smoothing, device)
