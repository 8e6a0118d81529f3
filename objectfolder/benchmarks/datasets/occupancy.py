"""Occupancy of Object Files: samples to train on (Occupancy Networks), and meshes extracted from grids.

The region enclosed by the stored surface is occupied: the wall of a mug, but not its cavity.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.seeding import numpy_generator
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface

#: Points fill [-HALF_SIDE, HALF_SIDE]^3, a tenth larger than the unit cube, as in Occupancy Networks.
HALF_SIDE = 0.55
NEAR = 0.02  #: standard deviation of points near the surface, fraction of the longest side
CHUNK = 2**20  # points looked up at once


def is_inside(surface: Isosurface, points: np.ndarray) -> np.ndarray:
    """Return whether points (..., 3), unit frame, are inside the stored surface; (...) bool.

    Uses the sign of the trilinearly interpolated signed distance. Points beyond the stored grid are outside.
    """
    flat = torch.from_numpy(np.asarray(points, np.float32).reshape(-1, 3))
    distance = torch.cat([surface.grid.distance(part) for part in flat.split(CHUNK)])
    within = flat.abs().amax(1) <= BOUND
    return ((distance <= 0) & within).numpy().reshape(np.shape(points)[:-1])


def uniform_points(count: int, rng: np.random.Generator) -> np.ndarray:
    """Sample points uniformly in the cube of side 1.1; (count, 3) float32."""
    return rng.uniform(-HALF_SIDE, HALF_SIDE, (count, 3)).astype(np.float32)


def near_points(surface: Isosurface, count: int, rng: np.random.Generator) -> np.ndarray:
    """Sample points near the surface, with normal offsets in each axis; (count, 3) float16.

    A third of them lie inside thin walls, which uniform points hardly hit. Occupancy is evaluated at the
    rounded points, so that it is exact.
    """
    on_surface = sample_surface(surface.vertices, surface.faces, count, rng)
    moved = on_surface + rng.normal(scale=NEAR, size=on_surface.shape)
    return moved.clip(-HALF_SIDE, HALF_SIDE).astype(np.float16)


def grid_points(resolution: int) -> np.ndarray:
    """Return the nodes of a regular grid over the cube; (resolution^3, 3) float32, last axis fastest."""
    axis = np.linspace(-HALF_SIDE, HALF_SIDE, resolution, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def extract_mesh(occupancy: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Extract the surface of the region whose occupancy exceeds a threshold, by marching cubes.

    Takes probabilities or logits (R, R, R) at the nodes of `grid_points`, and a threshold in the same unit.
    Smooth values give a smooth surface. Where the occupancy on the border exceeds the threshold, the surface
    is closed just outside. Returns vertices (V, 3) float64, unit frame, and faces (F, 3) int64,
    counter-clockwise seen from outside; empty if no value exceeds the threshold.
    """
    from skimage.measure import marching_cubes

    values = np.asarray(occupancy, np.float32)
    spacing = 2 * HALF_SIDE / (len(values) - 1)
    outside = min(float(values.min()), threshold - 1.0)
    padded = np.pad(values, 1, constant_values=outside)
    if padded.max() <= threshold:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices, faces, _, _ = marching_cubes(
        padded, threshold, gradient_direction="ascent", allow_degenerate=False
    )
    return (vertices.astype(np.float64) - 1) * spacing - HALF_SIDE, faces.astype(np.int64)


@dataclass(frozen=True)
class OccupancySamples:
    """Occupancy of K objects at shared uniform points and at points near each surface.

    Validation and scores use uniform points only, whose IoU estimates the volumetric IoU.
    """

    train_points: np.ndarray  #: (P, 3) float32, uniform, to train on
    train_inside: np.ndarray  #: (K, P) bool
    near_points: np.ndarray  #: (K, P, 3) float16, around each surface, to train on
    near_inside: np.ndarray  #: (K, P) bool
    val_points: np.ndarray  #: (V, 3) float32, uniform, to validate on
    val_inside: np.ndarray  #: (K, V) bool
    score_points: np.ndarray  #: (S, 3) float32, uniform, for the scores
    score_inside: np.ndarray  #: (K, S) bool
    grid_inside: np.ndarray  #: (K, G) uint8, packed bits at the nodes of `grid_points`
    resolution: np.ndarray  #: nodes along a side of that grid

    def grid(self, objects: np.ndarray) -> np.ndarray:
        """Return the occupancy at the nodes of the grid; (len(objects), resolution^3) bool."""
        return np.unpackbits(self.grid_inside[objects], axis=1, count=int(self.resolution) ** 3).astype(bool)

    def draw(self, labels: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw training points for objects (B,), half of them uniform, half near the surface.

        Returns points (B, count, 3) float32, and whether they are inside, (B, count) bool.
        """
        near = count // 2
        one = rng.integers(self.near_inside.shape[1], size=(len(labels), near))
        other = rng.integers(len(self.train_points), size=(len(labels), count - near))
        row = np.asarray(labels)[:, None]
        points = np.concatenate([self.near_points[row, one], self.train_points[other]], 1)
        inside = np.concatenate([self.near_inside[row, one], self.train_inside[row, other]], 1)
        return points.astype(np.float32), inside


def sample_occupancy(
    surfaces: Mapping[str, Callable[[], Isosurface]],
    train: int,
    val: int,
    score: int,
    resolution: int,
    seed: int,
) -> OccupancySamples:
    """Sample the occupancy of objects.

    ``surfaces`` load the stored surface by key, in label order; one is held at a time. Points are uniform and
    near the surface to ``train``, uniform to ``val`` and ``score``; the grid has ``resolution`` nodes a side.
    """
    pools = {
        name: uniform_points(count, numpy_generator(seed, "occupancy", name))
        for name, count in {"train": train, "val": val, "score": score}.items()
    }
    nodes = grid_points(resolution)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in [*pools, "near", "near_inside", "grid"]}
    for key, surface_of in surfaces.items():
        surface = surface_of()
        near = near_points(surface, train, numpy_generator(seed, "occupancy", "near", key))
        rows["near"].append(near)
        rows["near_inside"].append(is_inside(surface, near))
        rows["grid"].append(np.packbits(is_inside(surface, nodes)))
        for name, points in pools.items():
            rows[name].append(is_inside(surface, points))
    stacked = {name: np.stack(values) for name, values in rows.items()}
    drawn = {f"{name}_points": points for name, points in pools.items()}
    inside = {f"{name}_inside": stacked[name] for name in (*pools, "grid")}
    near_surface = {"near_points": stacked["near"], "near_inside": stacked["near_inside"]}
    return OccupancySamples(**drawn, **inside, **near_surface, resolution=np.asarray(resolution))


def cached_occupancy(
    path: Path,
    surfaces: Mapping[str, Callable[[], Isosurface]],
    digests: Mapping[str, str],
    train: int,
    val: int,
    score: int,
    resolution: int,
    seed: int,
) -> OccupancySamples:
    """Sample the occupancy of objects, or read the samples if they exist; see `sample_occupancy`.

    The ``.npz`` is rewritten if it holds other objects, by the digests of their Object Files in the same
    order, other sizes or another seed. Raises ObjectFolderError if a surface cannot be read, or the file is
    damaged.
    """
    sizes = f"{train} {val} {score} {resolution} {seed} {HALF_SIDE} {NEAR}"
    identity = np.array([*(f"{key} {digest}" for key, digest in digests.items()), sizes])
    if path.is_file():
        names = [field.name for field in fields(OccupancySamples)]
        arrays = read_npz(path, "identity", *names)
        if np.array_equal(arrays["identity"], identity):
            return OccupancySamples(**{name: arrays[name] for name in names})
    occupancy = sample_occupancy(surfaces, train, val, score, resolution, seed)
    write_npz(path, identity=identity, **vars(occupancy))
    return occupancy
