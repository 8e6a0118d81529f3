"""Visual hull: the part of space that no silhouette shows to be empty (Laurentini 1994)."""

from collections.abc import Mapping

import numpy as np
from scipy import ndimage

from objectfolder.vision.cameras import Intrinsics, image_intrinsics, project


def visual_hull(views: Mapping[str, np.ndarray], cells: int, half: float) -> np.ndarray:
    """Return which cells of the cube [-half, half]^3 may hold a part of an object, by its silhouettes.

    A cell is empty if a view shows none of the object wherever the sphere around the cell projects to. What
    is outside of an image, or not wholly before its camera, tells nothing. Views hold ``rgba`` (N, H, W, 4),
    ``camera_to_world`` (N, 4, 4), ``focal``, ``center`` (N, 2). Returns (cells, cells, cells) bool by x, y
    and z, unit frame.
    """
    axis = (np.arange(cells) + 0.5) * (2 * half / cells) - half
    radius = 3**0.5 * half / cells
    cameras = list(zip(views["camera_to_world"], image_intrinsics(views)))
    gaps = [_gap(rgba[..., 3] > 0) for rgba in views["rgba"]]
    hull = np.zeros((cells, cells**2), bool)
    for i, x in enumerate(axis):  # a plane of cells at a time: little memory
        centres = np.stack(np.meshgrid(x, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        left = np.arange(len(centres))
        for gap, (pose, intrinsics) in zip(gaps, cameras):
            left = left[~_empty(centres[left], radius, gap, pose, intrinsics)]
        hull[i, left] = True
    return hull.reshape(cells, cells, cells)


def _empty(
    centres: np.ndarray, radius: float, gap: np.ndarray, pose: np.ndarray, intrinsics: Intrinsics
) -> np.ndarray:
    """Return which spheres are wholly in the image and project to pixels without the object; (N,) bool."""
    position, depth = project(centres, pose, intrinsics)
    before = depth > 2 * radius
    position, depth = position[before], depth[before]
    away = np.linalg.norm(centres[before] - pose[:3, 3], axis=1)
    # Off the camera's axis, a sphere projects to an ellipse; this disk about its centre's pixel holds it.
    disk = max(intrinsics.fx, intrinsics.fy) * radius * away / (depth * (depth - radius))
    within = (position >= disk[:, None]) & (position <= gap.shape[::-1] - disk[:, None])
    inside = np.asarray(within.all(1))
    position, disk = position[inside], disk[inside]
    column, row = position.astype(int).T
    off_centre = np.linalg.norm(position - np.floor(position) - 0.5, axis=1)
    inside[inside] = gap[row, column] - off_centre > disk
    before[before] = inside
    return before


def _gap(shown: np.ndarray) -> np.ndarray:
    """Return how far each pixel's centre is at least from a pixel that shows the object; (H, W), pixels."""
    if not shown.any():
        return np.full(shown.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~shown)) - 2**-0.5
