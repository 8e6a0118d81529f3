"""Frequency band in which a modal analysis is complete."""

import math

import numpy as np

from objectfolder.fem.modal import MIN_FREQUENCY, ModalData
from objectfolder.materials import Material


def solved_band(data: ModalData, material: Material, max_frequency: float, max_modes: int) -> list[float]:
    """Return the band of natural frequencies in Hz in which no mode of the object is missing.

    `objectfolder.audio.tuning` rescales the modes to other materials and sizes of the same shape; the
    rescaled band bounds the frequencies for which that is valid. The solve had an upper limit, Hz, and a
    greatest number of modes. Both ends are equal if the band is empty; the lower is 0 only if no mode was
    dropped.
    """
    top = max_frequency
    if data.report["truncated"]:
        top = float(np.sqrt(data.eigenvalues[-1])) / (2 * np.pi) if len(data.eigenvalues) else 0.0
    count = data.report["count_below_max_frequency"]
    if data.report["modes"] == (max_modes if count is None else min(count, max_modes)):
        return [0.0, top]
    if material.loss_factor:  # it rings, whatever its frequency
        return [MIN_FREQUENCY, max(MIN_FREQUENCY, top)]
    # Some modes were inaudible or overdamped: a mode of natural frequency w rings if alpha + beta w^2 < 2 w.
    root = math.sqrt(max(0.0, 1 - material.alpha * material.beta))
    dull = (1 + root) / material.beta if material.beta else math.inf
    low = max(MIN_FREQUENCY, material.alpha / (1 + root) / (2 * np.pi))
    return [low, max(low, min(top, dull / (2 * np.pi)))]
