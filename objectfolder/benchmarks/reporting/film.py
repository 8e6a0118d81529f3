"""Short films of what policies do."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.io import atomic


def write_gif(path: Path, frames: Sequence[np.ndarray], seconds: float) -> None:
    """Write frames as a GIF that repeats.

    Parameters
    ----------
    path : Path
    frames : sequence of (H, W, 3) uint8 arrays
    seconds : float
        Each frame is shown, a multiple of 0.01.
    """
    first, *rest = [Image.fromarray(frame) for frame in frames]
    with atomic(path) as temporary:
        first.save(temporary, save_all=True, append_images=rest, duration=round(1000 * seconds), loop=0)
