"""Touch nets by kind, as an Object File asks them."""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from typing_extensions import override  # the standard one is there since Python 3.12

from objectfolder.base.checks import refuse_rows
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.recent import Recent
from objectfolder.stored.reading import StoredNet, report_damage
from objectfolder.stored.surface import UNMOVED
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.query import ContactPoses, FixedContact, TouchSense
from objectfolder.touch.simulate import Touches

if TYPE_CHECKING:
    from objectfolder.touch.batched_press import BatchedPress
    from objectfolder.touch.geometric_net import GeometricTouch
    from objectfolder.touch.released_images import ReleasedDepth

LARGE = 64  #: contacts from which a GPU simulates them
_SENSORS = 4  # that are kept ready on a GPU


def touch_sense(stored: StoredNet) -> TouchSense:
    """Load a touch net."""
    return SENSES[stored.answers](stored)


def has_fast_rays(device: torch.device) -> bool:
    """Return whether a device casts rays faster than Embree: a CUDA device, if Warp is installed."""
    return device.type == "cuda" and find_spec("warp") is not None


class GeometricSense(TouchSense):
    """Touch by simulating the sensor on the stored surface.

    On a CUDA device with Warp (extra ``batch``), calls of `LARGE` contacts or more are simulated there. They
    agree with others to the tolerance of the gel's iteration, not to the bit.
    """

    def __init__(self, stored: StoredNet):
        from objectfolder.touch.geometric_net import GeometricTouch

        self.key, self._surface = stored.key, stored.surface
        self._batches: Recent[BatchedPress] = Recent(_SENSORS)
        surface, scale = stored.surface.read(), stored.surface.scale
        with report_damage(stored.key, "touch net"):
            self.net: GeometricTouch = GeometricTouch.from_tensors(
                surface, scale, stored.tensors, stored.config, stored.device
            )

    @override
    def touches(self, contacts: ContactPoses, profile: SensorProfile | None) -> Iterator[Touches]:
        net = self.net if profile is None else self.net.with_sensor(profile)
        points = self.snap(contacts, net)
        outward = contacts.lean(net.normals(points))
        if len(points) < LARGE or net.renderer != "gel" or not has_fast_rays(net.device):
            return net.touches(points, outward, contacts.angle, contacts.depth)
        from objectfolder.touch.batched_press import BatchedPress

        given = [net.surface], net.profile, net.device, net.background
        presses = self._batches.of(net.profile, lambda: BatchedPress(*given))
        frames = sensor_frames(outward, contacts.angle)
        return presses.touches(points, frames, net.pressed(contacts.depth), net.scale)

    def snap(self, contacts: ContactPoses, net: "GeometricTouch") -> np.ndarray:
        """Return the points of contacts on the surface (N, 3), object frame, metres.

        Raises ObjectFolderError if a point is off the surface, or a depth is not one of the net's sensor.
        """
        depth, limit = contacts.depth, net.profile.max_indentation
        takes = f" m; the sensor {net.profile.name!r} takes 0 to {limit:g} m"
        refuse_rows("depth", (depth < 0) | (depth > limit), depth, takes)
        return self._surface.snap(contacts.points, contacts.tolerance, UNMOVED)

    @override
    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        return profile.press_depth

    @override
    def draw_gel(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        net = self.net if profile == self.net.profile else self.net.with_sensor(profile)
        return net.shown(displacement)

    @override
    def background(self, profile: SensorProfile) -> np.ndarray:
        return self.net.background.cpu().numpy().copy()


class ImageNet(Protocol):
    """Net from a point to a tactile image."""

    def images(self, points: np.ndarray) -> np.ndarray:
        """Tactile images (N, H, W, 3), uint8, at (N, 3) points of the unit frame."""


class ImageSense(TouchSense):
    """Touch by a net that stores the images of one press."""

    def __init__(self, stored: StoredNet):
        fixed = FixedContact.of(stored.config)
        assert fixed is not None
        self.net: ImageNet = stored.load()
        self._fixed = fixed
        self.key, self._surface = stored.key, stored.surface

    @override
    def images(self, contacts: ContactPoses, profile: SensorProfile | None) -> np.ndarray:
        if profile is not None:
            raise self._images_only()
        self._fixed.require(contacts)
        points = self._surface.snap(contacts.points, contacts.tolerance)
        return self.net.images(self._surface.to_unit(points))

    @override
    def touches(self, contacts: ContactPoses, profile: SensorProfile | None) -> Iterator[Touches]:
        raise self._images_only()

    @override
    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        return self._fixed.depth, self._fixed.depth

    @override
    def draw_gel(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        raise self._images_only()

    def _images_only(self) -> ObjectFolderError:
        return ObjectFolderError(
            f"{self.key}: its touch net stores images of one sensor, no shapes or forces; for these and for "
            "other sensors, build the object with train_touch.net: geometric"
        )


class DepthMapSense(TouchSense):
    """Touch by pressing a sensor's gel into the depth maps that a released net stores."""

    def __init__(self, stored: StoredNet):
        self.net: ReleasedDepth = stored.load()
        self.key, self._surface = stored.key, stored.surface

    @override
    def touches(self, contacts: ContactPoses, profile: SensorProfile | None) -> Iterator[Touches]:
        angle = contacts.angle
        refuse_rows("angle", angle != 0, angle, "; a released touch net knows tilt, no rotation")
        return self.net.touches(*self._arguments(contacts), profile)

    @override
    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        return self.net.press_range(profile)

    @override
    def draw_gel(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        return self.net.draw_gel(displacement, profile)

    @override
    def depth_maps(self, contacts: ContactPoses) -> np.ndarray:
        return self.net.depth_maps(*self._arguments(contacts))

    def _arguments(self, contacts: ContactPoses) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points in the unit frame, depths, tilts and azimuths."""
        self.net.require(contacts.depth, contacts.tilt)
        points = self._surface.to_unit(self._surface.snap(contacts.points, contacts.tolerance))
        return points, contacts.depth, contacts.tilt, contacts.azimuth


#: By what a net answers.
SENSES: dict[str, type[GeometricSense | ImageSense | DepthMapSense]] = {
    "contacts": GeometricSense,
    "images": ImageSense,
    "depth maps": DepthMapSense,
}
