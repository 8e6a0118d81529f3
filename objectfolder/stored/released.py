"""Kinds of nets that occur only in imported Object Files.

Modules are named by strings and imported on demand. The build never makes such nets, so its stages must not
depend on their code, and stage dependencies follow import statements.
"""

from importlib import import_module
from typing import Any

import numpy as np

#: Module, class, and what the net is asked for, by kind.
RELEASED = {
    "released_nerf": ("vision.released_nerf", "ReleasedNerf", "pictures"),
    "released_kilo": ("vision.released_kilo", "ReleasedKilo", "pictures"),
    "released_gains": ("sound.released_gains", "ReleasedGains", "modes"),
    "released_spectrogram": ("sound.released_spectrogram", "ReleasedSpectrogram", "spectrograms"),
    "released_image": ("touch.released_images", "ReleasedImage", "images"),
    "released_depth": ("touch.released_images", "ReleasedDepth", "depth maps"),
}


def released_net(kind: str) -> Any:
    """Return the net class of a kind."""
    module, name, _ = RELEASED[kind]
    return getattr(import_module(f"objectfolder.{module}"), name)


def trained_box(described: dict[str, Any]) -> np.ndarray | None:
    """Return the lowest and highest coordinates that a part's net was trained on, if it says; (2, 3)."""
    if described["kind"] in ("released_gains", "released_depth"):
        return np.array(described["net"]["bounds"], np.float64)
    if described["kind"] == "released_image":  # one pair for all axes
        return np.repeat(np.array(described["net"]["coordinates"], np.float64)[:, None], 3, 1)
    return None
