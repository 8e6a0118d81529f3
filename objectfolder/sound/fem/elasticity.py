"""What all finite elements share: linear elasticity, assembly, and the choice of one connected piece."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import Material

MAX_GATHERED_VALUES = 1 << 24  #: nodal values that are in memory at once while points are interpolated
MAX_DROPPED = 0.05  #: accepted volume fraction outside the main piece


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


class Solid(ABC):
    """Solid in the unit frame, divided into finite elements."""

    order: ClassVar[int]  #: degree of the complete polynomials in the element space
    connectivity: np.ndarray  #: (E, n) int64, nodes of each element
    resolution: int  #: elements along the longest side
    dropped_volume: float  #: volume fraction of pieces not connected to the main one
    volume_error: float  #: of the elements against the surface, relative, before any correction

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the element."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume, unit frame."""

    @property
    def elements(self) -> int:
        """Number of elements."""
        return len(self.connectivity)

    @property
    def degrees_of_freedom(self) -> int:
        """Number of unknowns, known without assembly."""
        return 3 * (int(self.connectivity.max()) + 1)

    @abstractmethod
    def assemble(self, material: Material, scale: float) -> FiniteElements:
        """Assemble stiffness and mass; ``scale`` is the longest side in metres."""

    @abstractmethod
    def interpolate(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Evaluate a nodal field at points of the unit frame; (N, C), (P, 3) -> (P, C)."""


def mix_nodes(weights: np.ndarray, values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return weighted sums of nodal values; (P, n), (N, C), (P, n) -> (P, C).

    In pieces, since the values at the nodes of all points may not fit into memory.
    """
    out = np.empty((len(nodes), values.shape[1]))
    step = max(MAX_GATHERED_VALUES // max(nodes.shape[1] * values.shape[1], 1), 1)
    for start in range(0, len(nodes), step):
        part = slice(start, start + step)
        out[part] = np.einsum("pi,pic->pc", weights[part], values[nodes[part]])
    return out


def main_piece(piece: np.ndarray, volume: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Keep the largest connected piece of a solid: which elements (E,), and the dropped volume fraction.

    Takes the piece of each element (E,) and its volume (E,). Raises ObjectFolderError, with the object's
    name, if the other pieces hold more than `MAX_DROPPED` of the volume.
    """
    volumes = np.bincount(piece, weights=volume)
    share = np.sort(volumes / volumes.sum())[::-1]
    dropped = float(share[1:].sum())
    if dropped > MAX_DROPPED:
        shown = [f"{s:.2%}" for s in share[:5]] + ["..."] * (len(share) > 5)
        raise ObjectFolderError(
            f"{name}: the solid is in {len(share)} separate pieces "
            f"({', '.join(shown)} of the volume), expected one: "
            "join the mesh's parts, or split it into several objects"
        )
    return piece == volumes.argmax(), dropped


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


def upper_blocks(matrices: np.ndarray, size: int) -> np.ndarray:
    """Take the blocks on and above the diagonal of symmetric element matrices; (..., P size^2).

    Matrices (..., n size, n size) of elements with n nodes and ``size`` unknowns per node have P = n (n + 1)
    / 2 blocks of pairs of nodes, in the order of `numpy.triu_indices`.
    """
    lead, n = matrices.shape[:-2], matrices.shape[-1] // size
    own, other = np.triu_indices(n)
    blocks = matrices.reshape(*lead, n, size, n, size).swapaxes(-3, -2)
    return blocks[..., own, other, :, :].reshape(*lead, -1)


def scatter(blocks: np.ndarray, connectivity: np.ndarray, nodes: int) -> sp.csr_matrix:
    """Sum element matrices, given by their `upper_blocks` (E, P size^2), into one symmetric sparse matrix.

    Connectivity (E, n) holds the nodes of each element, of all the nodes.
    """
    own, other = (connectivity[:, side].ravel() for side in np.triu_indices(connectivity.shape[1]))
    blocks = blocks.reshape(len(own), -1)
    size = math.isqrt(blocks.shape[1])
    pair = np.minimum(own, other) * np.int64(nodes) + np.maximum(own, other)
    order = np.argsort(pair, kind="stable")
    first = np.flatnonzero(np.diff(pair[order], prepend=-1))
    blocks = blocks[order].reshape(-1, size, size)
    turned = (own > other)[order]  # numbered the other way round in their element
    blocks[turned] = blocks[turned].swapaxes(1, 2)
    total = np.add.reduceat(blocks, first)
    row, column = np.divmod(pair[order[first]], nodes)
    diagonal, above = row == column, np.flatnonzero(row != column)
    total[diagonal] = (total[diagonal] + total[diagonal].swapaxes(1, 2)) / 2  # symmetric up to rounding
    total = np.concatenate([total, total[above].swapaxes(1, 2)])
    row, column = np.concatenate([row, column[above]]), np.concatenate([column, row[above]])
    order = np.argsort(row * nodes + column)
    start = np.searchsorted(row[order], np.arange(nodes + 1))
    return sp.bsr_matrix((total[order], column[order], start), shape=(size * nodes,) * 2).tocsr()


def symmetric(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Symmetrise a matrix that is symmetric up to rounding."""
    return sp.csr_matrix((matrix + matrix.T) / 2)
