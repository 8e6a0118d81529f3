"""Build the distance grid of a closed surface: sign by scanline, exact distance in the band."""

import igl
import numpy as np

from objectfolder.mesh.grid import BOUND, band_width, coarse_spacing, quantise
from objectfolder.mesh.scanline import inside

_COARSE_STEP = 4
_CHUNK = 1_000_000


def distance_grid(vertices: np.ndarray, faces: np.ndarray, resolution: int) -> tuple[np.ndarray, float]:
    """Band-limited signed distance of a closed surface.

    Parameters
    ----------
    vertices : (V, 3) array, unit frame
    faces : (F, 3) int array
    resolution : int
        Samples along each axis of [-0.52, 0.52]^3.

    Returns
    -------
    values : (R, R, R) int8, negative inside; see `objectfolder.mesh.grid.DistanceGrid`
    band : float
    """
    vertices = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int64)
    band = band_width(resolution)
    spacing = 2 * BOUND / (resolution - 1)
    signed = np.where(inside(vertices, faces, resolution, np.full(3, -BOUND), spacing), -band, band)
    near = np.argwhere(_near_surface(vertices, faces, resolution, band))
    axis = -BOUND + spacing * np.arange(resolution)
    for start in range(0, len(near), _CHUNK):
        index = near[start : start + _CHUNK]
        distance = np.sqrt(igl.point_mesh_squared_distance(axis[index], vertices, faces)[0])
        cell = tuple(index.T)
        signed[cell] = np.sign(signed[cell]) * np.minimum(distance, band)
    return quantise(signed, band), band


def _near_surface(vertices: np.ndarray, faces: np.ndarray, resolution: int, band: float) -> np.ndarray:
    """Fine samples that may lie within the band, from distances on a coarser grid; (R,)*3 bool."""
    count, spacing = coarse_spacing(resolution, _COARSE_STEP)
    axis = -BOUND + spacing * np.arange(count)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    distance = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0]).reshape((count,) * 3)
    nearest = np.rint(np.arange(resolution) / _COARSE_STEP).astype(np.int64)
    # A fine sample is at most half a coarse cell's diagonal from its nearest coarse sample.
    reach = band + spacing / 2 * np.sqrt(3) + 1e-9
    return (distance <= reach)[np.ix_(nearest, nearest, nearest)]
