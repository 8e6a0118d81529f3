"""Vibration modes of a free solid: K u = lambda M u, by shift and invert.

A negative shift makes K - sigma M positive definite although K has six rigid modes, so one symmetric
factorisation serves. The number of modes below the wanted frequency is counted first, by Sylvester's
law of inertia, so that one solve finds exactly those.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import pymetis
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from objectfolder.errors import ObjectFolderError
from objectfolder.fem.cutcell import FiniteElements

SHIFT_HZ = 300.0  # of the negative shift
CLUSTER = 1e-6  # eigenvalues closer than this (relative) span one subspace
SPARE = 4  # modes beyond the wanted ones, which let the wanted ones converge
MIN_SUBSPACE = 60  # Lanczos vectors; fewer miss copies of the sixfold rigid eigenvalue


@dataclass(frozen=True)
class Modes:
    """Elastic modes, rigid ones dropped."""

    eigenvalues: np.ndarray  #: (M,), rad^2/s^2
    shapes: np.ndarray  #: (3N, M), mass-normalised, kg^-1/2
    residuals: np.ndarray  #: (M,), ||K u - lambda M u|| / ||lambda M u||
    rigid_frequencies: np.ndarray  #: (6,), Hz; exactly zero in exact arithmetic
    count_below: int  #: elastic modes below the wanted frequency, by inertia
    truncated: bool  #: whether fewer were kept


class Factorisation:
    """Sparse LDL^T of a symmetric matrix, in a fill-reducing order (METIS, one permutation per node)."""

    def __init__(self, matrix: sp.csr_matrix, nodal_graph: sp.csr_matrix):
        graph = nodal_graph.copy()
        graph.setdiag(0)
        graph.eliminate_zeros()
        order = np.asarray(pymetis.nested_dissection(pymetis.CSRAdjacency(graph.indptr, graph.indices))[0])
        self._order = (3 * order[:, None] + np.arange(3)).ravel()
        self._inverse = np.argsort(self._order)
        permuted = matrix[self._order][:, self._order].tocsc()
        self._lu = sla.splu(
            permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side."""
        return self._lu.solve(right[self._order])[self._inverse]

    def negative_pivots(self) -> int | None:
        """Count negative eigenvalues of the matrix (Sylvester); None if pivoting spoiled the count."""
        if not np.array_equal(self._lu.perm_r, np.arange(len(self._order))):
            return None
        return int((self._lu.U.diagonal() < 0).sum())


def solve_modes(fem: FiniteElements, max_frequency: float, max_modes: int, name: str = "object") -> Modes:
    """Find the elastic modes below a frequency.

    Parameters
    ----------
    fem : FiniteElements
    max_frequency : float
        Hz.
    max_modes : int
        Keep at most this many, the lowest.
    name : str
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If the solid has other than six rigid modes (it is not one connected piece).
    """
    limit = (2 * np.pi * max_frequency) ** 2
    below = Factorisation((fem.stiffness - limit * fem.mass).tocsr(), fem.nodal_mass).negative_pivots()
    wanted = min(max_modes + 6 if below is None else below, max_modes + 6)
    shift = -((2 * np.pi * SHIFT_HZ) ** 2)
    factor = Factorisation((fem.stiffness - shift * fem.mass).tocsr(), fem.nodal_mass)
    size = fem.stiffness.shape[0]
    count = min(wanted + SPARE, size - 2)
    values, vectors = sla.eigsh(
        fem.stiffness,
        k=count,
        ncv=min(max(2 * count + 1, MIN_SUBSPACE), size),
        M=fem.mass,
        sigma=shift,
        OPinv=sla.LinearOperator((size, size), matvec=factor.solve, dtype=np.float64),
        v0=np.random.default_rng(0).standard_normal(size),
        tol=1e-10,
    )
    order = np.argsort(values)
    values, vectors = values[order], vectors[:, order]
    _check_rigid(fem, values, vectors, name)
    keep = np.flatnonzero((np.arange(len(values)) >= 6) & (values < limit))[:max_modes]
    # Before the cut: it may part the modes of a repeated eigenvalue.
    elastic = canonical(values[6:], vectors[:, 6:], fem)[:, keep - 6]
    inertia = elastic * values[keep]
    residual = np.linalg.norm(fem.stiffness @ elastic - fem.mass @ inertia, axis=0)
    count = len(keep) if below is None else below - 6
    return Modes(
        eigenvalues=values[keep],
        shapes=elastic,
        residuals=residual / np.linalg.norm(fem.mass @ inertia, axis=0),
        rigid_frequencies=np.sqrt(np.abs(values[:6])) / (2 * np.pi),
        count_below=count,
        truncated=count > len(keep),
    )


def rigid_motions(nodes: np.ndarray) -> np.ndarray:
    """Three translations and three rotations about the centroid; (3N, 6)."""
    motion = np.zeros((len(nodes), 3, 6))
    motion[:, range(3), range(3)] = 1
    motion[:, :, 3:] = np.cross(np.eye(3)[None], (nodes - nodes.mean(0))[:, None, :]).transpose(0, 2, 1)
    return motion.reshape(-1, 6)


def canonical(values: np.ndarray, vectors: np.ndarray, fem: FiniteElements) -> np.ndarray:
    """Fix signs and the bases of repeated eigenvalues.

    A solver may return either sign of a mode and any basis of a repeated eigenvalue's subspace. Each
    cluster is rotated so that its product with fixed, smooth, asymmetric fields is triangular with a
    positive diagonal; the answer no longer depends on threads or start vectors.
    """
    probes = fem.mass @ _probe_fields(fem.nodes)
    out = vectors.copy()
    root = np.sqrt(np.abs(values))
    bounds = [*np.flatnonzero(np.diff(root, prepend=-np.inf) > CLUSTER * root), len(values)]
    for start, stop in itertools.pairwise(bounds):
        size = stop - start
        product = vectors[:, start:stop].T @ probes[:, :size]
        rotation, triangle = np.linalg.qr(product)
        out[:, start:stop] = vectors[:, start:stop] @ (rotation * np.sign(np.diag(triangle)))
    return out


def _probe_fields(nodes: np.ndarray, count: int = 8) -> np.ndarray:
    x = nodes - nodes.mean(0)
    x = x / np.abs(x).max()
    u = (x @ np.array([0.83, 0.41, 0.37]) + 0.3)[:, None]
    bend = x @ np.array([[0.2, 0.9, -0.4], [0.7, -0.3, 0.5], [-0.6, 0.1, 0.8]])
    fields = [
        np.cos(k * (np.array([1.7, 1.1, 0.6]) * 1.3 * u + np.array([0.3, 1.9, 4.1]) + bend)).ravel()
        for k in range(1, count + 1)
    ]
    return np.stack(fields, 1)


def _check_rigid(fem: FiniteElements, values: np.ndarray, vectors: np.ndarray, name: str) -> None:
    """Six eigenvectors, and no more, must be rigid motions."""
    basis = rigid_motions(fem.nodes)
    gram = basis.T @ (fem.mass @ basis)
    product = basis.T @ (fem.mass @ vectors)
    share = np.einsum("ij,ij->j", product, np.linalg.solve(gram, product))
    rigid = int((values < 1e-3 * values[min(6, len(values) - 1)]).sum())
    if rigid != 6 or share[:6].min() < 1 - 1e-3:
        raise ObjectFolderError(
            f"{name}: the solid has {rigid} rigid modes (rigid share {np.round(share[:8], 3).tolist()}), "
            "expected 6; it falls into pieces on the grid: raise voxelize.resolution or join the mesh's parts"
        )
