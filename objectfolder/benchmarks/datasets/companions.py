"""Other observations of the same object, to be sensed together."""

import numpy as np

from objectfolder.benchmarks.datasets.splits import Split


class Companions:
    """The rows of a split by object and part, to draw from.

    Parameters
    ----------
    split : Split
    labels : (N,) int array
        Objects of all observations.
    """

    def __init__(self, split: Split, labels: np.ndarray):
        self._group = np.full(len(labels), -1)  #: one for each object and part
        for number, rows in enumerate((split.train, split.val, split.test)):
            self._group[rows] = 3 * labels[rows] + number
        self._order = np.argsort(self._group, kind="stable")
        self._sorted = self._group[self._order]

    def draw(self, rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return each of the rows with others of its object and part at random, which may repeat.

        Parameters
        ----------
        rows : (n,) int array
            Rows of the split.
        count : int
            Rows in each group, its own included.
        rng : numpy Generator

        Returns
        -------
        (n, count) int64 array
            The rows themselves are the first column.
        """
        groups = self._group[rows]
        first, end = (np.searchsorted(self._sorted, groups, side) for side in ("left", "right"))
        others = rng.integers(first[:, None], end[:, None], (len(rows), count - 1))
        return np.concatenate([np.asarray(rows)[:, None], self._order[others]], 1)
