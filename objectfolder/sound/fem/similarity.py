"""Exact scaling of modes between solids of the same shape and Poisson ratio.

The stiffness matrix is E L, and the mass matrix rho L^3, times a matrix that depends on the shape and the
Poisson ratio only, so one solve serves all materials and sizes.
"""

from objectfolder.base.materials import Material


def similarity(old: tuple[Material, float], new: tuple[Material, float]) -> tuple[float, float]:
    """Return the scale factors of eigenvalues and of mass-normalised mode shapes.

    The ratios of E / (rho L^2) and of (rho L^3)^(-1/2), new over old, of materials and longest sides in
    metres; their numbers may be tensors.
    """
    (old_material, old_scale), (material, scale) = old, new
    size, density = scale / old_scale, material.density / old_material.density
    stiffness = material.youngs_modulus / old_material.youngs_modulus
    return stiffness / density / size**2, 1 / (density * size**3) ** 0.5
