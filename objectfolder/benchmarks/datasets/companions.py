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
        """Return each of the rows with others of its object and part at random.

        All are different as far as there are ``count`` of them; the others are repeated in turn if not.

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
        rows = np.asarray(rows)
        groups = self._group[rows]
        first, end = (np.searchsorted(self._sorted, groups, side) for side in ("left", "right"))
        size = (end - first)[:, None]
        place = np.arange(size.max(initial=1))
        members = self._order[np.minimum(first[:, None] + place, end[:, None] - 1)]
        key = rng.random(members.shape)
        key[members == rows[:, None]] = 2  # itself after all others
        key[place >= size] = 3
        shuffled = np.take_along_axis(members, key.argsort(1), 1)
        others = np.arange(count - 1) % np.maximum(size - 1, 1)
        return np.concatenate([rows[:, None], np.take_along_axis(shuffled, others, 1)], 1)
