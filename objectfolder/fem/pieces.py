"""A solid that vibrates is one piece."""

import numpy as np

from objectfolder.errors import ObjectFolderError

MAX_DROPPED = 0.05  #: share of the volume in specks beside the main piece


def main_piece(piece: np.ndarray, volume: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Keep the largest piece of a solid.

    Parameters
    ----------
    piece : (E,) int array
        Connected piece that each element belongs to.
    volume : (E,) array
        Their volumes.
    name : str
        Named in errors.

    Returns
    -------
    keep : (E,) bool
    dropped : float
        Share of the volume that is not kept: specks.

    Raises
    ------
    ObjectFolderError
        If other pieces hold more than `MAX_DROPPED`.
    """
    volumes = np.bincount(piece, weights=volume)
    share = np.sort(volumes / volumes.sum())[::-1]
    dropped = float(share[1:].sum())
    if dropped > MAX_DROPPED:
        shown = [f"{s:.2%}" for s in share[:5]] + ["..."] * (len(share) > 5)
        raise ObjectFolderError(
            f"{name}: the solid is in {len(share)} pieces that touch nowhere "
            f"({', '.join(shown)} of the volume), expected one: "
            "join the mesh's parts, or make several objects of it"
        )
    return piece == volumes.argmax(), dropped
