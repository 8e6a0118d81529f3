"""How far the modes of a grid are from those of the continuous solid."""

import numpy as np

from objectfolder.fem.blocks import halved
from objectfolder.fem.cutcell import CutCells
from objectfolder.fem.eigen import lowest
from objectfolder.fem.elasticity import Solid
from objectfolder.materials import Material

ESTIMATED = 8  # lowest modes whose error is estimated
TOLERANCE = 1e-4  # residual of the modes that the estimate compares; their frequencies' is its square
MAX_ORDER = 3  # of convergence that the estimate believes in
NODES_PER_WAVE = 6  #: that resolve it: three quadratic elements


def lowest_frequencies(solid: Solid, material: Material, scale: float, count: int = ESTIMATED) -> np.ndarray:
    """Lowest elastic frequencies, Hz, to `TOLERANCE` only; not certified; (count,)."""
    return np.sqrt(lowest(solid.assemble(material, scale), count, TOLERANCE)) / (2 * np.pi)


def discretisation_error(
    solid: Solid, material: Material, scale: float, frequencies: np.ndarray
) -> list[float] | None:
    """Estimate the relative errors of the lowest frequencies, from grids of half and quarter resolution.

    If errors fall by 2^p with each halving of the cells, the last is the difference of the last two grids
    over 2^p - 1 (Richardson). Smooth shells converge with p of 2 or more; inner edges, and walls thinner
    than a cell, with about 1, below which no estimate goes: p = 1 also where the grids tell nothing else.

    Parameters
    ----------
    solid : Solid
    material : Material
    scale : float
        Longest side, metres.
    frequencies : (M,) array
        Lowest of the solid's own, Hz.

    Returns
    -------
    list of float, or None
        One for each frequency; none for elements without a coarser grid.
    """
    half = halved(solid) if isinstance(solid, CutCells) else None
    if half is None or len(frequencies) == 0:
        return None
    quarter = halved(half)
    found = lowest_frequencies(half, material, scale, len(frequencies))
    last = found / frequencies[: len(found)] - 1
    order = np.ones(len(last))
    if quarter is not None:
        coarse = lowest_frequencies(quarter, material, scale, len(found))
        former = coarse / found[: len(coarse)] - 1
        falls = (last[: len(former)] > 0) & (former > 2 * last[: len(former)])
        order[: len(former)][falls] = np.log2(former[falls] / last[: len(former)][falls]).clip(1, MAX_ORDER)
    return (last / (2**order - 1)).tolist()


def resolved_frequency(solid: Solid, material: Material, scale: float, wall: float) -> float:
    """Frequency up to which all waves span `NODES_PER_WAVE` distances between nodes, in Hz.

    The shortest are shear waves, f = c / l, and in thin walls bending waves of a plate (Kirchhoff),
    f = pi t c / (sqrt(3) l^2), whichever is lower.

    Parameters
    ----------
    solid : Solid
    material : Material
    scale : float
        Longest side, metres.
    wall : float
        Thickness of the walls, unit frame.
    """
    length = NODES_PER_WAVE * scale / solid.resolution / solid.order
    e, rho, nu = material.youngs_modulus, material.density, material.poisson_ratio
    shear = np.sqrt(e / (2 * (1 + nu)) / rho) / length
    bending = np.pi / np.sqrt(3) * wall * scale * np.sqrt(e / (rho * (1 - nu**2))) / length**2
    return float(min(shear, bending))
