"""TouchNet ``geometric``: no neural net, but the stored surface, pressed into a stored sensor.

One number is fitted to images: an offset of the press depth, which compensates for the quantised surface; for
TACTO also how much the normals are smoothed. Everything else is simulated from the geometry that the Object
File holds. A net from position to image memorises the training contacts (29 dB in the paper, less elsewhere).
"""

import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.base.recent import Recent
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.storage import NetKind, real, whole
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, require_renderer
from objectfolder.touch.simulate import Touches, press

if TYPE_CHECKING:
    from objectfolder.touch.tacto_rays import TactoRays


_OTHERS = 8  # other sensors that are cached: making their optics takes as long as a touch
_BATCH = 16  # contacts simulated at once, to bound memory


class GeometricTouch:
    """Simulator of tactile images of a stored surface, of an object with a longest side of ``scale`` metres.

    Fitted are the ``depth_offset`` (metres), which is added to every press depth, and, for renderer tacto
    (`objectfolder.touch.truth.render_contacts`), the rounds of averaging the normals (`smooth`). The
    ``background`` (H, W, 3) uint8 is the image of the untouched sensor; default: that of the profile. The
    device is that of renderer gel: ray casting and gel deformation stay on the CPU.
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
        self.smooth(0)

    @property
    def background(self) -> torch.Tensor:
        """Image of the untouched sensor; (H, W, 3) uint8."""
        return self._optics.background

    def smooth(self, rounds: int) -> None:
        """Set the rounds of averaging the surface normals, for renderer tacto.

        TACTO interpolates the vertex normals of a mesh, which smooths them across each triangle.
        """
        self.smoothing = rounds
        self._rays = None

    def _tacto_rays(self) -> "TactoRays":
        """Return the renderer, made when it is first needed."""
        if self._rays is None:
            # Imported here, because they load scipy.sparse, which renderer gel does not need.
            from objectfolder.mesh.normals import average_normals
            from objectfolder.touch.tacto_rays import TactoRays, smooth_normals

            vertices, faces = self.surface.vertices, self.surface.faces
            normals = average_normals(smooth_normals(vertices, faces), faces, self.smoothing)
            rays = TactoRays(vertices, faces, self.profile, self.scale, normals)
            rays.background = self._optics.background.cpu().numpy()
            self._rays = rays
        return self._rays

    def with_sensor(self, profile: SensorProfile) -> "GeometricTouch":
        """Return the simulator of a sensor on the same surface; it always uses renderer gel.

        The stored sensor's own profile keeps the stored background, which the profile does not name.
        """
        with self._lock:  # concurrent threads get the same instance
            return self._others.of(profile, lambda: self._new_other(profile))

    def _new_other(self, profile: SensorProfile) -> "GeometricTouch":
        background = self.background.cpu().numpy() if profile == self.profile else None
        fitted, device = (self.depth_offset, "gel", background), self._optics.device
        return GeometricTouch(self.surface, self.scale, profile, *fitted, device)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Compute contact normals at (N, 3) points of the object frame; (N, 3)."""
        places = np.asarray(points, np.float64) / self.scale
        normals: np.ndarray = contact_normals(self.surface.grid.smooth_distance, places, NORMAL_RADIUS)
        return normals

    def touches(
        self, points: np.ndarray, normals: np.ndarray, angles: np.ndarray, depths: np.ndarray
    ) -> Iterator[Touches]:
        """Yield full results of contacts in batches; arguments as in `heightmaps`, object frame."""
        pressed = self.pressed(depths)
        for start in range(0, max(len(pressed), 1), _BATCH):
            part = slice(start, start + _BATCH)
            contact = points[part], normals[part], angles[part], pressed[part]
            contacts = press(self.surface.caster, *contact, self.profile, self.scale)
            if self.renderer == "tacto":
                images, _ = self._tacto_rays().render(*contact)
            else:
                images = self.shown(contacts.displacement)
            yield Touches(**vars(contacts), images=images, profile=self.profile)

    def pressed(self, depths: np.ndarray) -> np.ndarray:
        """Return the depths (N,) that the sensor is pressed to, with the offset."""
        out: np.ndarray = np.clip(depths + self.depth_offset, 0, self.profile.max_indentation)
        return out

    @property
    def device(self) -> torch.device:
        """Where images are computed."""
        return self._optics.device

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
        fitted = {name: getattr(self, name) for name in ("depth_offset", "renderer", "smoothing")}
        return tensors, {"sensor": sensor} | fitted

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
        background, shape = tensors.get("background"), (profile.height, profile.width, 3)
        if background is not None and background.shape != shape:
            raise ValueError(f"background of shape {background.shape}, expected {shape}")
        offset = float(config["depth_offset"])
        net = cls(surface, scale, profile, offset, config["renderer"], background, device)
        net.smooth(int(config["smoothing"]))
        return net


_SENSOR = {
    "type": "object",
    "required": ["name", "height", "width"],
    "properties": {
        "name": {"type": "string"},
        "height": whole(2, 2048, "image rows"),
        "width": whole(2, 2048, "image columns"),
        "lights": {"type": "array", "maxItems": 64},
    },
    "description": "a sensor profile; docs/sensors.md lists its fields",
}
KINDS = {
    "geometric": NetKind(
        GeometricTouch,
        "contacts",
        {
            "sensor": _SENSOR,
            "depth_offset": real(-0.1, 0.1, "metres, added to the press depth"),
            "renderer": {"enum": ["gel", "tacto"]},
            "smoothing": whole(0, 64, "rounds in which normals are averaged, for renderer tacto"),
        },
    )
}
