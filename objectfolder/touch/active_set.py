"""Contact of an elastic layer where it is known which pixels touch: a linear problem."""

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.gel import Layer, precondition, respond, within_reach

ACCURACY = 1e-10  #: of a displacement, relative to the greatest
_MAX_ITERATIONS = 1000  # iterations; typically a hundred
_MAX_SET_CHANGES = 100  # changes of the active set; typically ten


def supporting_pressure(
    displacement: np.ndarray, active: np.ndarray, pitch: float, layer: Layer, accuracy: float = ACCURACY
) -> np.ndarray:
    """Return the pressure on some pixels that moves them by given displacements, Pa; (H, W) float64.

    Conjugate gradients with the preconditioner of `objectfolder.touch.gel`, to an accuracy relative to the
    greatest displacement. Displacement (H, W), metres, counts at the active pixels (H, W) bool only; the
    pitch is metres between pixels. Raises ObjectFolderError if the iteration does not converge.
    """
    residual = np.where(active, displacement, 0.0).astype(np.float64)
    pressure, limit = np.zeros_like(residual), accuracy * np.abs(residual).max(initial=0)
    unit = np.abs(residual).max(initial=0) or 1.0  # the preconditioner has single precision
    way, before = np.zeros_like(residual), 1.0
    for _ in range(_MAX_ITERATIONS):
        if np.abs(residual).max(initial=0) <= limit:
            return pressure
        steepest = unit * precondition((residual / unit).astype(np.float32), pitch, layer) * active
        now = np.vdot(residual, steepest)
        way = steepest + now / before * way if way.any() else steepest
        moved = np.where(active, respond(way, pitch, layer), 0)
        step = now / np.vdot(way, moved)
        pressure += step * way
        residual -= step * moved
        before = now
    raise ObjectFolderError(
        f"the pressure on a gel of {layer} did not converge in {_MAX_ITERATIONS} iterations; "
        "try a smaller depth, or dtype float32"
    )


def settle(
    height: np.ndarray, pressure: np.ndarray, pitch: float, layer: Layer
) -> tuple[np.ndarray, np.ndarray]:
    """Solve a contact to rounding, from an approximate pressure, by a primal-dual active set method.

    Hintermüller, Ito and Kunisch, SIAM Journal on Optimization 13, 2002. Takes heights (H, W) as of
    `objectfolder.touch.gel.indent` and a pressure (H, W), Pa, whose support is the first guess of the pixels
    that touch; returns displacement, metres, and pressure, Pa, (H, W) float64. Raises ObjectFolderError if
    the set of touching pixels does not settle.
    """
    reachable = within_reach(height, layer.thickness)
    active = pressure > 0
    slack = ACCURACY * max(height.max(), 0)
    for _ in range(_MAX_SET_CHANGES):
        found = supporting_pressure(height, active, pitch, layer)
        displacement = np.where(active, height, respond(found, pitch, layer))
        changed = (active & (found > 0)) | (reachable & ~active & (height - displacement > 100 * slack))
        if (changed == active).all():
            return displacement, found
        active = changed
    raise ObjectFolderError(
        f"the contact on a gel of {layer} did not settle in {_MAX_SET_CHANGES} rounds; try a smaller depth, "
        "or dtype float32"
    )
