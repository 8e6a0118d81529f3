"""Short animations of policies."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.base.io import atomic_stream

SUCCESS, FAILURE = (30, 150, 60), (190, 40, 40)  #: sRGB of the mark
MARK = 6  #: height of the mark, pixels


def mark_outcome(frame: np.ndarray, success: bool) -> np.ndarray:
    """Copy a frame (H, W, 3) and mark it with a line at the bottom: green for success, red for failure."""
    marked = np.array(frame)
    marked[-MARK:] = SUCCESS if success else FAILURE
    return marked


def write_gif(path: Path, frames: Sequence[np.ndarray], seconds: float) -> None:
    """Write frames as a looping GIF; ``seconds``, a multiple of 0.01, is the duration of each."""
    first, *rest = [Image.fromarray(frame) for frame in frames]
    with atomic_stream(path) as stream:
        first.save(stream, "GIF", save_all=True, append_images=rest, duration=round(1000 * seconds), loop=0)
