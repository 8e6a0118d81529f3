"""Sounds as players in a notebook."""

from importlib import import_module
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError

PEAK_LEVEL = 0.9  #: of full scale


def players(sounds: np.ndarray, sample_rate: float) -> list[Any]:
    """Return a player of each sound, (N, samples) or (samples,); their levels stay relative to each other.

    Raises ObjectFolderError if IPython is missing, which every notebook has.
    """
    try:
        audio = import_module("IPython.display").Audio
    except ImportError as error:
        raise ObjectFolderError(
            "players of sounds need IPython: `pip install ipython`, or write a WAV file"
        ) from error
    rows = np.atleast_2d(np.asarray(sounds, np.float64))
    peak = np.abs(rows).max(initial=0.0)
    scaled = rows * (PEAK_LEVEL / peak if peak > 0 else 0.0)
    return [audio(data=row, rate=sample_rate, normalize=False) for row in scaled]
