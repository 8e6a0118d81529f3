"""How far the modes of a grid are from those of the continuous solid."""

import numpy as np

from objectfolder.fem.blocks import halved
from objectfolder.fem.cutcell import CutCells
from objectfolder.fem.eigen import solve_modes
from objectfolder.fem.elasticity import Solid
from objectfolder.materials import Material

ESTIMATED = 8  # lowest modes whose error is estimated
NODES_PER_WAVE = 6  # that resolve it: three quadratic elements


def discretisation_error(
    solid: Solid, material: Material, scale: float, eigenvalues: np.ndarray, name: str = "object"
) -> list[float] | None:
    """Estimate the relative errors of the lowest frequencies, from a grid of half the resolution.

    Walls about as thick as a cell, and inner edges, make errors fall in proportion to the size of a cell
    (measured: docs/modal.md), so that the error is the difference between the two grids.

    Parameters
    ----------
    solid : Solid
    material : Material
    scale : float
        Longest side, metres.
    eigenvalues : (M,) array
        Of the solid's own modes, rad^2/s^2, the lowest first.
    name : str
        Named in errors.

    Returns
    -------
    list of float, or None
        At most `ESTIMATED`; none for elements without a coarser grid.
    """
    coarse = halved(solid) if isinstance(solid, CutCells) else None
    lowest = np.sqrt(eigenvalues[:ESTIMATED]) / (2 * np.pi)
    if coarse is None or len(lowest) == 0:
        return None
    found = solve_modes(
        coarse.assemble(material, scale), 2 * float(lowest[-1]), len(lowest), name
    ).eigenvalues
    both = min(len(found), len(lowest))
    return (np.sqrt(found[:both]) / (2 * np.pi) / lowest[:both] - 1).tolist()


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
