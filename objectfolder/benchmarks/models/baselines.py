"""Baselines without nets: canonical correlation analysis (Hotelling 1936) for retrieval, trees for grasps."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from objectfolder.benchmarks.datasets.grasps import Grasps

RANK = 1e-10  #: relative variances, and correlations, below this are rounding errors
#: Inputs of each classifier.
GEOMETRY: dict[str, tuple[str, ...]] = {
    "geometry": ("width", "offset"),
    "geometry_force": ("width", "offset", "force"),
}
#: Names of all baselines.
BASELINES = ("majority", "object_majority", *GEOMETRY)


@dataclass(frozen=True)
class Whitening:
    """Affine map of features to their principal components, the largest first, each scaled to variance 1."""

    mean: np.ndarray  #: (D,)
    matrix: np.ndarray  #: (D, C)

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """(N, D) features -> (N, C) components."""
        return (features - self.mean) @ self.matrix


def fit_whitening(features: np.ndarray, dimensions: int) -> Whitening:
    """Find the principal components of (N, D) features, at most ``dimensions``."""
    mean = features.mean(0, dtype=np.float64)
    centred = features - mean
    variances, axes = np.linalg.eigh(centred.T @ centred / len(features))
    kept = np.flatnonzero(variances > RANK * variances[-1])[::-1][:dimensions]
    return Whitening(mean, axes[:, kept] / np.sqrt(variances[kept]))


def find_directions(
    first: np.ndarray, second: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the directions of two modalities that correlate most over pairs of the same object.

    Takes (N, D) and (N, E) features, both white (`fit_whitening`), and the objects (N,) of the rows of both.
    Each observation of an object pairs up equally with all observations of the same object in the other
    modality: the cross-covariance over all these pairs is that of the object means, independent of any random
    pairing. There are fewer directions than objects, because the means span no more.

    Returns (D, C) and (E, C) with orthonormal columns, the most correlated first: ``first @ left`` and
    ``second @ right`` are the canonical variates.
    """
    objects, members = np.unique(labels, return_inverse=True)
    membership = np.equal.outer(np.arange(len(objects)), members).astype(np.float64)
    counts = membership.sum(1, keepdims=True)
    cross = (membership @ first).T @ (membership @ second / counts) / len(labels)
    left, correlations, right = np.linalg.svd(cross, full_matrices=False)
    kept = correlations > RANK
    return left[:, kept], right[kept].T


def predict_outcomes(grasps: "Grasps", train: np.ndarray, test: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the decision values (m,) of all `BASELINES` for the m test rows: above 0 for success.

    Training rows have both outcomes. "majority": the most frequent outcome; "object_majority": that of the
    same object, or of all objects for one absent from training; "geometry": gradient boosted trees (Friedman
    2001) on the opening of the jaws and the offset from the centre of mass, "geometry_force" with the force
    of the jaws, too.
    """
    from sklearn.ensemble import GradientBoostingClassifier  # takes a second, and only grasps need it

    outcomes, labels = grasps.success[train], grasps.labels
    share = outcomes.mean()
    of_object = [outcomes[labels[train] == i] for i in range(len(grasps.keys))]
    shares = np.array([values.mean() if len(values) else share for values in of_object])
    answers = {"majority": np.full(len(test), share - 0.5), "object_majority": shares[labels[test]] - 0.5}
    for name, measured in GEOMETRY.items():
        trees = GradientBoostingClassifier(random_state=0).fit(_numbers(grasps, measured, train), outcomes)
        answers[name] = trees.decision_function(_numbers(grasps, measured, test))
    return answers


def _numbers(grasps: "Grasps", names: tuple[str, ...], rows: np.ndarray) -> np.ndarray:
    """Stack measured arrays as columns; (n, D) float64."""
    return np.column_stack([grasps.read(name, rows).astype(np.float64) for name in names])
