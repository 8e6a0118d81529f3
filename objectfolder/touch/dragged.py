"""Surface of the gel under an object that has moved sideways and turned."""

from functools import lru_cache

import numpy as np
import torch
from torch.nn.functional import grid_sample

from objectfolder.touch.camera import gel_depth
from objectfolder.touch.gel import GAP, deform, double, halve, within_reach
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.tangential import MAX_GRID_SIDE

ROUNDS = 4  # of the fixed point below; friction stretches the surface by a few tenths at most


def dragged_contacts(
    height: np.ndarray,
    pressure: np.ndarray,
    dragged: np.ndarray,
    shear: np.ndarray,
    twist: np.ndarray,
    profile: SensorProfile,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return object and gel as the camera sees them after the object has moved.

    A point of the gel's surface keeps its depth when friction drags it sideways, unless the object, moved as
    a rigid body, is elsewhere there now. So the gel is pressed once more, by the moved object's height at the
    place to which each of its points was dragged, and its surface is then carried along. Where it sticks, the
    imprint moves with the object, unchanged; without friction, the object slides under a gel that stays.
    Motions are on a grid of the apex's pixel pitch, as in `gel.deform`: without perspective. What the object
    has beyond the image is unknown; the height at the border goes on there.

    Heights (N, H, W), metres, see `heightmaps`, and pressures (N, H, W), Pa, are from before the object moves
    by ``shear`` (N, 2), right and up in the image, metres, and ``twist`` (N,), anticlockwise in the image,
    radians; friction displaces the points of the soft gel by ``dragged`` (N, H, W, 2), metres. Returns the
    object's heights, up to ``max_indentation``, the gel's displacements towards the camera along the pixel
    rays, metres, and pressures, Pa; (N, H, W) float32. Bits of a row do not depend on others.
    """
    (sag, axes), deepest = rest_surface(profile), np.float32(profile.max_indentation)
    thickness = profile.elastomer_thickness
    moved, seen, pressed = (np.empty(height.shape, np.float32) for _ in range(3))
    for i, before in enumerate(height):
        shift, step = _pixels(dragged[i], profile), _pixels(shear[i], profile)
        moved[i] = _met(before, sag, _centred(_turned_back(axes - step, twist[i])), deepest, thickness)
        there = _centred(_turned_back(axes + shift - step, twist[i]))
        met = _met(before, sag, there, deepest, thickness)
        at_points = deform(met[None], profile, pressure[i : i + 1])
        source = _centred(axes - _carried(shift))
        seen[i] = np.minimum(_at(at_points[0][0] - sag, source) + sag, deepest)
        pressed[i] = _nearest(at_points[1][0], source)
    return moved, seen, pressed


def _met(
    height: np.ndarray, sag: np.ndarray, places: np.ndarray, deepest: np.float32, thickness: float
) -> np.ndarray:
    """Return the object's height over the gel's points when they meet what was at places (2, H, W), pixels.

    Heights and sag of the undeformed gel are (H, W), metres. Heights are clipped to the deepest: nearer to a
    dome's apex, the object reaches further.
    """
    met = np.minimum(_at(height - sag, places) + sag, deepest)
    # The lowest height stands for any wider gap; see `gel.indent`.
    lowest = np.float32(-GAP * thickness)
    met[~within_reach(_nearest(height, places), thickness) | (met < lowest)] = lowest
    return met


def _carried(shift: np.ndarray) -> np.ndarray:
    """Return by how much the points that are at the pixels now were shifted; (2, H, W) pixels.

    Solved on a coarse grid, as the friction is, for a point's place before from that after: a fixed point.
    """
    shapes, coarse = [], shift
    while min(coarse[0].shape) >= MAX_GRID_SIDE:
        shapes.append(coarse[0].shape)
        coarse = np.stack([halve(part) for part in coarse])
    step = np.float32(2 ** len(shapes))
    axes = _grid(*coarse[0].shape)
    carried = coarse
    for _ in range(ROUNDS):
        carried = _at(coarse, _centred(axes - carried / step))
    for shape in reversed(shapes):
        carried = np.stack([double(part, shape) for part in carried])
    return carried


@lru_cache(maxsize=16)
def rest_surface(profile: SensorProfile) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the undeformed gel recedes from its apex, (H, W), and the grid of its pixels."""
    sag = gel_depth(profile) - profile.camera_to_gel
    return sag.astype(np.float32), _grid(profile.height, profile.width)


def _grid(height: int, width: int) -> np.ndarray:
    """Return rows and columns of pixels from the image's centre; (2, H, W) float32."""
    rows, columns = np.indices((height, width), np.float32)
    return np.stack([rows - (height - 1) / 2, columns - (width - 1) / 2]).astype(np.float32)


def _pixels(motion: np.ndarray, profile: SensorProfile) -> np.ndarray:
    """Return a motion, right and up in metres, along rows and columns; (2, H, W), or (2, 1, 1) of a (2,)."""
    steps = np.array([-motion[..., 1], motion[..., 0]], np.float32) / np.float32(profile.pixel_pitch)
    return steps.reshape(2, *(motion.shape[:-1] or (1, 1)))


def _turned_back(places: np.ndarray, twist: float) -> np.ndarray:
    """Turn rows and columns from the centre clockwise in the image."""
    cos, sin = np.float32(np.cos(twist)), np.float32(np.sin(twist))
    rows, columns = places
    return np.stack([cos * rows + sin * columns, cos * columns - sin * rows])


def _centred(places: np.ndarray) -> np.ndarray:
    """Return pixel coordinates of places (2, H, W) from the centre."""
    height, width = places.shape[1:]
    return places + np.array([(height - 1) / 2, (width - 1) / 2], np.float32)[:, None, None]


def _at(images: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Interpolate images (..., H, W) at pixel coordinates (2, H, W); beyond the border, it goes on."""
    shape = images.shape[-2:]
    # From -1 to 1, columns first; in float64, so that pixels are exact.
    rows, columns = (axis.astype(np.float64) * (2 / (size - 1)) - 1 for axis, size in zip(places, shape))
    of = torch.from_numpy(images.reshape(1, -1, *shape)).double()
    at = torch.from_numpy(np.stack([columns, rows], -1)[None])
    found = grid_sample(of, at, padding_mode="border", align_corners=True)
    return found.float().numpy().reshape(images.shape)


def _nearest(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    rows, columns = (np.rint(axis).astype(int).clip(0, size - 1) for axis, size in zip(places, image.shape))
    return image[rows, columns]
