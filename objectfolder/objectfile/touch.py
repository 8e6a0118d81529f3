"""Touch of an Object File: poses of a tactile sensor in, tactile images and contacts out."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from objectfolder.checks import real_array, require_memory
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.arguments import Rows, Scalars, finite_rows, finite_scalars
from objectfolder.objectfile.reading import StoredNet, report_damage
from objectfolder.touch.contact import lean_normals
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import Touches

if TYPE_CHECKING:
    from objectfolder.nets.released.touch import ReleasedDepth
    from objectfolder.nets.touch_geometric import GeometricTouch

#: Voxels. The stored surface is no more accurate than this: contact points nearer to it stay where they are.
UNMOVED = 0.25

STEEPEST = math.pi / 2  #: greatest tilt, radians; beyond it the sensor faces away from the surface
MOST_TWIST = math.pi  #: greatest turn of a pressed object, radians

_ROUNDING = 1e-6  # radians; single precision rounds a right angle up


@dataclass(frozen=True)
class ContactPoses:
    """Poses of a tactile sensor in N contacts."""

    points: np.ndarray  #: (N, 3) contact points, object frame, metres
    depth: np.ndarray  #: (N,) how far the gel's apex is pressed past the surface, metres
    angle: np.ndarray  #: (N,) rotation about the outward contact normal, radians
    tilt: np.ndarray  #: (N,) lean from the contact normal, radians
    azimuth: np.ndarray  #: (N,) direction of the lean, from image up towards image right, radians

    @classmethod
    def checked(
        cls,
        points: Rows,
        depth: Scalars,
        angle: Scalars,
        tilt: Scalars,
        azimuth: Scalars,
        count: int = 1,
    ) -> "ContactPoses":
        """Check the arguments of a query; a number serves all contacts, and a single point all numbers.

        Parameters
        ----------
        count : int
            Contacts that other arguments of the query are given for.

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite, or a sensor faces away from the surface.
        """
        places = finite_rows("points", points, 3)
        named = {"depth": depth, "angle": angle, "tilt": tilt, "azimuth": azimuth}
        if len(places) == 1:
            sizes = (real_array(name, values).size for name, values in named.items())
            places = np.repeat(places, max(count, *sizes), 0)
        found = {name: finite_scalars(name, of, len(places)) for name, of in named.items()}
        _require_angles("tilt", found["tilt"], STEEPEST)
        return cls(places, **found)

    def at(self, points: np.ndarray) -> "ContactPoses":
        """Return the same poses at other points (N, 3)."""
        return replace(self, points=points)

    def leaned(self, normals: np.ndarray) -> np.ndarray:
        """Return the sensor's outward axes (N, 3) at points with these contact normals (N, 3)."""
        if not self.tilt.any():
            return normals
        leaned: np.ndarray = lean_normals(normals, self.angle, self.tilt, self.azimuth)
        return leaned


@dataclass(frozen=True)
class SidewaysMotion:
    """Motion of N pressed objects against the sensor."""

    shear: np.ndarray  #: (N, 2) along image right and image up, metres
    twist: np.ndarray  #: (N,) about the sensor's axis, anticlockwise in the image, radians
    friction: np.ndarray  #: (N,) coefficients


def sideways_motion(
    shear: Rows | None, twist: Scalars, friction: Scalars, count: int, profile: SensorProfile
) -> SidewaysMotion:
    """Check the arguments of a sheared press; one row or number serves all contacts.

    Raises
    ------
    ObjectFolderError
        If shapes do not fit, values are not finite, a shear is longer than the sensor's gel can be pressed
        in, a twist is beyond half a turn, or a friction is negative.
    """
    rows = np.zeros((1, 2)) if shear is None else finite_rows("shear", shear, 2)
    if len(rows) not in (1, count):
        raise ObjectFolderError(f"shear has {len(rows)} rows, expected one or {count} of them")
    lengths, longest = np.hypot(*rows.T), profile.max_indentation
    far = np.flatnonzero(lengths > longest)
    if len(far):
        raise ObjectFolderError(
            f"shear: row {far[0]} is {lengths[far[0]]:g} m long, expected at most {longest:g} m, the "
            f"maximal indentation of sensor {profile.name!r}; shears are in metres"
        )
    turns = finite_scalars("twist", twist, count)
    _require_angles("twist", turns, MOST_TWIST)
    coefficients = finite_scalars("friction", friction, count)
    wrong = np.flatnonzero(coefficients < 0)
    if len(wrong):
        raise ObjectFolderError(f"friction: row {wrong[0]} is {coefficients[wrong[0]]:g}, expected 0 or more")
    return SidewaysMotion(np.broadcast_to(rows, (count, 2)), turns, coefficients)


def _require_angles(name: str, values: np.ndarray, most: float) -> None:
    """Raise ObjectFolderError if an angle is beyond a limit in either direction, as one in degrees is."""
    wrong = np.flatnonzero(np.abs(values) > most + _ROUNDING)
    if len(wrong):
        raise ObjectFolderError(
            f"{name}: row {wrong[0]} is {values[wrong[0]]:g} rad, expected at most {most:.3g} either way; "
            "angles are in radians"
        )


@dataclass(frozen=True)
class FixedContact:
    """The one press that a net of images answers, whatever the point."""

    depth: float  #: metres
    angle: float  #: radians

    @classmethod
    def of(cls, config: dict[str, Any]) -> "FixedContact | None":
        """Return that of a net's configuration; None if the net answers any press."""
        return cls(float(config["press_depth"]), float(config["angle"])) if "press_depth" in config else None

    def require(self, contacts: ContactPoses) -> None:
        """Raise ObjectFolderError unless the contacts are of this depth and angle, without a tilt."""
        for name, known in {"depth": self.depth, "angle": self.angle, "tilt": 0.0}.items():
            values = getattr(contacts, name)
            wrong = np.flatnonzero(np.abs(values - known) > 1e-6)
            if len(wrong):
                raise ObjectFolderError(
                    f"{name}: row {wrong[0]} is {values[wrong[0]]:g}; a touch net of kind image is a "
                    f"function of the point alone, trained at depth {self.depth:g} m, "
                    f"angle {self.angle:g}, tilt 0; "
                    "a net of kind geometric answers others (train_touch.net: geometric)"
                )


class TouchSense(Protocol):
    """What an Object File asks a touch net of any kind. A profile of None is the stored sensor's."""

    def images(self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None) -> np.ndarray:
        """Return tactile images; (N, H, W, 3) uint8, RGB."""

    def touches(
        self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None
    ) -> Iterator[Touches]:
        """Return everything about the contacts in order, a few at a time; one empty answer if N is 0.

        Raises
        ------
        ObjectFolderError
            At once, if a contact is not possible or a point is off the surface.
        """

    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the least and the greatest of a sensor's usual press depths that it answers, metres."""

    def shown(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Return images (N, H, W, 3) of a gel displaced by (N, H, W) metres; of a profile of `touches`."""

    def depth_maps(self, contacts: ContactPoses, tolerance: float) -> np.ndarray:
        """Return depth maps of the released sensor, metres; (N, 120, 160) float32."""


def touch_sense(stored: StoredNet) -> TouchSense:
    """Load a touch net. The code of a kind is imported when a file holds it."""
    if stored.kind == "geometric":
        return GeometricSense(stored)
    if stored.kind == "image":
        from objectfolder.nets.touch_image import ImageTouch

        return ImageSense(stored.load(ImageTouch), stored)
    from objectfolder.nets.released.registry import released_net

    net = stored.load(released_net(stored.kind))
    return ImageSense(net, stored) if stored.kind == "released_image" else DepthMapSense(net, stored)


class GeometricSense:
    """Touch by simulating the sensor on the stored surface."""

    def __init__(self, stored: StoredNet):
        from objectfolder.nets.touch_geometric import GeometricTouch

        self._key, self._surface = stored.key, stored.surface
        surface, scale = stored.surface.read(), stored.surface.scale
        with report_damage(stored.key, "touch net"):
            self.net: GeometricTouch = GeometricTouch.from_tensors(
                surface, scale, stored.tensors, stored.config, stored.device
            )

    def images(self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None) -> np.ndarray:
        """Return tactile images; (N, H, W, 3) uint8, RGB."""
        return _concatenate_images(self.touches(contacts, tolerance, profile), len(contacts.points))

    def touches(
        self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None
    ) -> Iterator[Touches]:
        """Return everything about the contacts, a few at a time."""
        net = self.net if profile is None else self.net.with_sensor(profile)
        points = self.feet(contacts, tolerance, net)
        return net.touches(points, contacts.leaned(net.normals(points)), contacts.angle, contacts.depth)

    def feet(self, contacts: ContactPoses, tolerance: float, net: "GeometricTouch") -> np.ndarray:
        """Return the points of contacts on the surface (N, 3), object frame, metres.

        Raises
        ------
        ObjectFolderError
            If a point is off the surface, or a depth is not one of the net's sensor.
        """
        depth, limit = contacts.depth, net.profile.max_indentation
        wrong = np.flatnonzero((depth < 0) | (depth > limit))
        if len(wrong):
            raise ObjectFolderError(
                f"depth: row {wrong[0]} is {depth[wrong[0]]:g} m; the sensor {net.profile.name!r} takes "
                f"0 to {limit:g} m"
            )
        return self._surface.snap(contacts.points, tolerance, UNMOVED)

    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the sensor's usual press depths, metres."""
        return profile.press_depth

    def shown(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Return images of a displaced gel."""
        net = self.net if profile == self.net.profile else self.net.with_sensor(profile)
        return net.shown(displacement)

    def depth_maps(self, contacts: ContactPoses, tolerance: float) -> np.ndarray:
        """Refuse: there is no released sensor."""
        raise _no_depth_maps(self._key)


class ImageNet(Protocol):
    """Net from a point to a tactile image."""

    def images(self, points: np.ndarray) -> np.ndarray:
        """Tactile images (N, H, W, 3), uint8, at (N, 3) points of the unit frame."""


class ImageSense:
    """Touch by a net that stores the images of one press."""

    def __init__(self, net: ImageNet, stored: StoredNet):
        fixed = FixedContact.of(stored.config)
        assert fixed is not None
        self.net, self._fixed = net, fixed
        self._key, self._surface = stored.key, stored.surface

    def images(self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None) -> np.ndarray:
        """Return tactile images of the stored sensor; (N, H, W, 3) uint8, RGB."""
        if profile is not None:
            raise self._images_only()
        self._fixed.require(contacts)
        points = self._surface.snap(contacts.points, tolerance)
        return self.net.images(self._surface.to_unit(points))

    def touches(
        self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None
    ) -> Iterator[Touches]:
        """Refuse: the net stores images alone."""
        raise self._images_only()

    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the one press depth, metres."""
        return self._fixed.depth, self._fixed.depth

    def shown(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Refuse: the net stores images alone."""
        raise self._images_only()

    def depth_maps(self, contacts: ContactPoses, tolerance: float) -> np.ndarray:
        """Refuse: the net stores images alone."""
        raise _no_depth_maps(self._key)

    def _images_only(self) -> ObjectFolderError:
        return ObjectFolderError(
            f"{self._key}: its touch net stores images of one sensor, no shapes or forces; "
            "train_touch.net: geometric answers with them, and for other sensors"
        )


class DepthMapSense:
    """Touch by pressing a sensor's gel into the depth maps that a released net stores."""

    def __init__(self, net: "ReleasedDepth", stored: StoredNet):
        self.net, self._surface = net, stored.surface

    def images(self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None) -> np.ndarray:
        """Return tactile images; (N, H, W, 3) uint8, RGB."""
        return _concatenate_images(self.touches(contacts, tolerance, profile), len(contacts.points))

    def touches(
        self, contacts: ContactPoses, tolerance: float, profile: SensorProfile | None
    ) -> Iterator[Touches]:
        """Return everything about the contacts, one at a time."""
        turned = np.flatnonzero(contacts.angle)
        if len(turned):
            raise ObjectFolderError(
                f"angle: row {turned[0]} is {contacts.angle[turned[0]]:g}; a released touch net knows tilt, "
                "no rotation"
            )
        return self.net.touches(*self._pressed(contacts, tolerance), profile)

    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the sensor's usual press depths that the net was trained on, metres."""
        return self.net.press_range(profile)

    def shown(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Return images of a displaced gel."""
        return self.net.shown(displacement, profile)

    def depth_maps(self, contacts: ContactPoses, tolerance: float) -> np.ndarray:
        """Return depth maps of the released sensor, metres; (N, 120, 160) float32."""
        return self.net.depth_maps(*self._pressed(contacts, tolerance))

    def _pressed(
        self, contacts: ContactPoses, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points in the unit frame, depths, tilts and azimuths."""
        self.net.require(contacts.depth, contacts.tilt)
        points = self._surface.to_unit(self._surface.snap(contacts.points, tolerance))
        return points, contacts.depth, contacts.tilt, contacts.azimuth


def concatenate_touches(parts: Iterator[Touches], count: int) -> Touches:
    """Join answers of one sensor to ``count`` contacts.

    Raises
    ------
    ObjectFolderError
        If they do not fit into memory.
    """
    first = next(parts)
    names = [field.name for field in fields(Touches) if field.name != "profile"]
    _require_room([getattr(first, name) for name in names], count)
    parts = itertools.chain([first], parts)
    rows = zip(*([getattr(part, name) for name in names] for part in parts))
    return Touches(**dict(zip(names, map(np.concatenate, rows))), profile=first.profile)


def _concatenate_images(parts: Iterator[Touches], count: int) -> np.ndarray:
    first = next(parts).images
    _require_room([first], count)
    return np.concatenate([first, *(part.images for part in parts)])


def _require_room(arrays: list[np.ndarray], count: int) -> None:
    """Refuse ``count`` rows of such arrays, and their concatenation, if memory does not suffice."""
    row = sum(array[:1].nbytes for array in arrays)
    require_memory(f"{count} contacts", 2 * row * count, "ask for fewer at a time, or use ObjectFile.touches")


def _no_depth_maps(key: str) -> ObjectFolderError:
    return ObjectFolderError(
        f"{key}: its touch net stores no depth maps, as those of imported 2.0 files; press() gives heights"
    )
