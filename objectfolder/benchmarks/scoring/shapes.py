"""Scores of reconstructed shapes, as defined by Occupancy Networks (Mescheder et al. 2019).

Lengths are in the unit frame, where the object's longest side is 1. ObjectFolder's Table 4 must use the same
unit: 0.0046 for images is 0.46 % of the longest side, which is plausible for an IoU of 0.88 and close to what
two samples of 100,000 points can resolve. The Occupancy Networks paper uses a tenth of the side as its unit:
multiply by ten to compare with it.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from objectfolder.mesh.sampling import sample_faces

EMPTY_CHAMFER = math.sqrt(3)  #: of an empty prediction: the unit cube's diagonal, as in the authors' code


@dataclass(frozen=True)
class SampledSurface:
    """Points uniform by area on a surface, with unit normals and a tree for nearest-neighbour queries."""

    points: np.ndarray  #: (N, 3)
    normals: np.ndarray  #: (N, 3)
    tree: cKDTree


def surface_points(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Sample points uniform by area with the unit normals of their triangles; two (count, 3) float64."""
    points, face = sample_faces(vertices, faces, count, rng)
    a, b, c = (np.asarray(vertices, np.float64)[faces[face, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return points, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def sample_mesh(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> SampledSurface | None:
    """Sample a triangle mesh; None if it has no triangles."""
    if not len(faces):
        return None
    points, normals = surface_points(vertices, faces, count, rng)
    return SampledSurface(points, normals, cKDTree(points))


def intersection_over_union(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Estimate the volumetric IoU from the same uniform points; (...) float64, 1 where both are empty."""
    union = (predicted | truth).sum(-1)
    return np.where(union == 0, 1.0, (predicted & truth).sum(-1) / np.maximum(union, 1))


def surface_scores(predicted: SampledSurface | None, truth: SampledSurface) -> tuple[float, float]:
    """Compute the Chamfer-L1 distance, in longest sides, and the normal consistency, 0 to 1.

    Chamfer-L1 is the mean of accuracy and completeness: the mean distances from the points of one surface to
    the nearest points of the other, in both directions. Normal consistency is the mean absolute cosine
    between the normals of these pairs, in both directions; the sign is ignored, as in the definition. Two
    samples of one surface of area A are about sqrt(A / N) / 2 apart, not 0. An empty prediction, None, scores
    `EMPTY_CHAMFER` and 0.
    """
    if predicted is None:
        return EMPTY_CHAMFER, 0.0
    distances, cosines = zip(*(_one_way(a, b) for a, b in ((predicted, truth), (truth, predicted))))
    return float(np.mean(distances)), float(np.mean(cosines))


def _one_way(source: SampledSurface, target: SampledSurface) -> tuple[float, float]:
    distance, nearest = target.tree.query(source.points)
    cosine = np.abs((source.normals * target.normals[nearest]).sum(1))
    return float(distance.mean()), float(cosine.mean())
