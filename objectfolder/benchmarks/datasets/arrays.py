"""Arrays of several objects, as many rows of each, memory-mapped and read as one."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objectfolder.errors import ObjectFolderError


def map_array(key: str, path: Path, again: str) -> np.ndarray:
    """Map the ``.npy`` file of an object, read-only; nothing is unpickled.

    Parameters
    ----------
    key : str
        The object, for errors.
    path : Path
    again : str
        What to do about a damaged file; ends the error's message.

    Raises
    ------
    ObjectFolderError
        If the file is missing, damaged, or no array of numbers.
    """
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ObjectFolderError(f"{key}: {path} is damaged ({error}); {again}") from error


def read_rows(arrays: Sequence[np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Read rows of arrays of equal shape (N, ...); row r is number ``r % N`` of array ``r // N``.

    Parameters
    ----------
    arrays : sequence of arrays
    rows : (B,) int array
        In any order, also twice.

    Returns
    -------
    (B, ...) array

    Raises
    ------
    IndexError
        If there is no such row.
    """
    rows, count = np.asarray(rows, np.int64), len(arrays[0])
    wrong = rows[(rows < 0) | (rows >= len(arrays) * count)]
    if len(wrong):
        raise IndexError(f"row {wrong[0]} of {len(arrays) * count}")
    objects, within = np.divmod(rows, count)
    out = np.empty((len(rows), *arrays[0].shape[1:]), arrays[0].dtype)
    for i in np.unique(objects):
        mine = objects == i
        out[mine] = arrays[i][within[mine]]
    return out
