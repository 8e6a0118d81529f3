"""Estimates of discretisation error and resolved frequency."""

from functools import cached_property

import numpy as np

from objectfolder.base.materials import Material
from objectfolder.sound.fem.blocks import halve_cells
from objectfolder.sound.fem.cutcell import CutCells
from objectfolder.sound.fem.eigen import FreeVibration
from objectfolder.sound.fem.elasticity import Solid
from objectfolder.sound.fem.levels import MixedCells

ESTIMATED_MODES = 10  # number of lowest modes whose error is estimated
TOLERANCE = 1e-4  # residual of the compared modes; the error of their frequencies is its square
ORDER, LOW_ORDER = 1.5, 1.0  # of convergence; the low one where the differences hardly fall
MIN_FALL = 2**0.5  # least ratio of the differences that shows convergence
NODES_PER_WAVE = 6  #: that resolve a wave: three quadratic elements


class Discretisation:
    """A solid on one mesh, longest side in metres. What its error estimate solves is kept for all modes.

    The solid in larger elements is given where it does not follow from the solid, as it does for cut cells.
    """

    def __init__(self, solid: Solid, material: Material, scale: float, coarse: Solid | None = None):
        self.solid, self.material, self.scale, self.coarse = solid, material, scale, coarse
        self._lowest: dict[int, np.ndarray] = {}

    @cached_property
    def vibration(self) -> FreeVibration:
        """Eigenproblem of the solid."""
        return FreeVibration(self.solid.assemble(self.material, self.scale))

    @cached_property
    def coarser(self) -> list[np.ndarray]:
        """Lowest frequencies on the grids of half and quarter resolution, as far as they exist; Hz."""
        half = self.coarse or coarser(self.solid)
        quarter = coarser(half) if half is not None else None
        grids = [solid for solid in (half, quarter) if solid is not None]
        return [Discretisation(solid, self.material, self.scale).lowest_frequencies() for solid in grids]

    def lowest_frequencies(self, count: int = ESTIMATED_MODES) -> np.ndarray:
        """Compute the lowest elastic frequencies to `TOLERANCE`, uncertified, once; Hz (count,)."""
        if count not in self._lowest:
            self._lowest[count] = np.sqrt(self.lowest_modes(count)[0]) / (2 * np.pi)
        return self._lowest[count]

    def lowest_modes(self, count: int = ESTIMATED_MODES) -> tuple[np.ndarray, np.ndarray]:
        """Compute the lowest elastic modes to `TOLERANCE`, uncertified.

        Eigenvalues (count,), rad^2/s^2, and mass-normalised shapes (3N, count).
        """
        values, shapes = self.vibration.lowest(lambda found: count, TOLERANCE)
        return values[:count], shapes[:, :count]

    def errors(self, frequencies: np.ndarray) -> list[float] | None:
        """Estimate the relative errors of the lowest frequencies of this grid, Hz (M,).

        One per frequency (see `discretisation_error`); None for elements without a coarser grid.
        """
        if not len(frequencies) or not self.coarser:
            return None
        if self.coarse is None:
            return discretisation_error(frequencies, *self.coarser)
        ratio = np.cbrt(self.solid.elements / self.coarse.elements)
        last = self.coarser[0][: len(frequencies)] / frequencies[:ESTIMATED_MODES] - 1
        return np.abs(last / (ratio**ORDER - 1)).tolist()


def coarser(solid: Solid) -> CutCells | None:
    """Return a solid in elements twice as large; None for elements other than cut cells."""
    if isinstance(solid, MixedCells):
        return solid.coarser
    found = halve_cells(solid) if isinstance(solid, CutCells) else None
    return found[0] if found else None


def discretisation_error(
    frequencies: np.ndarray, half: np.ndarray, quarter: np.ndarray | None = None
) -> list[float]:
    """Estimate the relative errors of frequencies, Hz, from those on grids of half and quarter resolution.

    Richardson extrapolation: if halving the cells divides the error by 2^p, the error of the finest grid is
    the difference between the last two grids divided by 2^p - 1. Smooth shells converge with p of about 2,
    inner edges and walls thinner than a cell with 1 to 1.5. The order observed on three coarse grids is not
    yet the final one, so the estimate assumes ``ORDER``, which is right within a factor of two for p from 1
    to 2, and ``LOW_ORDER`` for modes whose difference did not fall by ``MIN_FALL``.
    """
    count = min(len(frequencies), len(half))
    last = half[:count] / frequencies[:count] - 1
    order = np.full(count, ORDER)
    if quarter is not None:
        seen = min(count, len(quarter))
        former = quarter[:seen] / half[:seen] - 1
        order[:seen][former < MIN_FALL * last[:seen]] = LOW_ORDER
    return np.abs(last / (2**order - 1)).tolist()


def resolved_frequency(solid: Solid, material: Material, scale: float, wall: float) -> float:
    """Return the highest frequency in Hz whose waves span at least `NODES_PER_WAVE` node distances.

    The shortest waves are shear waves, f = c / l, or in thin walls bending waves of a Kirchhoff plate, f = pi
    t c / (sqrt(3) l^2); the lower frequency counts. The longest side, ``scale``, is in metres, the thickness
    of the wall in the unit frame.
    """
    length = NODES_PER_WAVE * scale / solid.resolution / solid.order
    inside = at_walls = 1  # widths of the largest elements, cells
    if isinstance(solid, CutCells):
        inside, at_walls = solid.width.max(), solid.width[~solid.is_full].max(initial=1)
    e, rho, nu = material.youngs_modulus, material.density, material.poisson_ratio
    shear = np.sqrt(e / (2 * (1 + nu)) / rho) / (length * inside)
    bending = np.pi / np.sqrt(3) * wall * scale * np.sqrt(e / (rho * (1 - nu**2))) / (length * at_walls) ** 2
    return float(min(shear, bending))
