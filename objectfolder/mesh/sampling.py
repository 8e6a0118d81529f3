"""Random points on a triangle surface."""

import numpy as np


def sample_faces(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Sample points uniformly by area, (count, 3) float64, with their faces, (count,) int64.

    Degenerate faces are never sampled.
    """
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    return a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face]), face


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Sample points uniformly by area; (count, 3) float64."""
    return sample_faces(vertices, faces, count, rng)[0]


def split_rows(count: int, rng: np.random.Generator) -> np.ndarray:
    """Assign rows to splits at random; (count,) int8: 0 train, and a tenth each 1 val, 2 test."""
    order = rng.permutation(count)
    split = np.zeros(count, np.int8)
    tenth = round(0.1 * count)
    split[order[:tenth]] = 1
    split[order[tenth : 2 * tenth]] = 2
    return split
