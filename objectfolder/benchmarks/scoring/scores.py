"""How good answers are: accuracy, mean average precision, and how sure we are of a mean."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from objectfolder.errors import ObjectFolderError

BLOCK = 256  #: queries that are ranked at a time, so that a large gallery takes little memory
DECIMALS = 9  #: cosines that agree so far are tied; far below what float32 embeddings resolve


def accuracy(predicted: np.ndarray, labels: np.ndarray) -> float:
    """Fraction of predicted labels that are right, in [0, 1].

    Parameters
    ----------
    predicted, labels : (N,) int array

    Raises
    ------
    ObjectFolderError
        If there are none, or not as many of one as of the other.
    """
    predicted, labels = np.asarray(predicted), np.asarray(labels)
    if predicted.shape != labels.shape or not labels.size:
        raise ObjectFolderError(
            f"accuracy of {predicted.shape} predictions for {labels.shape} labels; expected as many, not none"
        )
    return float(np.mean(predicted == labels))


def interval_95(values: Sequence[float]) -> float | None:
    """Half width of the 95 % confidence interval of a mean (Student's t), such as over training seeds.

    Returns
    -------
    In the unit of the values; None for fewer than two of them, which tell nothing about their spread.
    """
    count = len(values)
    if count < 2:
        return None
    return float(stdtrit(count - 1, 0.975) * np.std(values, ddof=1) / np.sqrt(count))


def wilson_95(share: float, count: int) -> tuple[float, float]:
    """95 % confidence interval of a probability, of which a share was observed (Wilson 1927).

    Parameters
    ----------
    share : float
        Of successes, in [0, 1].
    count : int
        Of independent trials.

    Returns
    -------
    Lower and upper end, within [0, 1].
    """
    z = ndtri(0.975)
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2)) / (1 + z**2 / count)
    return float(max(middle - half, 0)), float(min(middle + half, 1))


def share_95(success: np.ndarray) -> dict[str, Any]:
    """Rate of success and its 95 % interval (`wilson_95`), over all episodes together.

    Parameters
    ----------
    success : bool array of any shape

    Returns
    -------
    dict
        ``rate`` and ``interval_95``, a list of both ends.
    """
    rate = float(np.mean(success))
    return {"rate": rate, "interval_95": list(wilson_95(rate, np.size(success)))}


def mean_average_precision(
    queries: np.ndarray, query_labels: np.ndarray, gallery: np.ndarray, gallery_labels: np.ndarray
) -> float:
    """Mean average precision of ranking a gallery by cosine similarity (main paper, Table 3).

    A gallery row is relevant to a query of the same label. Average precision is the mean, over the relevant
    rows, of the precision at each one's rank. Rows of equal similarity have no order: their average precision
    is the exact mean over all their orders (McSherry and Najork 2008), which depends neither on the labels
    nor on the order of the gallery. So embeddings that are all the same score `chance_map`. A zero
    embedding has similarity 0 to everything.

    Parameters
    ----------
    queries : (Q, D) array
    query_labels : (Q,) int array
    gallery : (G, D) array
    gallery_labels : (G,) int array

    Returns
    -------
    In [0, 1], 1 if every query's relevant rows come first.

    Raises
    ------
    ObjectFolderError
        If there is no query, an embedding is not finite, or nothing is relevant to a query.
    """
    unit = [_unit(name, value) for name, value in (("query", queries), ("gallery", gallery))]
    query_labels, gallery_labels = np.asarray(query_labels), np.asarray(gallery_labels)
    _relevant_counts(gallery_labels, query_labels)
    precisions = [
        _average_precisions(
            np.round(unit[0][start : start + BLOCK] @ unit[1].T, DECIMALS),
            query_labels[start : start + BLOCK, None] == gallery_labels,
        )
        for start in range(0, len(query_labels), BLOCK)
    ]
    return float(np.mean(np.concatenate(precisions)))


def chance_map(gallery_labels: np.ndarray, query_labels: np.ndarray) -> float:
    """Exact mean average precision that a random ranking of the gallery is expected to have.

    With R relevant of N rows, rank k holds a relevant row with probability R/N, and then (k-1)(R-1)/(N-1) of
    the rows before it are expected to be relevant. The sum of the precisions at all ranks, divided by R, is
    (H + (R-1)/(N-1) (N - H)) / N with the harmonic number H = 1 + 1/2 + ... + 1/N: a little above R/N.

    Parameters
    ----------
    gallery_labels : (G,) int array
    query_labels : (Q,) int array

    Raises
    ------
    ObjectFolderError
        If there is no query, or nothing is relevant to one.
    """
    gallery_labels = np.asarray(gallery_labels)
    relevant = _relevant_counts(gallery_labels, np.asarray(query_labels))
    count = len(gallery_labels)
    harmonic = np.sum(1 / np.arange(1, count + 1))
    share = (relevant - 1) / max(count - 1, 1)
    return float(np.mean((harmonic + share * (count - harmonic)) / count))


def _unit(name: str, embeddings: np.ndarray) -> np.ndarray:
    embeddings = np.asarray(embeddings, np.float64)
    wrong = np.flatnonzero(~np.isfinite(embeddings).all(1))
    if wrong.size:
        raise ObjectFolderError(
            f"{name} embedding {wrong[0]} is not finite; the training diverged: lower its learning rate"
        )
    largest = np.abs(embeddings).max(1, keepdims=True)  # before the squares, which may underflow
    embeddings = embeddings / np.where(largest > 0, largest, 1)
    length = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return embeddings / np.where(length > 0, length, 1)


def _relevant_counts(gallery_labels: np.ndarray, query_labels: np.ndarray) -> np.ndarray:
    """Count the gallery rows relevant to each query, (Q,)."""
    if not query_labels.size:
        raise ObjectFolderError("there is no query to rank the gallery for; expected one or more")
    known, counts = np.unique(gallery_labels, return_counts=True)
    missing = np.setdiff1d(query_labels, known)
    if missing.size:
        raise ObjectFolderError(
            f"nothing in the gallery is relevant to queries of label {missing[0]}; add some"
        )
    return counts[np.searchsorted(known, query_labels)]


def _average_precisions(similarity: np.ndarray, relevant: np.ndarray) -> np.ndarray:
    """Average precision of each row of (B, G) similarities, expected over the orders of ties, (B,)."""
    order = np.argsort(-similarity, axis=1, kind="stable")
    similarity = np.take_along_axis(similarity, order, 1)
    seen = np.cumsum(np.take_along_axis(relevant, order, 1), axis=1)
    rank = np.arange(1, similarity.shape[1] + 1)
    # Of the run of ties that a rank lies in: ranks before it, and its last rank.
    new = np.ones(similarity.shape, bool)
    new[:, 1:] = similarity[:, 1:] != similarity[:, :-1]
    before = np.maximum.accumulate(np.where(new, rank - 1, 0), axis=1)
    ends = np.concatenate([new[:, 1:], np.ones((len(new), 1), bool)], axis=1)
    last = np.minimum.accumulate(np.where(ends, rank, rank[-1])[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(seen, ((0, 0), (1, 0)))
    found = np.take_along_axis(padded, before, 1)
    own = np.take_along_axis(padded, last, 1) - found
    size = last - before
    # As in `chance_map`, within the run.
    earlier = found + (rank - 1 - before) * (own - 1) / np.maximum(size - 1, 1)
    return np.sum(own / size * (1 + earlier) / rank, axis=1) / seen[:, -1]
