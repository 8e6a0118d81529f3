"""Block Lanczos for the lowest modes, without restarts and with full orthogonalisation.

For hundreds of modes ARPACK spends its time on single triangular solves and on matrix-vector products with
its basis, both bound by memory bandwidth. Blocks turn them into matrix products: 16 right-hand sides at
once cost a fraction of 16 single ones. Blocks also find all copies of a repeated eigenvalue.
"""

from collections.abc import Callable

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from objectfolder.base.errors import ObjectFolderError

RESIDUAL_TOLERANCE = 1e-11
MAX_DENSE_SIZE, MAX_DENSE_RATIO = 600, 4  # limits of unknowns, in all and per wanted mode, for a dense solve
_BLOCK = 16  # vectors that are solved for at once; a solve of 8 takes as long
_RESERVE = 1.6  # room for a basis, over its size at the first convergence check
# Basis size, per wanted mode and column of a block, beyond which nothing converges; 6 suffice
_MAX_BASIS_RATIO = 50
_FIRST_CHECK, _GROWTH = 2.0, 1.06  # basis size per wanted mode at the first convergence check; growth after


class LowestModes:
    """Search for the lowest eigenpairs of K u = lambda M u other than known ones.

    Later requests, for more of them or more exact ones, continue the search.

    Parameters
    ----------
    stiffness
        K (3N, 3N).
    nodal_mass
        (N, N); M is its Kronecker product with the identity.
    solve
        Applies (K - shift M)^-1 to (3N, b) columns.
    shift
        Below every eigenvalue; the modes closest to it are the most accurate.
    deflated
        Known M-orthonormal eigenvectors (3N, R).
    """

    def __init__(
        self,
        stiffness: sp.csr_matrix,
        nodal_mass: sp.csr_matrix,
        solve: Callable[[np.ndarray], np.ndarray],
        shift: float,
        deflated: np.ndarray,
    ):
        self._stiffness, self._mass, self._solve, self._shift = stiffness, nodal_mass, solve, shift
        self._known, self._basis = deflated.shape[1], np.array(deflated, order="F")
        self._ritz = np.zeros((0, 0))  # of the inverse, in the basis without the deflated vectors
        self._beyond = np.zeros((_BLOCK, _BLOCK))  # of the inverse of the last block, outside the basis
        self._next: tuple[np.ndarray, np.ndarray] | None = None  # following block, and M times it
        self._recent = np.empty((len(deflated), 0))  # M times the last two blocks

    def find(
        self, wanted: Callable[[np.ndarray], int], tolerance: float = RESIDUAL_TOLERANCE
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ascending eigenvalues (k,) and M-orthonormal vectors (3N, k).

        ``wanted`` maps ascending Ritz values to the number of lowest ones that must converge, up to a
        relative residual of the inverse. Raises ObjectFolderError if they do not converge.
        """
        size = len(self._basis)
        target = wanted(np.empty(0))
        if size <= max(MAX_DENSE_SIZE, MAX_DENSE_RATIO * target):
            return self._dense()
        check = max(int(_FIRST_CHECK * target) + 2 * _BLOCK, len(self._ritz))
        self._reserve(self._known + int(_RESERVE * check))
        while True:
            count = len(self._ritz)
            if count >= check or self._known + count + _BLOCK > size:
                check = int(_GROWTH * count) + 1
                inverse, share = la.eigh(self._ritz)
                inverse, share = inverse[::-1], share[:, ::-1]
                residual = np.linalg.norm(self._beyond @ share[-_BLOCK:], axis=0)
                positive = int((inverse > 0).sum())
                values = self._shift + 1 / inverse[:positive]
                number = wanted(values)
                if number <= positive and (residual[:number] < tolerance * inverse[:number]).all():
                    basis = self._basis[:, self._known : self._known + count]
                    return values[:number], basis @ share[:, :number]
                if self._known + count + _BLOCK > size or count > _MAX_BASIS_RATIO * (number + _BLOCK):
                    raise ObjectFolderError(
                        f"{number} modes of {size} unknowns do not converge in {count} vectors, which "
                        "happens if a solid is far too small, large, stiff or soft: check its scale and "
                        "material"
                    )
            self._extend()

    def _reserve(self, columns: int) -> None:
        """Make room for a basis of so many vectors. Memory is taken as they come."""
        if columns > self._basis.shape[1]:
            used = self._known + len(self._ritz)
            larger = np.empty((len(self._basis), columns), order="F")
            larger[:, :used] = self._basis[:, :used]
            self._basis = larger

    def _extend(self) -> None:
        """Add a block to the basis."""
        mass, known, count = self._mass, self._known, len(self._ritz)
        if self._next is None:
            start = np.random.default_rng(0).standard_normal((len(self._basis), _BLOCK))
            first = self._solve(_times(mass, start))
            pushed = _times(mass, self._basis[:, :known])
            self._next = _orthonormal(first, self._basis[:, :known], mass, pushed)[:2]
        stop = known + count + _BLOCK
        if stop > self._basis.shape[1]:
            self._reserve(int(1.5 * stop))
        new, pushed = self._next
        self._basis[:, known + count : stop] = new
        self._recent = np.concatenate([self._recent[:, -_BLOCK:], pushed], axis=1)
        used = self._basis[:, :stop]
        following, pushed, inside, self._beyond = _orthonormal(self._solve(pushed), used, mass, self._recent)
        self._next = following, pushed
        ritz = np.zeros((count + _BLOCK,) * 2)
        ritz[:count, :count] = self._ritz
        ritz[:, count:] = inside[known:]
        ritz[count:, :count] = ritz[:count, count:].T
        ritz[count:, count:] = (ritz[count:, count:] + ritz[count:, count:].T) / 2
        self._ritz = ritz

    def _dense(self) -> tuple[np.ndarray, np.ndarray]:
        """Solve for all modes at once."""
        deflated = self._basis[:, : self._known]
        mass = sp.kron(self._mass, sp.eye_array(3)).toarray()
        pushed = mass @ deflated
        lift = 1e3 * (self._stiffness.diagonal() / mass.diagonal()).max()  # above all others
        values, vectors = la.eigh(self._stiffness.toarray() + lift * pushed @ pushed.T, mass)
        modes = len(values) - self._known
        return values[:modes], vectors[:, :modes]


def _times(nodal_mass: sp.csr_matrix, vectors: np.ndarray) -> np.ndarray:
    """Multiply (3N, b) columns by the mass matrix."""
    nodes, columns = nodal_mass.shape[0], vectors.shape[1]
    return (nodal_mass @ vectors.reshape(nodes, 3 * columns)).reshape(-1, columns)


def _orthonormal(
    vectors: np.ndarray, basis: np.ndarray, nodal_mass: sp.csr_matrix, recent: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Decompose columns by an M-orthonormal basis: vectors = basis @ inside + new @ beyond.

    In exact arithmetic only the last basis vectors, of which ``recent`` is M times each, have non-zero
    coefficients; rounding leaves so little of the others that one pass over all of them suffices. Returns
    new, pushed (M times new), inside and beyond.
    """
    inside, beyond = np.zeros((basis.shape[1], vectors.shape[1])), np.eye(vectors.shape[1])
    vectors = np.asfortranarray(vectors)
    for first in (basis.shape[1] - recent.shape[1], 0):
        part = recent.T @ vectors if first else basis.T @ _times(nodal_mass, vectors)
        vectors = vectors - (part.T @ basis[:, first:].T).T  # twice as fast as basis @ part
        inside[first:] += part @ beyond
        # The remainder may be small and nearly dependent; orthonormalise it before M-orthonormalising it.
        vectors, triangle = la.qr(vectors, mode="economic", overwrite_a=True, check_finite=False)
        beyond = triangle @ beyond
    pushed = _times(nodal_mass, vectors)
    factor = la.cholesky(vectors.T @ pushed)
    new, pushed = (la.solve_triangular(factor, side.T, trans="T").T for side in (vectors, pushed))
    return new, pushed, inside, factor @ beyond
