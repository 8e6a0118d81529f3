"""The part of a sound that an Object File lacks: modes that were counted but not solved."""

import numpy as np

from objectfolder.materials import Material
from objectfolder.nets.audio_gains import energy_weights


def lost_energy(
    shapes: np.ndarray,
    damped_frequency: np.ndarray,
    material: Material,
    found: int,
    max_frequency: float,
) -> float:
    """Estimate the share of the energy of impulses' sounds that modes beyond the kept ones carry.

    The lost modes are taken to lie at equal steps between the last kept one and the frequency to which modes
    were counted, and to move the surface as the upper half of the kept ones do.

    Parameters
    ----------
    shapes : (P, 3, M) array
        Kept modes at points of the surface, kg^-1/2.
    damped_frequency : (M,) array
        Ascending, rad/s.
    material : Material
        Its damping model applies to the lost modes.
    found : int
        Number of modes below ``max_frequency``, Hz.
    """
    kept = len(damped_frequency)
    if found <= kept or kept == 0:
        return 0.0
    low, high = damped_frequency[-1], 2 * np.pi * max_frequency
    angular = np.linspace(low, high, found - kept + 2)[1:-1]
    moved = np.square(shapes, dtype=np.float64).mean((0, 1))
    lost = moved[kept // 2 :].mean() * energy_weights(angular, material.damping(angular**2)).sum()
    heard = moved @ energy_weights(damped_frequency, material.damping(damped_frequency**2))
    return float(lost / (lost + heard))
