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
_BLOCK, _WIDE_BLOCK, _WIDE_BLOCK_MODES = 8, 16, 150  # block sizes; more modes than the last take the wide one
# Basis size, per wanted mode and column of a block, beyond which nothing converges; 6 suffice
_MAX_BASIS_RATIO = 50
_FIRST_CHECK, _GROWTH = 2.0, 1.06  # basis size per wanted mode at the first convergence check; growth after


def lowest_modes(
    stiffness: sp.csr_matrix,
    nodal_mass: sp.csr_matrix,
    solve: Callable[[np.ndarray], np.ndarray],
    shift: float,
    deflated: np.ndarray,
    wanted: Callable[[np.ndarray], int],
    tolerance: float = RESIDUAL_TOLERANCE,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the lowest eigenpairs of K u = lambda M u other than the deflated ones.

    K is (3N, 3N); M the Kronecker product of the nodal mass (N, N) with the identity. ``solve`` applies (K -
    shift M)^-1 to (3N, b) columns; the shift is below every eigenvalue, and the lowest modes are the most
    accurate. Deflated are known M-orthonormal eigenvectors (3N, R). ``wanted`` maps ascending Ritz values to
    the number of lowest ones that must converge, up to a relative residual of the inverse.

    Returns ascending values (k,) and M-orthonormal vectors (3N, k). Raises ObjectFolderError if the modes do
    not converge.
    """
    size, known = deflated.shape
    target = wanted(np.empty(0))
    if size <= max(MAX_DENSE_SIZE, MAX_DENSE_RATIO * target):
        mass = sp.kron(nodal_mass, sp.eye_array(3)).toarray()
        pushed = mass @ deflated
        lift = 1e3 * (stiffness.diagonal() / mass.diagonal()).max()  # above all others
        values, vectors = la.eigh(stiffness.toarray() + lift * pushed @ pushed.T, mass)
        return values[: size - known], vectors[:, : size - known]
    block = _WIDE_BLOCK if target > _WIDE_BLOCK_MODES else _BLOCK
    check = int(_FIRST_CHECK * target) + 4 * block
    basis = np.empty((size, known + check + block), order="F")
    basis[:, :known] = deflated
    ritz = np.zeros((0, 0))  # of the inverse, in the basis without the deflated vectors
    start = np.random.default_rng(0).standard_normal((size, block))
    new, pushed, _, _ = _orthonormal(solve(_times(nodal_mass, start)), basis[:, :known], nodal_mass, known)
    while True:
        count = len(ritz)
        if known + count + block > basis.shape[1]:
            larger = np.empty((size, int(1.5 * basis.shape[1])), order="F")
            larger[:, : known + count] = basis[:, : known + count]
            basis = larger
        basis[:, known + count : known + count + block] = new
        used = basis[:, : known + count + block]
        new, pushed, inside, beyond = _orthonormal(solve(pushed), used, nodal_mass, 2 * block)
        grown = np.zeros((count + block,) * 2)
        grown[:count, :count] = ritz
        grown[:, count:] = inside[known:]
        grown[count:, :count] = grown[:count, count:].T
        grown[count:, count:] = (grown[count:, count:] + grown[count:, count:].T) / 2
        ritz = grown
        count += block
        if count < check and known + count + block < size:
            continue
        check = int(_GROWTH * count)
        inverse, share = la.eigh(ritz)
        inverse, share = inverse[::-1], share[:, ::-1]
        residual = np.linalg.norm(beyond @ share[-block:], axis=0)
        positive = int((inverse > 0).sum())
        values = shift + 1 / inverse[:positive]
        number = wanted(values)
        if number <= positive and (residual[:number] < tolerance * inverse[:number]).all():
            return values[:number], used[:, known:] @ share[:, :number]
        if known + count + block > size or count > _MAX_BASIS_RATIO * (number + block):
            raise ObjectFolderError(
                f"{number} modes of {size} unknowns do not converge in {count} vectors, as of solids far too "
                "small, large, stiff or soft: check the object's scale and material"
            )


def _times(nodal_mass: sp.csr_matrix, vectors: np.ndarray) -> np.ndarray:
    """Multiply (3N, b) columns by the mass matrix."""
    nodes, columns = nodal_mass.shape[0], vectors.shape[1]
    return (nodal_mass @ vectors.reshape(nodes, 3 * columns)).reshape(-1, columns)


def _orthonormal(
    vectors: np.ndarray, basis: np.ndarray, nodal_mass: sp.csr_matrix, recent: int
) -> tuple[np.ndarray, ...]:
    """Decompose columns by an M-orthonormal basis: vectors = basis @ inside + new @ beyond.

    In exact arithmetic only the last ``recent`` basis vectors have non-zero coefficients; rounding leaves so
    little of the others that one pass over all of them suffices. Returns new, pushed (M times new), inside
    and beyond.
    """
    inside, beyond = np.zeros((basis.shape[1], vectors.shape[1])), np.eye(vectors.shape[1])
    for first in (max(basis.shape[1] - recent, 0), 0):
        part = basis[:, first:].T @ _times(nodal_mass, vectors)
        vectors = vectors - basis[:, first:] @ part
        inside[first:] += part @ beyond
        # The remainder may be small and nearly dependent; orthonormalise it before M-orthonormalising it.
        vectors, triangle = la.qr(vectors, mode="economic")
        beyond = triangle @ beyond
    pushed = _times(nodal_mass, vectors)
    factor = la.cholesky(vectors.T @ pushed)
    new, pushed = (la.solve_triangular(factor, side.T, trans="T").T for side in (vectors, pushed))
    return new, pushed, inside, factor @ beyond
