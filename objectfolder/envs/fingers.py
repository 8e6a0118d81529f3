"""Tactile images of both fingers in a grasp, from the Object File or from the true surface."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from objectfolder.envs.poses import hand_axes, rotation
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.raycast import RayCaster
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.touch import ContactPoses
from objectfolder.objectfile.touch_senses import DepthMapSense
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.simulate import touch_images

COARSE = 8  #: reduction of the sensor's resolution, each way, to solve for the gel's force
LEVELS = 4  #: number of depths at which the force is solved for
LEAST_DEPTH = 1e-4  #: of a press, m


@dataclass(frozen=True)
class Presses:
    """Poses of sensors pressed on an object; object frame, two rows per grasp: left, right."""

    points: np.ndarray  #: (2N, 3) contact points, m
    outward: np.ndarray  #: (2N, 3) unit vectors from the object to the sensor
    up: np.ndarray  #: (2N, 3) unit vectors, up in the image

    def take(self, rows: np.ndarray) -> "Presses":
        """Select rows."""
        return Presses(self.points[rows], self.outward[rows], self.up[rows])


def pad_axes(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward and the up vectors of both pads, (N, 2, 3), of hand axes (N, 3, 3)."""
    outward = np.stack([axes[:, :, 0], -axes[:, :, 0]], 1)
    return outward, np.repeat(axes[:, None, :, 2], 2, 1)


def pad_presses(objects: np.ndarray, hands: np.ndarray, contacts: np.ndarray) -> Presses:
    """Transform contacts of both pads from the world frame to the object frame (supplementary I.4).

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
    outward, up = pad_axes(np.einsum("nij,nik->njk", world, hand_axes(hands)))
    return Presses(points.reshape(-1, 3), outward.reshape(-1, 3), up.reshape(-1, 3))


def sensor_angles(
    normals: np.ndarray, outward: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert orientations of sensors to the angle, tilt and azimuth that `ObjectFile.touch` takes.

    Parameters
    ----------
    normals : (N, 3) array
        Contact normals.
    outward, up : (N, 3) array
        Orthogonal unit vectors: opposite to the viewing direction, and up in the image.

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


def require_pads(file: ObjectFile) -> None:
    """Raise ObjectFolderError unless a file answers the presses of pads, whichever way these turn."""
    if "touch" not in file.header:
        raise ObjectFolderError(f"{file.key}: the Object File holds no touch; build it whole")
    if isinstance(file.touch_sense, DepthMapSense):
        raise ObjectFolderError(
            f"{file.key}: the touch net of an imported 2.0 file knows no rotated sensor, as on fingers; "
            "leave the object out, or build it from its mesh"
        )


def press_depths(file: ObjectFile, pressed: Presses, forces: np.ndarray) -> np.ndarray:
    """Return the press depths at which the gel pushes back with given forces; (2N,) metres.

    The gel model gives the force at a few depths; between them it is interpolated on logarithmic scales.
    Depths are clipped to the sensor's range.

    Parameters
    ----------
    file : ObjectFile
    pressed : Presses
    forces : (2N,) array
        Newtons.
    """
    if file.fixed_contact is not None:
        return np.full(len(pressed.points), file.fixed_contact.depth)
    profile = file.sensor_profile
    coarse = replace(profile, height=profile.height // COARSE, width=profile.width // COARSE)
    depths = np.geomspace(LEAST_DEPTH, profile.max_indentation, LEVELS)
    contacts = _contacts(file, pressed, np.zeros(len(pressed.points)))
    at_depths = [replace(contacts, depth=np.full(len(contacts.points), depth)) for depth in depths]
    felt = np.stack(
        [np.concatenate([part.force for part in file.touch_sense.touches(one, coarse)]) for one in at_depths],
        1,
    )
    felt = np.maximum.accumulate(np.maximum(felt, 1e-9), 1)
    levels, wanted = np.log(depths), np.log(np.maximum(forces, 1e-9))
    return np.exp([np.interp(f, row, levels) for f, row in zip(wanted, np.log(felt))])


def tactile_images(file: ObjectFile, pressed: Presses, depths: np.ndarray) -> np.ndarray:
    """Query an Object File for tactile images; (2N, H, W, 3) uint8.

    Touch nets trained on images of one depth and one direction are queried with the points alone.
    """
    if file.fixed_contact is not None:
        return file.touch(file.nearest(pressed.points)[0])
    return file.touch_sense.images(_contacts(file, pressed, depths), None)


class TrueSurface:
    """Ground truth of touches: the surface from which the Object File was made, seen by the same sensor.

    Parameters
    ----------
    vertices : (V, 3) array
        Object frame, metres.
    faces : (F, 3) int array
    profile : SensorProfile
    background : (H, W, 3) uint8 array
        Image of the untouched sensor; see `ObjectFile.sensor_background`.
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, profile: SensorProfile, background: np.ndarray
    ):
        self._vertices, self._faces = np.asarray(vertices, np.float64), np.asarray(faces)
        self._caster = RayCaster(self._vertices, self._faces)
        self._profile, self._optics = profile, Optics(profile)
        self._optics.background = torch.from_numpy(background)

    def tactile_images(self, pressed: Presses, depths: np.ndarray) -> np.ndarray:
        """Render tactile images of presses; (2N, H, W, 3) uint8."""
        import igl

        _, _, points = igl.point_mesh_squared_distance(pressed.points, self._vertices, self._faces)
        angle, _, _ = sensor_angles(pressed.outward, pressed.outward, pressed.up)
        profile, optics = self._profile, self._optics
        return touch_images(self._caster, points, pressed.outward, angle, depths, profile, optics)[0]


def _contacts(file: ObjectFile, pressed: Presses, depths: np.ndarray) -> ContactPoses:
    """Return presses of some depths (2N,), metres, at the nearest points of the surface.

    Pads turn where the hand does: they may face away from the surface, which `ObjectFile.touch` refuses.
    """
    points, _ = file.nearest(pressed.points)
    angles = sensor_angles(file.contact_normals(points), pressed.outward, pressed.up)
    return ContactPoses(points, depths, *angles)
