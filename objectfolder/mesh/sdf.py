"""Distance grid of a closed surface: sign by scanline, exact distances in a band."""

import igl
import numpy as np
from skimage.measure import marching_cubes

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.gridcodec import BOUND, band_width, coarse_spacing, quantise
from objectfolder.mesh.scanline import inside
from objectfolder.mesh.topology import signed_volume

MIN_KEPT_VOLUME = 0.7
_COARSE_STEP = 4
_CHUNK = 1_000_000


def distance_grid(vertices: np.ndarray, faces: np.ndarray, resolution: int) -> tuple[np.ndarray, float]:
    """Compute the band-limited signed distance of a closed surface.

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
    within = inside(vertices, faces, resolution, np.full(3, -BOUND), spacing)
    values = np.where(within, np.int8(-127), np.int8(127))
    near = np.argwhere(_near_surface(vertices, faces, resolution, band))
    axis = -BOUND + spacing * np.arange(resolution)
    for start in range(0, len(near), _CHUNK):
        index = near[start : start + _CHUNK]
        distance = np.sqrt(igl.point_mesh_squared_distance(axis[index], vertices, faces)[0])
        cell = tuple(index.T)
        values[cell] = np.sign(values[cell]) * quantise(distance, band)
    return values, band


def check_resolved(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, name: str) -> float:
    """Check that a distance grid resolves its surface.

    Walls thinner than the spacing fall between samples and break into fragments.

    Returns
    -------
    float
        Fraction of the volume that the stored surface encloses.

    Raises
    ------
    ObjectFolderError
        If the stored surface encloses less than ``MIN_KEPT_VOLUME`` of the volume.
    """
    spacing = 2 * BOUND / (len(values) - 1)
    kept = 0.0
    if values.min() < 0:
        v, f, _, _ = marching_cubes(values.astype(np.float32), 0.0, allow_degenerate=False)
        kept = signed_volume(v * spacing, f) / signed_volume(vertices, faces)
    if kept < MIN_KEPT_VOLUME:
        raise ObjectFolderError(
            f"{name}: walls are too thin for the {len(values)}^3 distance grid (spacing {spacing:.2%} of the "
            f"size): {kept:.0%} of the volume is left; raise voxelize.sdf_resolution, or thicken the mesh"
        )
    return kept


def _near_surface(vertices: np.ndarray, faces: np.ndarray, resolution: int, band: float) -> np.ndarray:
    """Find the samples that may lie within the band, from distances on a coarser grid; (R,)*3 bool."""
    count, spacing = coarse_spacing(resolution, _COARSE_STEP)
    axis = -BOUND + spacing * np.arange(count)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    distance = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0]).reshape((count,) * 3)
    nearest = np.rint(np.arange(resolution) / _COARSE_STEP).astype(np.int64)
    # Distances at a fine sample and its nearest coarse sample differ by at most their separation.
    apart = ((np.arange(resolution) / _COARSE_STEP - nearest) * spacing).astype(np.float32) ** 2
    apart = np.sqrt(apart[:, None, None] + apart[:, None] + apart)
    return distance.astype(np.float32)[np.ix_(nearest, nearest, nearest)] <= apart + np.float32(band + 1e-6)
