"""Canonical correlation analysis (Hotelling 1936): the baseline of cross-sensory retrieval."""

from dataclasses import dataclass

import numpy as np

RANK = 1e-10  #: relative variances, and correlations, below this are rounding errors


@dataclass(frozen=True)
class Whitening:
    """Affine map of features to their principal components, the largest first, each scaled to variance 1."""

    mean: np.ndarray  #: (D,)
    matrix: np.ndarray  #: (D, C)

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """(N, D) features -> (N, C) components."""
        return (features - self.mean) @ self.matrix


def whitening(features: np.ndarray, dimensions: int) -> Whitening:
    """Find the principal components of (N, D) features, at most ``dimensions``."""
    mean = features.mean(0, dtype=np.float64)
    centred = features - mean
    variances, axes = np.linalg.eigh(centred.T @ centred / len(features))
    kept = np.flatnonzero(variances > RANK * variances[-1])[::-1][:dimensions]
    return Whitening(mean, axes[:, kept] / np.sqrt(variances[kept]))


def directions(first: np.ndarray, second: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the directions of two modalities that correlate most over pairs of the same object.

    Each observation of an object pairs up equally with all observations of the same object in the other
    modality: the cross-covariance over all these pairs is that of the object means, independent of any random
    pairing. There are fewer directions than objects, because the means span no more.

    Parameters
    ----------
    first : (N, D) array
    second : (N, E) array
        Both white, see `whitening`.
    labels : (N,) int array
        Objects of the rows of both.

    Returns
    -------
    (D, C) and (E, C) arrays with orthonormal columns, the most correlated first: ``first @ left`` and
    ``second @ right`` are the canonical variates.
    """
    objects, members = np.unique(labels, return_inverse=True)
    membership = np.equal.outer(np.arange(len(objects)), members).astype(np.float64)
    counts = membership.sum(1, keepdims=True)
    cross = (membership @ first).T @ (membership @ second / counts) / len(labels)
    left, correlations, right = np.linalg.svd(cross, full_matrices=False)
    kept = correlations > RANK
    return left[:, kept], right[kept].T
