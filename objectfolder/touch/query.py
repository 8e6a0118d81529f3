"""Touch of an Object File: poses of a tactile sensor in, tactile images and contacts out."""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.checks import real_array, refuse_rows, require_memory
from objectfolder.base.errors import ObjectFolderError
from objectfolder.stored.arguments import (
    Answer,
    Rows,
    Scalars,
    each_in_usual_modes,
    finite_rows,
    finite_scalars,
    like_first,
    usual_modes,
)
from objectfolder.stored.reading import StoredObject, described_part
from objectfolder.stored.surface import TOLERANCE, UNMOVED, ObjectSurface
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals, lean_normals
from objectfolder.touch.markers import Markers
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.sheared import shear_touches
from objectfolder.touch.simulate import Touches

STEEPEST = math.pi / 2  #: greatest tilt, radians; beyond it the sensor faces away from the surface
MOST_TWIST = math.pi  #: greatest turn of a pressed object, radians

_ROUNDING = 1e-6  # radians; single precision rounds a right angle up

#: Name of a sensor profile that comes with the package, a ``.yaml`` file, or a profile; None: the stored one.
Sensor = str | Path | SensorProfile | None


@dataclass(frozen=True)
class ContactPoses:
    """Poses of a tactile sensor in N contacts."""

    points: np.ndarray  #: (N, 3) contact points, object frame, metres
    depth: np.ndarray  #: (N,) how far the gel's apex is pressed past the surface, metres
    angle: np.ndarray  #: (N,) rotation about the outward contact normal, radians
    tilt: np.ndarray  #: (N,) lean from the contact normal, radians
    azimuth: np.ndarray  #: (N,) direction of the lean, from image up towards image right, radians
    tolerance: float = TOLERANCE  #: greatest distance of a point from the surface, fraction of the size

    @classmethod
    def checked(
        cls,
        points: Rows,
        depth: Scalars,
        angle: Scalars,
        tilt: Scalars,
        azimuth: Scalars,
        tolerance: float = TOLERANCE,
        count: int = 1,
    ) -> "ContactPoses":
        """Check the arguments of a query; a number serves all contacts, and a single point all numbers.

        ``count`` is the number of contacts that other arguments of the query are given for. Raises
        ObjectFolderError if shapes do not fit, values are not finite, or a sensor faces away from the
        surface.
        """
        places = finite_rows("points", points, 3)
        named = {"depth": depth, "angle": angle, "tilt": tilt, "azimuth": azimuth}
        if len(places) == 1:
            sizes = (real_array(name, values).size for name, values in named.items())
            places = np.repeat(places, max(count, *sizes), 0)
        found = {name: finite_scalars(name, of, len(places)) for name, of in named.items()}
        _require_angles("tilt", found["tilt"], STEEPEST)
        return cls(places, **found, tolerance=tolerance)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: slice) -> "ContactPoses":
        """Return some of the contacts."""
        return replace(self, **{name: v[rows] for name, v in vars(self).items() if name != "tolerance"})

    def lean(self, normals: np.ndarray) -> np.ndarray:
        """Return the sensor's outward axes (N, 3) at points with these contact normals (N, 3)."""
        if not self.tilt.any():
            return normals
        leaned: np.ndarray = lean_normals(normals, self.angle, self.tilt, self.azimuth)
        return leaned


def checked_motion(
    shear: np.ndarray, twist: Scalars, friction: Scalars, count: int, profile: SensorProfile
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return shears (N, 2), twists (N,) and coefficients of friction (N,) of N contacts; one serves all.

    Raises ObjectFolderError if shapes do not fit, numbers are not finite, a shear is longer than the sensor's
    gel can be pressed in, a twist is beyond half a turn, or a friction is negative.
    """
    if len(shear) not in (1, count):
        raise ObjectFolderError(f"shear has {len(shear)} rows, expected one or {count} of them")
    lengths, longest = np.hypot(*shear.T), profile.max_indentation
    limit = f"at most {longest:g} m, the maximal indentation of sensor {profile.name!r}"
    refuse_rows("shear", lengths > longest, lengths, f" m long, expected {limit}; shears are in metres")
    turns = finite_scalars("twist", twist, count)
    _require_angles("twist", turns, MOST_TWIST)
    coefficients = finite_scalars("friction", friction, count)
    refuse_rows("friction", coefficients < 0, coefficients, ", expected 0 or more")
    return np.broadcast_to(shear, (count, 2)), turns, coefficients


def _require_angles(name: str, values: np.ndarray, most: float) -> None:
    """Raise ObjectFolderError if an angle is beyond a limit in either direction, as one in degrees is."""
    limit = f" rad, expected at most {most:.3g} either way; angles are in radians"
    refuse_rows(name, np.abs(values) > most + _ROUNDING, values, limit)


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
        trained = f"at depth {self.depth:g} m, angle {self.angle:g}, tilt 0"
        for name, known in {"depth": self.depth, "angle": self.angle, "tilt": 0.0}.items():
            values = getattr(contacts, name)
            said = f"; a touch net of kind image is a function of the point alone, trained {trained}; "
            other = "a net of kind geometric answers others (train_touch.net: geometric)"
            refuse_rows(name, np.abs(values - known) > 1e-6, values, said + other)


class TouchSense(ABC):
    """What an Object File asks a touch net of any kind. A profile of None is the stored sensor's."""

    key: str  #: of the object

    def images(self, contacts: ContactPoses, profile: SensorProfile | None) -> np.ndarray:
        """Return tactile images; (N, H, W, 3) uint8, RGB."""
        parts = self.touches(contacts, profile)
        first = next(parts).images
        _require_room([first], len(contacts))
        return np.concatenate([first, *(part.images for part in parts)])

    @abstractmethod
    def touches(self, contacts: ContactPoses, profile: SensorProfile | None) -> Iterator[Touches]:
        """Return everything about the contacts in order, a few at a time; one empty answer if N is 0.

        Raises ObjectFolderError at once, if a contact is not possible or a point is off the surface.
        """

    @abstractmethod
    def press_range(self, profile: SensorProfile) -> tuple[float, float]:
        """Return the least and the greatest of a sensor's usual press depths that it answers, metres."""

    @abstractmethod
    def draw_gel(self, displacement: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """Return images (N, H, W, 3) of a gel displaced by (N, H, W) metres; of a profile of `touches`."""

    def background(self, profile: SensorProfile) -> np.ndarray:
        """Return the image (H, W, 3) uint8 of the stored sensor, whose profile it is, without a contact."""
        return Optics(profile).background.numpy()

    def depth_maps(self, contacts: ContactPoses) -> np.ndarray:
        """Return depth maps of the released sensor, metres; (N, 120, 160) float32."""
        raise ObjectFolderError(
            f"{self.key}: its touch net stores no depth maps; only imported 2.0 files do. Use press(): its "
            "`height` is in metres"
        )


class TouchQueries(StoredObject):
    """How an object feels: part of `objectfolder.objectfile.file.ObjectFile`."""

    @property
    def sensor(self) -> str:
        """Name of the stored tactile sensor."""
        stored = described_part(self._parts.header, "touch")["net"]["sensor"]
        return str(stored if isinstance(stored, str) else stored["name"])

    @property
    def sensor_profile(self) -> SensorProfile:
        """Profile of the stored tactile sensor."""
        stored = described_part(self._parts.header, "touch")["net"]["sensor"]
        if isinstance(stored, str):
            return load_profile(stored)
        return SensorProfile.from_dict(stored, stored=True)

    @property
    @usual_modes()
    def sensor_background(self) -> np.ndarray:
        """Image of the stored tactile sensor while nothing touches it; (H, W, 3) uint8.

        A photographed background is stored with the net, and not named by `sensor_profile`.
        """
        return self.touch_sense.background(self.sensor_profile)

    @property
    def fixed_contact(self) -> FixedContact | None:
        """Depth and angle of the one press that the touch net answers, with images alone.

        None if it answers any press, with all that `press` returns.
        """
        return FixedContact.of(described_part(self._parts.header, "touch")["net"])

    @property
    @usual_modes()
    def touch_sense(self) -> TouchSense:
        """What answers `touch` and `press`, for sensors in any direction, also away from the surface."""
        sense: TouchSense = self._parts.touch
        return sense

    @usual_modes()
    def press_range(self, sensor: Sensor = None) -> tuple[float, float]:
        """Return the least and the greatest press depth of usual contacts of a sensor, as in `touch`, metres.

        They are the ``press_depth`` of the sensor's profile, as far as the touch net answers them: one of an
        imported 2.0 file answers 0.5 to 2 mm.
        """
        return self.touch_sense.press_range(_profile(sensor) or self.sensor_profile)

    @usual_modes()
    def touch(
        self,
        points: Answer | Sequence[Any],
        depth: Scalars | None = None,
        angle: Scalars | None = None,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
    ) -> Answer:
        """Press a tactile sensor on the object.

        A file on a CUDA device answers calls of 64 contacts or more there, if the extra ``batch`` is
        installed: to the tolerance of the gel's iteration as in smaller calls, not to the bit.

        Parameters
        ----------
        points : (N, 3) array
            Contact points, object frame, metres. Those within a voxel of the stored surface stay where
            they are; others are snapped to it. A single point serves all depths and angles.
        depth : float or (N,) array
            How far the gel's apex is pressed past the surface, metres. Default: 1 mm, or that of a net which
            knows one press alone (`fixed_contact`).
        angle : float or (N,) array
            Rotation of the sensor about the outward contact normal, radians. Default: 0, or as the depth.
        tilt, azimuth : float or (N,) array
            Lean of the sensor from the contact normal, at most a right angle, and its direction in the
            tangent plane (from image up towards image right), radians.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.
        sensor : str, Path or SensorProfile, optional
            Name of a profile that comes with the package, a ``.yaml`` file, or a profile. Default: the stored
            one.

        Returns
        -------
        (N, H, W, 3) uint8, RGB

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite, a depth is negative or beyond the gel, a tilt is
            beyond a right angle, a point is off the surface, or the touch net does not know such contacts.
        """
        profile = _profile(sensor)
        usual = self.fixed_contact or FixedContact(depth=0.001, angle=0.0)
        depth, angle = usual.depth if depth is None else depth, usual.angle if angle is None else angle
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth, tolerance)
        return like_first(self.touch_sense.images(contacts, profile), points)

    @usual_modes()
    def press(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
        shear: Rows | None = None,
        twist: Scalars = 0.0,
        friction: Scalars | None = None,
        markers: bool | Markers = False,
    ) -> Touches:
        """Press a tactile sensor on the object, then move the object sideways and turn it.

        Parameters
        ----------
        points, depth, angle, tilt, azimuth, tolerance, sensor : as in `touch`
        shear : (2,) or (N, 2) array, optional
            Motion of the object against the sensor after the press, along image right and image up, metres;
            at most as long as the sensor's ``max_indentation``.
        twist : float or (N,) array
            Turn of the object about the sensor's axis after the press, anticlockwise in the image, radians;
            at most half a turn.
        friction : float or (N,) array, optional
            Coefficient of friction between object and gel. Default: that of the object's material
            (`objectfolder.base.materials`).
        markers : bool or Markers
            Draw dots on the gel into the images: a default grid, or another.

        Returns
        -------
        Touches
            Images, heights, normals, contact masks, displacements, pressures, forces, areas, penetrations and
            obstruction. With shear, a twist or markers it is a `ShearedTouches`, whose images, of every kind,
            are those after the motion, and which also has the gel's sideways displacement, tractions, shear
            force, torque and the markers' flow.

        Raises
        ------
        ObjectFolderError
            As `touch`; also if the gel that is to be sheared is rigid, a shear is too long, a twist is beyond
            half a turn, or a friction is negative.
        """
        profile, dots = _profile(sensor), _dots(markers)
        rubbing = self.friction if friction is None else friction
        shears = np.zeros((1, 2)) if shear is None else finite_rows("shear", shear, 2)
        moved = max(len(shears), real_array("twist", twist).size, real_array("friction", rubbing).size)
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth, tolerance, moved)
        motion = checked_motion(shears, twist, rubbing, len(contacts), profile or self.sensor_profile)
        found = concatenate_touches(self.touch_sense.touches(contacts, profile), len(contacts))
        if shear is None and not motion[1].any() and dots is None:
            return found
        return shear_touches(found, *motion, dots, partial(self.touch_sense.draw_gel, profile=found.profile))

    @usual_modes()
    def touches(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
    ) -> Iterator[Touches]:
        """Answer as `press`, a few contacts at a time: for more of them than fit into memory."""
        profile = _profile(sensor)
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth, tolerance)
        return each_in_usual_modes(self.touch_sense.touches(contacts, profile))

    @usual_modes()
    def depth_maps(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
    ) -> np.ndarray:
        """Return the depth maps that the touch net of an imported 2.0 file stores; parameters as in `touch`.

        Returns
        -------
        (N, 120, 160) float32, metres from the released sensor's camera

        Raises
        ------
        ObjectFolderError
            If the file holds no such net (`press` returns heights for all others), or the net does not know
            such contacts.
        """
        contacts = ContactPoses.checked(points, depth, 0.0, tilt, azimuth, tolerance)
        return self.touch_sense.depth_maps(contacts)

    @usual_modes()
    def contact_normals(self, points: Rows, tolerance: float = TOLERANCE) -> np.ndarray:
        """Return the directions against which `touch` and `press` move a sensor that is not tilted.

        They are means over a neighbourhood, so that they lean at edges;
        `objectfolder.touch.contact.contact_normals` defines them. Parameters and errors as in `touch`.

        Returns
        -------
        (N, 3) float64, outward unit vectors
        """
        surface: ObjectSurface = self._parts.surface
        places = surface.closest_unit_points(finite_rows("points", points, 3), tolerance, UNMOVED)
        normals: np.ndarray = contact_normals(surface.read().grid.smooth_distance, places, NORMAL_RADIUS)
        return normals


def concatenate_touches(parts: Iterator[Touches], count: int) -> Touches:
    """Join answers of one sensor to ``count`` contacts.

    Raises ObjectFolderError if they do not fit into memory.
    """
    first = next(parts)
    names = [field.name for field in fields(Touches) if field.name != "profile"]
    _require_room([getattr(first, name) for name in names], count)
    parts = itertools.chain([first], parts)
    rows = zip(*([getattr(part, name) for name in names] for part in parts))
    return Touches(**dict(zip(names, map(np.concatenate, rows))), profile=first.profile)


def _require_room(arrays: list[np.ndarray], count: int) -> None:
    """Refuse ``count`` rows of such arrays, and their concatenation, if memory does not suffice."""
    row = sum(array[:1].nbytes for array in arrays)
    require_memory(f"{count} contacts", 2 * row * count, "ask for fewer at a time, or use ObjectFile.touches")


def _profile(sensor: Sensor) -> SensorProfile | None:
    return None if sensor is None else load_profile(sensor)


def _dots(markers: bool | Markers) -> Markers | None:
    """Return the dots to draw, if any."""
    if isinstance(markers, Markers):
        return markers
    if not isinstance(markers, bool | np.bool_):
        raise ObjectFolderError(
            f"markers is of type {type(markers).__name__}, expected True, False or a Markers of "
            "objectfolder.touch.markers, such as Markers(spacing=0.0015, radius=0.00025)"
        )
    return Markers() if markers else None
