"""Scores of predictions: accuracy, mean average precision, and confidence intervals."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from objectfolder.base.errors import ObjectFolderError

BLOCK = 256  #: queries ranked at a time, which bounds memory for large galleries
SCALE = 10**9  #: cosines are ranked as multiples of 1 / SCALE; far finer than float32 embeddings resolve
LEAST = 1e-300  #: product of probabilities that is told from 0; products are ranked by their logarithm
NEVER = -2 * SCALE  #: similarity of what must not be found


def accuracy(predicted: np.ndarray, labels: np.ndarray) -> float:
    """Compute the fraction of correct labels, in [0, 1].

    Raises ObjectFolderError if the arrays are empty or differ in shape.
    """
    predicted, labels = np.asarray(predicted), np.asarray(labels)
    if predicted.shape != labels.shape or not labels.size:
        raise ObjectFolderError(
            f"predictions have shape {predicted.shape}, labels {labels.shape}; expected equal and not empty"
        )
    return float(np.mean(predicted == labels))


def interval_95(values: Sequence[float]) -> float | None:
    """Compute the half width of the 95 % confidence interval of a mean (Student's t).

    The values are independent, such as the scores of several training seeds. None for fewer than two, whose
    spread is unknown.
    """
    count = len(values)
    if count < 2:
        return None
    return float(stats.t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))


def over_seeds(name: str, values: Sequence[float]) -> dict[str, Any]:
    """Return the mean score under its name, its ``interval_95``, and its values, by training seed."""
    return {name: float(np.mean(values)), "interval_95": interval_95(values), "seeds": list(values)}


def wilson_95(successes: int, trials: int) -> tuple[float, float]:
    """Compute the 95 % confidence interval of a success probability (Wilson 1927); both ends in [0, 1]."""
    interval = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def share_95(success: np.ndarray) -> dict[str, Any]:
    """Compute the ``rate`` of success over all episodes, and its ``interval_95`` (`wilson_95`)."""
    interval = wilson_95(int(np.sum(success)), np.size(success))
    return {"rate": float(np.mean(success)), "interval_95": list(interval)}


def mean_average_precision(
    queries: np.ndarray,
    query_labels: np.ndarray,
    gallery: np.ndarray,
    gallery_labels: np.ndarray,
    own: bool = False,
    cosine: bool = True,
) -> float:
    """Compute the mean average precision of ranking a gallery by cosine similarity (main paper, Table 3).

    A gallery row is relevant to a query of the same label. Average precision is the mean precision at the
    ranks of the relevant rows. Rows of equal similarity contribute the exact mean over all their orders
    (McSherry and Najork 2008), so that the score does not depend on the order of the gallery and identical
    embeddings score `chance_map`. A zero embedding has similarity 0 to everything.

    With ``own``, the queries are the first rows of the gallery, and none finds itself. Without ``cosine``,
    rows are probabilities of the same classes, and the gallery is ranked by their product: the probability
    that two rows, taken alone, are of the same class. The score is in [0, 1]; 1 if the relevant rows of every
    query come first. Raises ObjectFolderError if there is no query, an embedding is not finite, or a query
    has no relevant row.
    """
    given = [_finite(name, value) for name, value in (("query", queries), ("gallery", gallery))]
    rows = [_unit(value) for value in given] if cosine else given
    query_labels, gallery_labels = np.asarray(query_labels), np.asarray(gallery_labels)
    _relevant_counts(gallery_labels, query_labels, own)
    precisions = []
    for start in range(0, len(query_labels), BLOCK):
        close = rows[0][start : start + BLOCK] @ rows[1].T
        if not cosine:
            close = np.log(np.maximum(close, LEAST)) / -np.log(LEAST)  # in [-1, 0]
        similarity = np.rint(close * SCALE).astype(np.int64)
        relevant = query_labels[start : start + BLOCK, None] == gallery_labels
        if own:  # ranked last, and not relevant
            each = np.arange(len(similarity))
            similarity[each, start + each], relevant[each, start + each] = NEVER, False
        precisions.append(_average_precisions(similarity, relevant))
    return float(np.mean(np.concatenate(precisions)))


def chance_map(gallery_labels: np.ndarray, query_labels: np.ndarray, own: bool = False) -> float:
    """Compute the expected mean average precision of a random ranking of the gallery.

    If R of N rows are relevant, rank k holds a relevant row with probability R/N, preceded by
    (k-1)(R-1)/(N-1) relevant rows on average. The sum of the precisions at all ranks, divided by R, is
    (H + (R-1)/(N-1) (N - H)) / N with the harmonic number H = 1 + 1/2 + ... + 1/N: slightly above R/N.

    ``own`` is as in `mean_average_precision`. Raises ObjectFolderError if there is no query, or a query has
    no relevant row.
    """
    gallery_labels = np.asarray(gallery_labels)
    relevant = _relevant_counts(gallery_labels, np.asarray(query_labels), own)
    count = len(gallery_labels) - own
    harmonic = np.sum(1 / np.arange(1, count + 1))
    share = (relevant - 1) / max(count - 1, 1)
    return float(np.mean((harmonic + share * (count - harmonic)) / count))


def _finite(name: str, embeddings: np.ndarray) -> np.ndarray:
    embeddings = np.asarray(embeddings, np.float64)
    wrong = np.flatnonzero(~np.isfinite(embeddings).all(1))
    if wrong.size:
        raise ObjectFolderError(
            f"{name} embedding {wrong[0]} is not finite: training diverged; use a smaller learning_rate"
        )
    return embeddings


def _unit(embeddings: np.ndarray) -> np.ndarray:
    largest = np.abs(embeddings).max(1, keepdims=True)  # scaled first, because squares may underflow
    embeddings = embeddings / np.where(largest > 0, largest, 1)
    length = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return embeddings / np.where(length > 0, length, 1)


def _relevant_counts(gallery_labels: np.ndarray, query_labels: np.ndarray, own: bool) -> np.ndarray:
    """Count the gallery rows relevant to each query, (Q,), without its own."""
    if not query_labels.size:
        raise ObjectFolderError("no query to rank the gallery for; expected at least one")
    known, counts = np.unique(gallery_labels, return_counts=True)
    if own:
        known, counts = known[counts > 1], counts[counts > 1] - 1
    missing = np.setdiff1d(query_labels, known)
    if missing.size:
        raise ObjectFolderError(
            f"no gallery row is relevant to queries of label {missing[0]}; add gallery rows of that label"
        )
    return counts[np.searchsorted(known, query_labels)]


def _average_precisions(similarity: np.ndarray, relevant: np.ndarray) -> np.ndarray:
    """Compute the average precision of each row of (B, G) similarities, over all orders of ties; (B,).

    Similarities are integers of at most `SCALE`, or `NEVER` for entries ranked last.
    """
    rows, width = similarity.shape
    # One sorted list for all rows: each has an interval of its own, the most similar first.
    keys = 4 * SCALE * np.arange(rows)[:, None] - similarity
    ranked = np.sort(keys, axis=1).ravel()
    # Only runs of ties that hold relevant entries count.
    runs, own = np.unique(keys[relevant], return_counts=True)
    first, end = (np.searchsorted(ranked, runs, side) for side in ("left", "right"))
    row = first // width
    before, last, size = first - row * width, end - row * width, end - first
    seen = np.cumsum(own) - own
    starts = np.searchsorted(row, np.arange(rows))
    found = seen - seen[starts][row]
    # As in `chance_map`, but within the run: rank k follows found + (k - 1 - before) slope relevant ones.
    harmonic = np.concatenate([[0], np.cumsum(1 / np.arange(1, width + 1))])
    slope = (own - 1) / np.maximum(size - 1, 1)
    inverse = np.where(size > 1, harmonic[last] - harmonic[before], 1 / last)
    terms = own / size * ((1 + found - (1 + before) * slope) * inverse + slope * size)
    return np.add.reduceat(terms, starts) / np.add.reduceat(own, starts)
