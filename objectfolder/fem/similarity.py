"""How modes scale between solids of one shape and one Poisson ratio: exactly.

The stiffness matrix is E L and the mass matrix rho L^3 times a matrix that only the shape and Poisson's
ratio determine, so that every solve is also that of the other materials and sizes.
"""

import math

from objectfolder.materials import Material


def similarity(old: tuple[Material, float], new: tuple[Material, float]) -> tuple[float, float]:
    """Factors of eigenvalues and of mass-normalised mode shapes.

    Parameters
    ----------
    old, new : tuple of Material and float
        Material and longest side in metres.

    Returns
    -------
    tuple of float
        The ratios of E / (rho L^2) and of (rho L^3)^(-1/2), new over old.
    """
    (was, was_scale), (stuff, scale) = old, new
    size, density = scale / was_scale, stuff.density / was.density
    return stuff.youngs_modulus / was.youngs_modulus / density / size**2, 1 / math.sqrt(density * size**3)
