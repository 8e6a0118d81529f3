"""First contact of gently closing jaws with an object at rest, found by casting rays from the pads."""

from dataclasses import dataclass

import numpy as np

from objectfolder.envs.fingers import Presses, pad_axes
from objectfolder.envs.gripper import OPEN, PAD, STROKE
from objectfolder.envs.poses import hand_axes, rotation
from objectfolder.objectfile.file import ObjectFile

PAD_RAYS = (7, 9)  #: rays across and up a pad
CONTACT_DEPTH = 0.0007  #: surface up to this far behind the first hit counts as touched, m


@dataclass(frozen=True)
class FirstContact:
    """Contacts of both pads at N poses of the hand."""

    presses: Presses  #: 2N rows; arbitrary where a pad touches nothing
    touched: np.ndarray  #: (N, 2) bool
    width: np.ndarray  #: (N,) opening of the closed jaws, m; 0 unless both pads touch


def first_contact(file: ObjectFile, rest: np.ndarray, hands: np.ndarray) -> FirstContact:
    """Close the jaws until each pad first touches the object.

    A press is at the centroid of the hits within `CONTACT_DEPTH` of a pad's first hit.

    Parameters
    ----------
    file : ObjectFile
    rest : (7,) array
        Pose of the object.
    hands : (N, 4) array
        Poses of the gripper, in the same frame.
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
    y, z = np.meshgrid(*(_cell_centers(half, count) for half, count in zip(PAD[1:], PAD_RAYS)), indexing="ij")
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


def _cell_centers(half: float, count: int) -> np.ndarray:
    """Return the centres of ``count`` equal parts of [-half, half]."""
    return ((np.arange(count) + 0.5) / count * 2 - 1) * half
