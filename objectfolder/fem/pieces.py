"""Restriction of a solid to its largest connected piece."""

import numpy as np

from objectfolder.errors import ObjectFolderError

MAX_DROPPED = 0.05  #: accepted volume fraction outside the main piece


def main_piece(piece: np.ndarray, volume: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Keep the largest connected piece of a solid: which elements (E,), and the dropped volume fraction.

    Takes the piece of each element (E,) and its volume (E,). Raises ObjectFolderError, with the object's
    name, if the other pieces hold more than `MAX_DROPPED` of the volume.
    """
    volumes = np.bincount(piece, weights=volume)
    share = np.sort(volumes / volumes.sum())[::-1]
    dropped = float(share[1:].sum())
    if dropped > MAX_DROPPED:
        shown = [f"{s:.2%}" for s in share[:5]] + ["..."] * (len(share) > 5)
        raise ObjectFolderError(
            f"{name}: the solid is in {len(share)} separate pieces "
            f"({', '.join(shown)} of the volume), expected one: "
            "join the mesh's parts, or split it into several objects"
        )
    return piece == volumes.argmax(), dropped
