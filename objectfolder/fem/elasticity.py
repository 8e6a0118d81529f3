"""Linear elasticity and assembly, shared by all elements."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from objectfolder.materials import Material


@dataclass(frozen=True)
class FiniteElements:
    """Assembled matrices in SI units."""

    stiffness: sp.csr_matrix  #: (3N, 3N), N/m
    mass: sp.csr_matrix  #: (3N, 3N), kg
    nodal_mass: sp.csr_matrix  #: (N, N), kg; ``mass`` is its Kronecker product with the identity
    nodes: np.ndarray  #: (N, 3), object frame, metres

    @classmethod
    def of(cls, stiffness: sp.csr_matrix, nodal_mass: sp.csr_matrix, nodes: np.ndarray) -> "FiniteElements":
        """Build from the nodal mass; computes the full mass matrix."""
        return cls(stiffness, sp.kron(nodal_mass, sp.eye_array(3), format="csr"), nodal_mass, nodes)


class Solid(Protocol):
    """Solid in the unit frame, divided into finite elements."""

    @property
    def name(self) -> str:
        """Name of the element."""

    @property
    def resolution(self) -> int:
        """Elements along the longest side."""

    @property
    def elements(self) -> int:
        """Number of elements."""

    @property
    def degrees_of_freedom(self) -> int:
        """Number of unknowns, known without assembly."""

    @property
    def order(self) -> int:
        """Degree of the complete polynomials in the element space."""

    @property
    def volume(self) -> float:
        """Volume, unit frame."""

    @property
    def volume_error(self) -> float:
        """Relative error of the elements' volume against the surface's, before any correction."""

    @property
    def dropped_volume(self) -> float:
        """Volume fraction of pieces not connected to the main one."""

    def assemble(self, material: Material, scale: float) -> FiniteElements:
        """Assemble stiffness and mass; ``scale`` is the longest side in metres."""

    def interpolate(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Evaluate a nodal field at points of the unit frame; (N, C), (P, 3) -> (P, C)."""


def elasticity(material: Material) -> np.ndarray:
    """Return the isotropic elasticity matrix in Voigt notation (xx, yy, zz, xy, yz, zx); (6, 6), Pa."""
    e, nu = material.youngs_modulus, material.poisson_ratio
    lame, shear = e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
    c = np.diag([2 * shear] * 3 + [shear] * 3)
    c[:3, :3] += lame
    return c


def strain_displacement(gradients: np.ndarray) -> np.ndarray:
    """Build strain-displacement matrices from shape gradients; (Q, n, 3) -> (Q, 6, 3n)."""
    count, n, _ = gradients.shape
    strain = np.zeros((count, 6, n, 3))
    dx, dy, dz = gradients[..., 0], gradients[..., 1], gradients[..., 2]
    strain[:, 0, :, 0], strain[:, 1, :, 1], strain[:, 2, :, 2] = dx, dy, dz
    strain[:, 3, :, 0], strain[:, 3, :, 1] = dy, dx
    strain[:, 4, :, 1], strain[:, 4, :, 2] = dz, dy
    strain[:, 5, :, 0], strain[:, 5, :, 2] = dz, dx
    return strain.reshape(count, 6, 3 * n)


def scatter(element: np.ndarray, dof: np.ndarray, size: int) -> sp.csr_matrix:
    """Sum element matrices into one symmetric sparse matrix."""
    n = dof.shape[1]
    dof = dof.astype(np.int32)
    rows, columns = np.repeat(dof, n, axis=1).ravel(), np.tile(dof, (1, n)).ravel()
    return symmetric(sp.coo_matrix((element.ravel(), (rows, columns)), shape=(size, size)).tocsr())


def symmetric(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Symmetrise a matrix that is symmetric up to rounding."""
    return sp.csr_matrix((matrix + matrix.T) / 2)
