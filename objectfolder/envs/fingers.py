"""What the tactile sensors on both fingers feel in a grasp, from the Object File or from the true surface."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from objectfolder.envs.poses import hand_axes, rotation
from objectfolder.mesh.raycast import RayCaster
from objectfolder.objectfile.file import ObjectFile
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals, sensor_frames
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import touch_images

COARSE = 8  #: the gel's force is solved for on so many times fewer pixels, each way
LEVELS = 4  #: depths at which it is
LEAST_DEPTH = 1e-4  #: of a press, m

#: (N, 3) points, m -> the nearest of a surface, m; object frame.
Nearest = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Presses:
    """How sensors are pressed on an object; object frame, two rows per grasp: left, right."""

    points: np.ndarray  #: (2N, 3) where they touch, m
    outward: np.ndarray  #: (2N, 3) unit vectors from the object to the sensor
    up: np.ndarray  #: (2N, 3) unit vectors, up in the image


def presses(objects: np.ndarray, hands: np.ndarray, contacts: np.ndarray) -> Presses:
    """Transform contacts of both pads from the world to the object (supplementary I.4).

    Parameters
    ----------
    objects : (N, 7) array
        Position and quaternion, world frame.
    hands : (N, 4) array
        Poses of the gripper.
    contacts : (N, 2, 3) array
        Of the left and the right pad, world frame.
    """
    world = np.stack([rotation(place[3:]) for place in objects]).reshape(-1, 3, 3)
    points = np.einsum("nij,nki->nkj", world, contacts - objects[:, None, :3])
    axes = np.einsum("nij,nik->njk", world, hand_axes(hands))  # of the hand, in the object's frame
    outward = np.stack([axes[:, :, 0], -axes[:, :, 0]], 1)
    up = np.repeat(axes[:, None, :, 2], 2, 1)
    return Presses(points.reshape(-1, 3), outward.reshape(-1, 3), up.reshape(-1, 3))


def sensor_angles(
    normals: np.ndarray, outward: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How a sensor that looks along ``-outward`` is rotated and leans, as `ObjectFile.touch` takes it.

    Parameters
    ----------
    normals : (N, 3) array
        Contact normals.
    outward, up : (N, 3) array
        Of the sensor; unit vectors at right angles.

    Returns
    -------
    angle, tilt, azimuth : (N,) arrays, radians
    """
    upright = sensor_frames(outward, np.zeros(len(outward)))
    angle = np.arctan2((up * upright[:, :, 1]).sum(1), (up * upright[:, :, 2]).sum(1))
    frames = sensor_frames(normals, angle)
    forward, right = ((outward * frames[:, :, axis]).sum(1) for axis in (2, 1))
    tilt = np.arctan2(np.hypot(forward, right), (outward * normals).sum(1))
    return angle, tilt, np.arctan2(-right, forward)


def press_depths(file: ObjectFile, pressed: Presses, forces: np.ndarray) -> np.ndarray:
    """How deep the gel is when it pushes back with given forces; (2N,) metres.

    The gel's own model says what force a depth takes; between a few depths it is interpolated as a power of
    them. At most what the sensor takes: a greater force does not show.

    Parameters
    ----------
    file : ObjectFile
    pressed : Presses
    forces : (2N,) array
        Newtons.
    """
    net = file.header["touch"]["net"]
    if "press_depth" in net:  # stores images of one depth
        return np.full(len(pressed.points), float(net["press_depth"]))
    profile = sensor_profile(file)
    coarse = replace(profile, height=profile.height // COARSE, width=profile.width // COARSE)
    depths = np.geomspace(LEAST_DEPTH, profile.max_indentation, LEVELS)
    points, angle, tilt, azimuth = _queries(file, pressed)
    felt = np.stack(
        [file.press(points, depth, angle, tilt, azimuth, sensor=coarse).force for depth in depths], 1
    )
    felt = np.maximum.accumulate(np.maximum(felt, 1e-9), 1)
    levels, wanted = np.log(depths), np.log(np.maximum(forces, 1e-9))
    return np.exp([np.interp(f, row, levels) for f, row in zip(wanted, np.log(felt))])


def feel(file: ObjectFile, pressed: Presses, depths: np.ndarray) -> np.ndarray:
    """Tactile images that an Object File answers; (2N, H, W, 3) uint8.

    A touch net that stores images of points knows one depth and one direction; it gets the points alone.
    """
    net = file.header["touch"]["net"]
    points, angle, tilt, azimuth = _queries(file, pressed)
    if "press_depth" in net:
        return file.touch(points, depths, float(net.get("angle", 0.0)))
    return file.touch(points, depths, angle, tilt, azimuth)


class TrueSurface:
    """The ground truth of a touch: the surface that the Object File was made of, in the same sensor.

    Parameters
    ----------
    vertices : (V, 3) array
        Object frame, metres.
    faces : (F, 3) int array
    profile : SensorProfile
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, profile: SensorProfile):
        self._vertices, self._faces = np.asarray(vertices, np.float64), np.asarray(faces)
        self._caster = RayCaster(self._vertices, self._faces)
        self._profile, self._optics = profile, Optics(profile)

    def feel(self, pressed: Presses, depths: np.ndarray) -> np.ndarray:
        """Tactile images of the same presses; (2N, H, W, 3) uint8."""
        import igl

        _, _, points = igl.point_mesh_squared_distance(pressed.points, self._vertices, self._faces)
        angle, _, _ = sensor_angles(pressed.outward, pressed.outward, pressed.up)
        profile, optics = self._profile, self._optics
        return touch_images(self._caster, points, pressed.outward, angle, depths, profile, optics)[0]


def sensor_profile(file: ObjectFile) -> SensorProfile:
    """Profile of the sensor that an Object File stores."""
    from objectfolder.touch.profiles import load_profile

    stored = file.header["touch"]["net"]["sensor"]
    return load_profile(stored) if isinstance(stored, str) else SensorProfile.from_dict(stored)


def _queries(file: ObjectFile, pressed: Presses) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nearest points of the surface, and angle, tilt and azimuth to ask the touch net for there."""
    points, _ = file.nearest(pressed.points)
    normals = contact_normals(file.surface.grid.smooth_distance, points / file.scale, NORMAL_RADIUS)
    return points, *sensor_angles(normals, pressed.outward, pressed.up)
