"""Visual hull: the part of space that no silhouette shows to be empty (Laurentini 1994)."""

from collections.abc import Mapping

import numpy as np
from scipy import ndimage

from objectfolder.vision.cameras import image_intrinsics, project


def visual_hull(views: Mapping[str, np.ndarray], cells: int, half: float) -> np.ndarray:
    """Return which cells of a cube may hold a part of an object, by its silhouettes.

    A cell is empty if a view shows none of the object wherever the sphere around the cell projects to. What
    is outside of an image, or not wholly before its camera, tells nothing.

    Parameters
    ----------
    views : mapping
        ``rgba`` (N, H, W, 4), ``camera_to_world`` (N, 4, 4), ``focal``, ``center`` (N, 2).
    cells : int
        Along each axis of the cube.
    half : float
        The cube is [-half, half]^3 of the unit frame.

    Returns
    -------
    (cells, cells, cells) bool array
        Indexed by x, y and z.
    """
    axis = (np.arange(cells) + 0.5) * (2 * half / cells) - half
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    radius = 3**0.5 * half / cells
    left = np.arange(len(centres))
    for rgba, pose, intrinsics in zip(views["rgba"], views["camera_to_world"], image_intrinsics(views)):
        position, depth = project(centres[left], pose, intrinsics)
        told = depth > 2 * radius
        told &= ((position >= 0) & (position < (intrinsics.width, intrinsics.height))).all(1)
        pixel = position[told].astype(int)
        gap = _gap(rgba[..., 3] > 0)[pixel[:, 1], pixel[:, 0]]
        gap -= np.linalg.norm(position[told] - pixel - 0.5, axis=1)
        disk = max(intrinsics.fx, intrinsics.fy) * radius / (depth[told] - radius)
        told[told] = gap > disk  # now: seen to be empty
        left = left[~told]
    hull = np.zeros(len(centres), bool)
    hull[left] = True
    return hull.reshape(cells, cells, cells)


def _gap(shown: np.ndarray) -> np.ndarray:
    """Return how far each pixel's centre is at least from a pixel that shows the object; (H, W), pixels."""
    if not shown.any():
        return np.full(shown.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~shown)) - 2**-0.5
