"""Estimates of discretisation error and resolved frequency."""

import numpy as np

from objectfolder.fem.blocks import halved
from objectfolder.fem.cutcell import CutCells
from objectfolder.fem.eigen import lowest_elastic_modes
from objectfolder.fem.elasticity import Solid
from objectfolder.materials import Material

ESTIMATED = 10  # number of lowest modes whose error is estimated
TOLERANCE = 1e-4  # residual of the compared modes; the error of their frequencies is its square
ORDER, LOW_ORDER = 1.5, 1.0  # of convergence; the low one where the differences hardly fall
FALL = 2**0.5  # least ratio of the differences that shows convergence
NODES_PER_WAVE = 6  #: that resolve a wave: three quadratic elements


def lowest_frequencies(solid: Solid, material: Material, scale: float, count: int = ESTIMATED) -> np.ndarray:
    """Compute the lowest elastic frequencies to `TOLERANCE`, uncertified; Hz (count,)."""
    return np.sqrt(lowest_elastic_modes(solid.assemble(material, scale), count, TOLERANCE)[0]) / (2 * np.pi)


def discretisation_error(
    solid: Solid, material: Material, scale: float, frequencies: np.ndarray
) -> list[float] | None:
    """Estimate the relative errors of the lowest frequencies from grids of half and quarter resolution.

    Richardson extrapolation: if halving the cells divides the error by 2^p, the error of the finest grid is
    the difference between the last two grids divided by 2^p - 1. Smooth shells converge with p of about 2,
    inner edges and walls thinner than a cell with 1 to 1.5. The order observed on three coarse grids is not
    yet the final one, so the estimate assumes ``ORDER``, which is right within a factor of two for p from 1
    to 2, and ``LOW_ORDER`` for modes whose difference did not fall by ``FALL``.

    Parameters
    ----------
    solid : Solid
    material : Material
    scale : float
        Longest side, metres.
    frequencies : (M,) array
        Lowest frequencies of the solid, Hz.

    Returns
    -------
    list of float, or None
        One per frequency; None for elements without a coarser grid.
    """
    half = halved(solid) if isinstance(solid, CutCells) else None
    if half is None or len(frequencies) == 0:
        return None
    quarter = halved(half)
    found = lowest_frequencies(half, material, scale, len(frequencies))
    last = found / frequencies[: len(found)] - 1
    order = np.full(len(last), ORDER)
    if quarter is not None:
        coarse = lowest_frequencies(quarter, material, scale, len(found))
        former = coarse / found[: len(coarse)] - 1
        order[: len(former)][former < FALL * last[: len(former)]] = LOW_ORDER
    return np.abs(last / (2**order - 1)).tolist()


def resolved_frequency(solid: Solid, material: Material, scale: float, wall: float) -> float:
    """Return the highest frequency in Hz whose waves span at least `NODES_PER_WAVE` node distances.

    The shortest waves are shear waves, f = c / l, or in thin walls bending waves of a Kirchhoff plate,
    f = pi t c / (sqrt(3) l^2); the lower frequency counts.

    Parameters
    ----------
    solid : Solid
    material : Material
    scale : float
        Longest side, metres.
    wall : float
        Wall thickness, unit frame.
    """
    length = NODES_PER_WAVE * scale / solid.resolution / solid.order
    e, rho, nu = material.youngs_modulus, material.density, material.poisson_ratio
    shear = np.sqrt(e / (2 * (1 + nu)) / rho) / length
    bending = np.pi / np.sqrt(3) * wall * scale * np.sqrt(e / (rho * (1 - nu**2))) / length**2
    return float(min(shear, bending))
