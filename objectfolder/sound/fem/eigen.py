"""Vibration modes of a free solid: K u = lambda M u, by shift and invert.

A negative shift makes K - sigma M positive definite although K has six rigid modes, so one symmetric
factorisation suffices. Sylvester's law of inertia first counts the modes below the frequency limit, and the
solve must find exactly that many.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.fem.elasticity import FiniteElements
from objectfolder.sound.fem.factorisation import Factorisation, factorise, nested_dissection
from objectfolder.sound.fem.krylov import RESIDUAL_TOLERANCE, LowestModes

SHIFT = -((2 * np.pi * 300.0) ** 2)  # rad^2/s^2; at most, see `FreeVibration`
EXPANSION = 30  # shifts are at most this share of the Rayleigh quotient of a uniform expansion
CLUSTER = 1e-6  # frequencies closer than this (relative) span one subspace
SPARE_MODES = 4  # modes computed beyond the wanted ones, so that the cut splits no repeated eigenvalue
# Share of the energy of moving each unknown alone, below which a mode's is zero up to rounding
ZERO_ENERGY = 1e-12


@dataclass(frozen=True)
class Modes:
    """Elastic modes, without the rigid ones."""

    eigenvalues: np.ndarray  #: (M,), rad^2/s^2
    shapes: np.ndarray  #: (3N, M), mass-normalised, kg^-1/2
    residuals: np.ndarray  #: (M,), ||K u - lambda M u|| / ||lambda M u||, before `canonicalise`
    rigid_frequencies: np.ndarray  #: (6,), Hz; exactly zero in exact arithmetic
    count_below: int  #: elastic modes below the frequency limit, by inertia
    truncated: bool  #: whether fewer modes were kept


class FreeVibration:
    """Eigenproblem of a free solid; exact solves continue where rough ones stopped."""

    def __init__(self, fem: FiniteElements):
        self.fem = fem
        self._order = nested_dissection(fem.nodal_mass)
        self._rigid = rigid_modes(fem)

    @cached_property
    def _shift(self) -> float:
        # Far beyond the modes of a soft or very large solid, all of them would look alike to the solver.
        expansion = (self.fem.nodes - self.fem.nodes.mean(0)).ravel()
        quotient = expansion @ (self.fem.stiffness @ expansion) / (expansion @ (self.fem.mass @ expansion))
        return max(SHIFT, -quotient / EXPANSION)

    @cached_property
    def _factor(self) -> Factorisation:
        shifted = self.fem.stiffness - self._shift * self.fem.mass
        return factorise(shifted.tocsr(), self._order, definite=True)

    @cached_property
    def _lowest(self) -> LowestModes:
        shifted = self._factor.solve, self._shift
        return LowestModes(self.fem.stiffness, self.fem.nodal_mass, *shifted, self._rigid)

    def count_below(self, eigenvalue: float) -> int | None:
        """Count the elastic modes below an eigenvalue by inertia; None if rounding spoiled the count."""
        matrix = (self.fem.stiffness - eigenvalue * self.fem.mass).tocsr()
        below = factorise(matrix, self._order).negative_pivots()
        return None if below is None else max(below - 6, 0)

    def lowest(
        self, wanted: Callable[[np.ndarray], int], tolerance: float = RESIDUAL_TOLERANCE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the lowest elastic modes to a relative residual, uncertified.

        ``wanted`` maps the eigenvalues found so far, ascending, to the number of modes that must converge.
        Returns eigenvalues (k,), rad^2/s^2, and mass-normalised vectors (3N, k).
        """
        return self._lowest.find(wanted, tolerance)

    def modes_below(self, max_frequency: float, max_modes: int, name: str = "object") -> Modes:
        """Find the elastic modes below a frequency; see `solve_modes`."""
        fem, limit = self.fem, (2 * np.pi * max_frequency) ** 2
        below = self.count_below(limit)

        def wanted(found: np.ndarray) -> int:
            """Modes counted by inertia or, without a count, those found below the limit."""
            return min(int((found < limit).sum()) if below is None else below, max_modes)

        most = fem.stiffness.shape[0] - 6
        values, vectors = self.lowest(lambda found: min(wanted(found) + SPARE_MODES, most))
        if below is not None and int((values < limit).sum()) < wanted(values):
            raise ObjectFolderError(
                f"{name}: the solver found {int((values < limit).sum())} of at least {wanted(values)} modes "
                f"below {max_frequency:g} Hz; make the mesh slightly less symmetric, or report it"
            )
        alone = np.einsum("i,ij,ij->j", fem.stiffness.diagonal(), vectors, vectors)
        loose = int((values < ZERO_ENERGY * alone).sum())
        if loose:
            raise ObjectFolderError(
                f"{name}: the solid has at least {6 + loose} rigid modes, expected 6; it is in several "
                "pieces on the grid: join the mesh's parts, or use a finer voxelize.resolutions with a "
                "larger voxelize.max_degrees_of_freedom"
            )
        keep = np.flatnonzero(values < limit)[: wanted(values)]
        # Of the solver's own vectors: `canonicalise` mixes modes whose eigenvalues still differ a little.
        inertia = fem.mass @ (vectors[:, keep] * values[keep])
        residual = np.linalg.norm(fem.stiffness @ vectors[:, keep] - inertia, axis=0)
        rigid = np.einsum("ij,ij->j", self._rigid, fem.stiffness @ self._rigid)
        count = len(keep) if below is None else below
        return Modes(
            eigenvalues=values[keep],
            # Before the cut, which may separate the modes of a repeated eigenvalue.
            shapes=canonicalise(values, vectors, fem)[:, keep],
            residuals=residual / np.linalg.norm(inertia, axis=0),
            rigid_frequencies=np.sqrt(np.abs(rigid)) / (2 * np.pi),
            count_below=count,
            truncated=count > len(keep),
        )


def solve_modes(fem: FiniteElements, max_frequency: float, max_modes: int, name: str = "object") -> Modes:
    """Find the elastic modes below a frequency, Hz, at most so many, lowest first.

    Raises ObjectFolderError, with the object's name, if the solid has more than six rigid modes (it is not
    one connected piece), or the solver misses modes.
    """
    return FreeVibration(fem).modes_below(max_frequency, max_modes, name)


def rigid_modes(fem: FiniteElements) -> np.ndarray:
    """Compute the mass-normalised rigid modes analytically, free of solver error; (3N, 6)."""
    rigid = rigid_motions(fem.nodes)
    return rigid @ np.linalg.inv(np.linalg.cholesky(rigid.T @ (fem.mass @ rigid))).T


def rigid_motions(nodes: np.ndarray) -> np.ndarray:
    """Return three translations and three rotations about the centroid; (3N, 6)."""
    motion = np.zeros((len(nodes), 3, 6))
    motion[:, range(3), range(3)] = 1
    motion[:, :, 3:] = np.cross(np.eye(3)[None], (nodes - nodes.mean(0))[:, None, :]).transpose(0, 2, 1)
    return motion.reshape(-1, 6)


def canonicalise(values: np.ndarray, vectors: np.ndarray, fem: FiniteElements) -> np.ndarray:
    """Fix signs and the bases of repeated eigenvalues.

    A solver may return either sign of a mode and any basis of a repeated eigenvalue's subspace. Each
    cluster is rotated so that its product with fixed, smooth, asymmetric fields is triangular with a
    positive diagonal. The result does not depend on threads or start vectors.
    """
    out = vectors.copy()
    root = np.sqrt(np.abs(values))
    bounds = [*np.flatnonzero(np.diff(root, prepend=-np.inf) > CLUSTER * root), len(values)]
    probes = fem.mass @ _probe_fields(fem.nodes, max(np.diff(bounds), default=0))
    for start, stop in itertools.pairwise(bounds):
        size = stop - start
        product = vectors[:, start:stop].T @ probes[:, :size]
        rotation, triangle = np.linalg.qr(product)
        out[:, start:stop] = vectors[:, start:stop] @ (rotation * np.sign(np.diag(triangle)))
    return out


def _probe_fields(nodes: np.ndarray, count: int) -> np.ndarray:
    x = nodes - nodes.mean(0)
    x = x / np.abs(x).max()
    u = (x @ np.array([0.83, 0.41, 0.37]) + 0.3)[:, None]
    bend = x @ np.array([[0.2, 0.9, -0.4], [0.7, -0.3, 0.5], [-0.6, 0.1, 0.8]])
    fields = [
        np.cos(k * (np.array([1.7, 1.1, 0.6]) * 1.3 * u + np.array([0.3, 1.9, 4.1]) + bend)).ravel()
        for k in range(1, count + 1)
    ]
    return np.stack(fields, 1) if fields else np.empty((nodes.size, 0))
