"""Recognition by several observations of an object together, and what bounds it where some tell nothing."""

import numpy as np
from scipy.special import comb

DRAWS = 100  #: random groups of observations of each object


def accuracy_together(
    log_probabilities: np.ndarray,
    labels: np.ndarray,
    objects: np.ndarray,
    size: int,
    rng: np.random.Generator,
) -> float | None:
    """Compute the accuracy of answers from groups of observations of one object.

    A group's answer is the class of the largest mean log probability, which is exact for observations that
    are independent given the class. Takes log probabilities (N, K) of the classes, class and object (N,) of
    each observation, and the ``size`` of a group, drawn at random without replacement; observations alone are
    taken once each. Returns the mean over objects with at least so many observations; None if there is none.
    """
    rates = []
    for found in np.unique(objects):
        rows = np.flatnonzero(objects == found)
        if len(rows) < size:
            continue
        groups = (
            rng.random((DRAWS, len(rows))).argsort(1)[:, :size] if size > 1 else np.arange(len(rows))[:, None]
        )
        answers = log_probabilities[rows][groups].sum(1).argmax(1)
        rates.append(np.mean(answers == labels[rows[0]]))
    return float(np.mean(rates)) if rates else None


def bound_together(flat: np.ndarray, labels: np.ndarray, objects: np.ndarray, size: int) -> float | None:
    """Compute a bound of `accuracy_together` where flat observations (N,) cannot be told from each other.

    All groups that hold another observation are taken to be answered correctly, and all others alike, by the
    class with most of them.
    """
    classes, hidden = [], []
    for found in np.unique(objects):
        rows = np.flatnonzero(objects == found)
        if len(rows) >= size:
            classes.append(labels[rows[0]])
            hidden.append(comb(int(flat[rows].sum()), size) / comb(len(rows), size))
    if not classes:
        return None
    guessed = np.bincount(classes, hidden).max()
    return float(1 - (np.sum(hidden) - guessed) / len(hidden))


def bound_alone(flat: np.ndarray, labels: np.ndarray) -> float:
    """Compute the bound of the accuracy over all observations, each alone; see `bound_together`."""
    guessed = np.bincount(labels[flat]).max() if flat.any() else 0
    return float(1 - (flat.sum() - guessed) / len(flat))
