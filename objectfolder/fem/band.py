"""The band of frequencies in which a modal analysis found every mode."""

import math

import numpy as np

from objectfolder.fem.modal import MIN_FREQUENCY, ModalData
from objectfolder.materials import Material


def solved_band(data: ModalData, material: Material, max_frequency: float, max_modes: int) -> list[float]:
    """Natural frequencies in Hz between which no mode of the object is lacking.

    Objects of the same shape that are softer, stiffer, larger or smaller are heard from the same modes
    (`objectfolder.audio.tuning`); the band tells where theirs end.

    Parameters
    ----------
    data : ModalData
    material : Material
        Of the object.
    max_frequency : float
        Hz, to which modes were sought.
    max_modes : int
        How many were kept at most.

    Returns
    -------
    list of float
        Lower and upper end; equal if nothing is known. The lower is 0 only if no mode was dropped.
    """
    top = max_frequency
    if data.report["truncated"]:
        top = float(np.sqrt(data.eigenvalues[-1])) / (2 * np.pi) if len(data.eigenvalues) else 0.0
    count = data.report["count_below_max_frequency"]
    if data.report["modes"] == (max_modes if count is None else min(count, max_modes)):
        return [0.0, top]
    # Some were below hearing or overdamped: a mode of natural frequency w rings if alpha + beta w^2 < 2 w.
    root = math.sqrt(max(0.0, 1 - material.alpha * material.beta))
    dull = (1 + root) / material.beta if material.beta else math.inf
    low = max(MIN_FREQUENCY, material.alpha / (1 + root) / (2 * np.pi))
    return [low, max(low, min(top, dull / (2 * np.pi)))]
