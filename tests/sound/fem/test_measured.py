"""Frequencies of a real block of aluminium, measured by resonance ultrasound spectroscopy."""

import numpy as np
from solids import box

from objectfolder.base.materials import Material
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import solve_modes

#: Sides in metres, density and stiffness, and the lowest 29 measured frequencies: Ogi, Sato, Asada and Hirao,
#: Complete mode identification for resonance ultrasound spectroscopy, J. Acoust. Soc. Am. 112 (2002) 2553.
SIDES = np.array([11.92, 10.93, 9.86]) * 1e-3
DENSITY, C11, C44 = 2788.0, 109.26e9, 26.72e9
MEASURED = 1e3 * np.array(
    [
        *(116.716, 143.783, 158.081, 166.5, 169.523, 177.846, 183.875, 186.047, 190.341, 197.386),
        *(201.133, 207.386, 209.836, 214.753, 223.548, 231.266, 233.538, 234.717, 250.98, 251.256),
        *(252.742, 256.122, 257.595, 258.118, 259.035, 268.54, 277.113, 278.762, 282.311),
    ]
)


def test_an_aluminium_block_rings_as_measured():
    first = C11 - 2 * C44
    modulus, poisson = C44 * (3 * first + 2 * C44) / (first + C44), first / (2 * (first + C44))
    aluminium = Material("aluminium", DENSITY, modulus, poisson, 0.0, 0.0)
    block = cut_cells(*box(SIDES / SIDES.max()), 8, 4)
    modes = solve_modes(block.assemble(aluminium, SIDES.max()), 290e3, 40, "block")
    error = np.sqrt(modes.eigenvalues[: len(MEASURED)]) / (2 * np.pi) / MEASURED - 1
    assert np.abs(error).mean() < 0.003
    assert np.abs(error).max() < 0.01
