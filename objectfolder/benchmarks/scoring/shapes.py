"""Scores of reconstructed shapes, as Occupancy Networks (Mescheder et al. 2019) defines them.

Lengths are in the unit frame: 1 is the object's longest side. The figures of ObjectFolder's Table 4 must be
in this unit too: 0.0046 for images is 0.46 % of the longest side, which goes with an IoU of 0.88 and is what
two samples of 100,000 points can tell; in the unit of the Occupancy Networks paper, a tenth of the side, it
would be a tenth of that, far below what they can. Multiply by ten to compare with that paper.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from objectfolder.benchmarks.datasets.occupancy import HALF_SIDE, surface_points

EMPTY_CHAMFER = math.sqrt(3)  #: of no surface at all: the unit cube's diagonal, as the authors' code has it


@dataclass(frozen=True)
class Surface:
    """Points of a surface, uniform by area, their unit normals, and a tree to find the nearest."""

    points: np.ndarray  #: (N, 3)
    normals: np.ndarray  #: (N, 3)
    tree: cKDTree


def sampled_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> Surface | None:
    """Sample a triangle surface; None where there are no triangles."""
    if not len(faces):
        return None
    points, normals = surface_points(vertices, faces, count, rng)
    return Surface(points, normals, cKDTree(points))


def intersection_over_union(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Volume in both over volume in either, estimated by the same uniform points.

    Parameters
    ----------
    predicted, truth : (..., P) bool arrays

    Returns
    -------
    (...) float64
        1 where both are empty.
    """
    union = (predicted | truth).sum(-1)
    return np.where(union == 0, 1.0, (predicted & truth).sum(-1) / np.maximum(union, 1))


def surface_scores(predicted: Surface | None, truth: Surface) -> tuple[float, float]:
    """Chamfer-L1 distance and normal consistency.

    Chamfer-L1: the mean of accuracy and completeness, which are the mean distances from the points of one
    surface to the nearest point of the other. Normal consistency: the mean, over both ways, of the absolute
    cosine between normals at those pairs; absolute, because the definition takes no notice of orientation.
    Between two samples of one surface of area A the distance is not 0 but about sqrt(A / N) / 2.

    Parameters
    ----------
    predicted : Surface or None
        None, an empty prediction, scores `EMPTY_CHAMFER` and 0.
    truth : Surface

    Returns
    -------
    chamfer_l1 : float
        In units of the longest side.
    normal_consistency : float
        0 to 1.
    """
    if predicted is None:
        return EMPTY_CHAMFER, 0.0
    distances, cosines = zip(*(_one_way(a, b) for a, b in ((predicted, truth), (truth, predicted))))
    return float(np.mean(distances)), float(np.mean(cosines))


def _one_way(source: Surface, target: Surface) -> tuple[float, float]:
    distance, nearest = target.tree.query(source.points)
    cosine = np.abs((source.normals * target.normals[nearest]).sum(1))
    return float(distance.mean()), float(cosine.mean())


def extract_mesh(occupancy: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Surface of the places whose occupancy is above a threshold, by marching cubes.

    Parameters
    ----------
    occupancy : (R, R, R) array
        At the nodes of `objectfolder.benchmarks.datasets.occupancy.grid_points`; probabilities or logits.
        Smooth values give a smooth surface.
    threshold : float
        Of the same kind. Where the occupancy at the border is above it, the surface is closed just outside.

    Returns
    -------
    vertices : (V, 3) float64, unit frame
    faces : (F, 3) int64, counter-clockwise seen from outside; none where nothing is above the threshold
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
