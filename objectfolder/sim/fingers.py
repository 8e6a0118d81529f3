"""What both fingers feel in a grasp, from the Object File or from the true surface.

The first contact of gently closing jaws is found by casting rays from the pads.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.raycast import RayCaster
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rotation
from objectfolder.sim.gripper import OPEN, PAD, STROKE, hand_axes
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.query import ContactPoses
from objectfolder.touch.senses import DepthMapSense
from objectfolder.touch.simulate import touch_images

GRID_REDUCTION = 8  #: reduction of the sensor's resolution, each way, to solve for the gel's force
LEVELS = 4  #: number of depths at which the force is solved for
MIN_DEPTH = 1e-4  #: of a press, m
PAD_RAYS = (7, 9)  #: rays across and up a pad
CONTACT_DEPTH = 0.0007  #: surface up to this far behind the first hit counts as touched, m


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
    """Transform contacts (N, 2, 3) of both pads from the world frame to the object frame (supplementary I.4).

    Objects (N, 7) are position and quaternion, hands (N, 4) poses of the gripper.
    """
    world = np.stack([rotation(place[3:]) for place in objects]).reshape(-1, 3, 3)
    points = np.einsum("nij,nki->nkj", world, contacts - objects[:, None, :3])
    outward, up = pad_axes(np.einsum("nij,nik->njk", world, hand_axes(hands)))
    return Presses(points.reshape(-1, 3), outward.reshape(-1, 3), up.reshape(-1, 3))


def sensor_angles(
    normals: np.ndarray, outward: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angle, tilt and azimuth of sensors as `ObjectFile.touch` takes them; (N,) radians.

    Outward and up are orthogonal unit vectors (N, 3): opposite to the viewing direction, and up in the image;
    ``normals`` are those of the contacts.
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
            f"{file.key}: the touch net of an imported 2.0 file cannot turn the sensor, as fingers do; "
            "leave the object out, or build it from its mesh"
        )


def press_depths(file: ObjectFile, pressed: Presses, forces: np.ndarray) -> np.ndarray:
    """Return the press depths at which the gel pushes back with forces (2N,), N; (2N,) metres.

    The gel model gives the force at a few depths; between them it is interpolated on logarithmic scales.
    Depths are clipped to the sensor's range.
    """
    if file.fixed_contact is not None:
        return np.full(len(pressed.points), file.fixed_contact.depth)
    profile = file.sensor_profile
    coarse = replace(profile, height=profile.height // GRID_REDUCTION, width=profile.width // GRID_REDUCTION)
    depths = np.geomspace(MIN_DEPTH, profile.max_indentation, LEVELS)
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

    Vertices (V, 3) are in the object frame, metres; ``background`` (H, W, 3) is the image of the untouched
    sensor, see `ObjectFile.sensor_background`.
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


@dataclass(frozen=True)
class FirstContact:
    """Contacts of both pads at N poses of the hand."""

    presses: Presses  #: 2N rows; arbitrary where a pad touches nothing
    touched: np.ndarray  #: (N, 2) bool
    width: np.ndarray  #: (N,) opening of the closed jaws, m; 0 unless both pads touch


def first_contact(file: ObjectFile, rest: np.ndarray, hands: np.ndarray) -> FirstContact:
    """Close the jaws until each pad first touches the object, at rest in the pose (7,); hands are (N, 4).

    A press is at the centroid of the hits within `CONTACT_DEPTH` of a pad's first hit.
    """
    origins, directions = _pad_rays(rest, hands)
    distances = _cast(file, origins, directions)
    first = distances.min(2)
    touched = first < STROKE
    near = touched[..., None] & (distances < first[..., None] + CONTACT_DEPTH)
    hits = origins + directions * np.where(near, distances, 0.0)[..., None]
    outward, up = (axes @ rotation(rest[3:]) for axes in pad_axes(hand_axes(hands)))
    both = touched.all(1)
    return FirstContact(
        Presses(_centroids(hits, near).reshape(-1, 3), outward.reshape(-1, 3), up.reshape(-1, 3)),
        touched,
        np.where(both, STROKE - np.where(both[:, None], first, 0.0).sum(1), 0.0),
    )


def _pad_rays(rest: np.ndarray, hands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins on the faces of the open pads and closing directions; object frame, m, (N, 2, R, 3)."""
    cells = (((np.arange(n) + 0.5) / n * 2 - 1) * half for half, n in zip(PAD[1:], PAD_RAYS))
    y, z = np.meshgrid(*cells, indexing="ij")
    face = np.stack([0 * y.ravel(), y.ravel(), z.ravel()], 1)
    side = np.array([[[1.0, 0, 0]], [[-1.0, 0, 0]]])  # left, right
    starts, closing = face + OPEN * side, np.broadcast_to(-side, (2, *face.shape))
    axes, turn = hand_axes(hands), rotation(rest[3:])
    origins = np.einsum("nij,skj->nski", axes, starts) + hands[:, None, None, :3] - rest[:3]
    return origins @ turn, np.einsum("nij,skj->nski", axes, closing) @ turn


def _cast(file: ObjectFile, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return distances to the surface along rays (N, 2, R, 3); (N, 2, R), m, ``inf`` without a hit."""
    found, _ = file.surface.caster.first_hit(origins.reshape(-1, 3) / file.scale, directions.reshape(-1, 3))
    return (found * file.scale).reshape(origins.shape[:3]).astype(np.float64)


def _centroids(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return means of the chosen points (N, 2, R, 3) of each pad; 0 where none is; (N, 2, 3)."""
    weights = chosen / np.maximum(chosen.sum(2, keepdims=True), 1)
    return (weights[..., None] * np.where(chosen[..., None], points, 0.0)).sum(2)
