"""Valid random queries in the file formats of the published dataset: views, strikes and touches."""

import math

import numpy as np
import torch

from objectfolder.base.checks import finite_number, one_of, require_memory, whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.profiles import SensorProfile
from objectfolder.vision.cameras import CAMERA_RADIUS, LIGHT_RADIUS, MAX_COORDINATE, sphere_points

MAX_TILT = math.radians(15)  #: largest tilt of the published touches, radians

STRONGEST = 1e30  #: impulse, N s, whose sound single precision holds
NEAREST = 1e-6  #: of a camera or light to the object's origin, unit frame
DIRECTIONS = ("normal", "random")


def sample_views(
    count: int, seed: int = 0, radius: float = CAMERA_RADIUS, light_radius: float = LIGHT_RADIUS
) -> np.ndarray:
    """Draw cameras and lights, each uniform on a sphere around the object.

    Parameters
    ----------
    count : int
    seed : int
    radius, light_radius : float
        Radii of the two spheres, unit frame; default: those of the paper's data (supplementary C).

    Returns
    -------
    (count, 6) float64, camera xyz and light xyz, unit frame

    Raises
    ------
    ObjectFolderError
        If the count or the seed is not a whole number, or a radius is no number of which views can be asked.

    Examples
    --------
    >>> sample_views(20).shape
    (20, 6)
    """
    count, rng = whole_number("count", count), np.random.default_rng(whole_number("seed", seed))
    require_memory(f"{count} views", 100 * count, "draw fewer at a time")
    places = NEAREST, MAX_COORDINATE, "in the unit frame (longest side 1)"
    radii = _within("radius", radius, *places), _within("light_radius", light_radius, *places)
    return np.hstack([sphere_points(count, one, rng) for one in radii])


def sample_strikes(
    obj: ObjectFile, count: int, seed: int = 0, force: float = 1.0, directions: str = "normal"
) -> np.ndarray:
    """Draw strikes on an object: surface points, uniform by area, and impulses directed into it.

    Parameters
    ----------
    obj : ObjectFile
    count, seed : int
        The points are those of ``obj.sample_surface(count, seed)``.
    force : float
        Magnitude of every impulse, N s.
    directions : {"normal", "random"}
        Along the inward surface normal, as of a hammer, or uniform over the directions into the object.

    Returns
    -------
    (count, 6) float64, point (metres) and impulse (N s), object frame

    Raises
    ------
    ObjectFolderError
        If the count or the seed is not a whole number, the force is not a positive, finite number, or the
        directions are unknown.

    Examples
    --------
    >>> strikes = sample_strikes(mug, 20)
    >>> mug.impact(strikes[:, :3], strikes[:, 3:], duration=0.1).shape
    (20, 1600)
    """
    force = _within("force", force, 1 / STRONGEST, STRONGEST, "N s")
    one_of("directions", directions, DIRECTIONS)
    points = obj.sample_surface(count, seed)
    unit_points = torch.from_numpy(points / obj.scale).to(torch.float32)
    inward = -obj.surface.grid.normals(unit_points).numpy().astype(np.float64)
    if directions == "random":
        chosen = sphere_points(count, 1.0, _generator(seed))
        # A hammer cannot pull: flip directions that point out of the object.
        inward = np.where((chosen * inward).sum(1, keepdims=True) < 0, -chosen, chosen)
    return np.hstack([points, force * inward / np.linalg.norm(inward, axis=1, keepdims=True)])


def sample_presses(
    obj: ObjectFile, count: int, seed: int = 0, sensor: SensorProfile | None = None
) -> np.ndarray:
    """Draw tilts and press depths of a tactile sensor: the published ``gelinfo``.

    Parameters
    ----------
    obj : ObjectFile
    count, seed : int
    sensor : SensorProfile, optional
        Default: the stored profile.

    Returns
    -------
    (count, 3) float64
        Tilt theta, up to 15 degrees, and its direction phi, both in radians, and depth in metres, each
        uniform. Depths are in the ``press_range`` of the object and the sensor: 0.5 to 2 mm for DIGIT, as
        published.

    Raises
    ------
    ObjectFolderError
        If the count or the seed is not a whole number, or the object has no touch network, or one of a fixed
        press.

    Examples
    --------
    >>> tilt, azimuth, depth = sample_presses(mug, 5).T
    >>> mug.touch(mug.sample_surface(5), depth, tilt=tilt, azimuth=azimuth).shape
    (5, 160, 120, 3)
    """
    fixed = obj.fixed_contact
    if fixed is not None:
        raise ObjectFolderError(
            f"{obj.key}: its touch net stores images of one press of {obj.sensor}, {fixed.depth:g} m deep "
            f"and without a tilt; leave gelinfo out and query with that depth (--depth {fixed.depth:g})"
        )
    count = whole_number("count", count)
    require_memory(f"{count} presses", 50 * count, "draw fewer at a time")
    low, high = obj.press_range(sensor)
    return _generator(seed).uniform((0, 0, low), (MAX_TILT, 2 * math.pi, high), (count, 3))


def sample_depths(obj: ObjectFile, count: int, seed: int) -> np.ndarray:
    """Draw press depths, (count,) metres: those of `sample_presses`, or the only one that the net knows."""
    fixed = obj.fixed_contact
    return sample_presses(obj, count, seed)[:, 2] if fixed is None else np.full(count, fixed.depth)


def _generator(seed: int) -> np.random.Generator:
    """Return a generator independent of the surface points, which are drawn from the seed itself."""
    return np.random.default_rng(whole_number("seed", seed)).spawn(1)[0]


def _within(name: str, value: float, least: float, most: float, unit: str) -> float:
    number = finite_number(name, value)
    if not least <= number <= most:
        raise ObjectFolderError(f"{name} is {value!r}, expected {least:g} to {most:g}, {unit}")
    return number
