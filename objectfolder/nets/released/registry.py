"""Kinds of nets that only imported Object Files hold.

Modules are named by strings and imported on demand. The build never makes such nets, so the code lists of its
stages, which follow import statements, must not hold them.
"""

from importlib import import_module
from typing import Any

KINDS = {
    "released_nerf": ("vision", "ReleasedNerf"),
    "released_kilo": ("kilo", "ReleasedKilo"),
    "released_gains": ("gains", "ReleasedGains"),
    "released_spectrogram": ("spectrogram", "ReleasedSpectrogram"),
    "released_image": ("touch", "ReleasedImage"),
    "released_depth": ("touch", "ReleasedDepth"),
}


def released_net(kind: str) -> Any:
    """Return the class of the nets of a kind."""
    module, name = KINDS[kind]
    return getattr(import_module(f"objectfolder.nets.released.{module}"), name)


def released_kind(net: object) -> str:
    """Return the kind of a net."""
    return next(kind for kind, (_, name) in KINDS.items() if name == type(net).__name__)
