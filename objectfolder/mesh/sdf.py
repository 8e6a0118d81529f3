"""Distance grid of a closed surface: sign by scanline, exact distances in a band."""

import math
from dataclasses import dataclass

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.featurecodec import Features
from objectfolder.mesh.features import find_features
from objectfolder.mesh.gridcodec import BOUND, band_width, quantise
from objectfolder.mesh.raycast import wall_thickness
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.scanline import inside
from objectfolder.mesh.settings import FINEST
from objectfolder.mesh.sharpen import extract_triangles
from objectfolder.mesh.topology import Mesh, distance, signed_volume

REFINEMENTS = (1.0, 4 / 3, 5 / 3, 2.0)  #: of the asked resolution, where walls are thin
#: Walls have at least this many voxels, up to ``FINEST``. Distances are interpolated linearly, with a kink
#: midway through a wall: in walls under two voxels it moves the surface inward, under one it tears it.
WALL_VOXELS = 1.4
VOLUME_ERROR = 0.01  #: a grid that changes the volume by more is refined, up to ``FINEST``
#: A grid whose surface is farther from more than ``STRAY_SHARE`` of the true one, unit frame, is refined: an
#: eighth of a voxel of 192 samples. Mouldings, grooves and slots of furniture are narrower than a voxel.
DEVIATION, STRAY_SHARE = 8e-4, 0.01
MIN_KEPT_VOLUME = 0.7
_BLOCK = 16  # samples along each side of the blocks in which the search for the surface starts
_CHUNK = 1_000_000
_POINTS = 20_000  # of the surface, whose distances are measured


@dataclass(frozen=True)
class FittedGrid:
    """Distance grid of a surface, and how well it holds it."""

    values: np.ndarray  #: (R, R, R) int8; see `objectfolder.mesh.grid.DistanceGrid`
    band: float
    features: Features  #: sharp edges and thin walls
    wall: float  #: thickness of thin walls, unit frame; see `wall_thickness`
    kept: float  #: volume that the stored surface encloses, as a fraction of the true one


def fit_grid(vertices: np.ndarray, faces: np.ndarray, resolution: int, name: str = "mesh") -> FittedGrid:
    """Compute a distance grid that is as fine as the walls of a closed surface, unit frame, require.

    The resolution is the asked one, or the first of its `REFINEMENTS` at which walls have `WALL_VOXELS`, and
    the stored surface has the volume of the true one within `VOLUME_ERROR` and lies within `DEVIATION` of it;
    at most ``FINEST``. Raises `ObjectFolderError` if the stored surface encloses less than
    ``MIN_KEPT_VOLUME`` of the volume even so.
    """
    wall = wall_thickness(vertices, faces)
    steps = _resolutions(resolution, wall)
    for samples in steps:
        values, band = distance_grid(vertices, faces, samples)
        kept = kept_volume(values, vertices, faces)
        if abs(kept - 1) > VOLUME_ERROR and samples < steps[-1]:
            continue
        features = find_features(values, vertices, faces)
        if samples == steps[-1] or deviation(values, features, vertices, faces) <= DEVIATION:
            break
    if len(features.sheets):
        kept = kept_volume(values, vertices, faces, features)
    check_resolved(values, kept, name)
    return FittedGrid(values, band, features, wall, kept)


def _resolutions(asked: int, wall: float) -> list[int]:
    """Return the resolutions to try, coarsest first."""
    steps = sorted({max(min(round(asked * factor), FINEST), asked) for factor in REFINEMENTS})
    needed = 1 + WALL_VOXELS * 2 * BOUND / wall
    return [n for n in steps if n >= needed] or steps[-1:]


def distance_grid(vertices: np.ndarray, faces: np.ndarray, resolution: int) -> tuple[np.ndarray, float]:
    """Compute the band-limited signed distance of a closed surface at the samples of [-0.52, 0.52]^3.

    Returns the values (R, R, R) int8, negative inside, and the band; see
    `objectfolder.mesh.grid.DistanceGrid`.
    """
    mesh = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
    band = band_width(resolution)
    spacing = 2 * BOUND / (resolution - 1)
    within = inside(*mesh, resolution, np.full(3, -BOUND), spacing)
    values = np.where(within, np.int8(-127), np.int8(127))
    near = near_surface(mesh, resolution, band)
    for start in range(0, len(near), _CHUNK):
        index = near[start : start + _CHUNK]
        cell = tuple(index.T)
        values[cell] = np.sign(values[cell]) * quantise(distance(mesh, spacing * index - BOUND), band)
    return values, band


def kept_volume(
    values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, features: Features | None = None
) -> float:
    """Return the volume that the surface of a distance grid encloses, as a fraction of the true one."""
    if values.min() >= 0 and not (features and len(features.sheets)):
        return 0.0
    stored, triangles, _ = extract_triangles(values, features)
    spacing = 2 * BOUND / (len(values) - 1)
    return signed_volume(stored * spacing, triangles) / signed_volume(vertices, faces)


def deviation(values: np.ndarray, features: Features, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the distance of the stored surface within which all but ``STRAY_SHARE`` of the true one lies."""
    stored, triangles, _ = extract_triangles(values, features)
    spacing = 2 * BOUND / (len(values) - 1)
    points = sample_surface(vertices, faces, _POINTS, np.random.default_rng(0))
    return float(np.quantile(distance((stored * spacing - BOUND, triangles), points), 1 - STRAY_SHARE))


def check_resolved(values: np.ndarray, kept: float, name: str) -> None:
    """Check that a distance grid resolves its surface.

    Walls thinner than the spacing may lie in a cell without crossing its edges, as needles do, and are
    lost. Raises `ObjectFolderError` if less than ``MIN_KEPT_VOLUME`` of the volume is kept, see
    `kept_volume`.
    """
    if kept < MIN_KEPT_VOLUME:
        count = len(values)
        remedy = "" if count >= FINEST else "raise voxelize.sdf_resolution, or "
        raise ObjectFolderError(
            f"{name}: walls are too thin for the {count}^3 distance grid (spacing "
            f"{2 * BOUND / (count - 1):.2%} of the size): {kept:.0%} of the volume is left; "
            f"{remedy}thicken the mesh"
        )


def near_surface(mesh: Mesh, resolution: int, band: float, offset: float = 0.0) -> np.ndarray:
    """Find the samples whose distance may be the offset to within the band; (N, 3) int64 indices.

    Blocks of samples that are farther than the band are dropped; the others are halved along each axis, down
    to blocks of two samples a side.
    """
    spacing = 2 * BOUND / (resolution - 1)
    count = math.ceil(resolution / _BLOCK)
    corners = _BLOCK * np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), -1).reshape(-1, 3)
    children = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    side = _BLOCK
    while True:
        half = (side - 1) / 2  # the block's centre lies so far from its corners along each axis
        reach = band + math.sqrt(3) * half * spacing + 1e-6
        away = distance(mesh, spacing * (corners + half) - BOUND)
        corners = corners[np.abs(away - offset) <= reach]
        side //= 2
        corners = (corners[:, None] + side * children).reshape(-1, 3)
        corners = corners[(corners < resolution).all(1)]
        if side == 1:
            return corners
