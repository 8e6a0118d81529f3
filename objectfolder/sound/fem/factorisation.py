"""Symmetric sparse factorisation by the fastest installed library.

`Pardiso` (Intel MKL, through pypardiso) takes a third of the time and half of the memory of `SuperLU`
(scipy), which is always available. `Cholmod` (cvxopt) factorises definite matrices; it is under the GPL, so
this project never installs it.
"""

import ctypes
import os
import sys
import weakref
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pymetis
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from objectfolder.base.errors import ObjectFolderError

for library in Path(sys.prefix, "lib").glob("libmkl_rt.so*"):
    os.environ.setdefault("PYPARDISO_MKL_RT", str(library))  # otherwise every solver searches sys.prefix
try:
    from pypardiso import PyPardisoSolver
    from pypardiso.pardiso_wrapper import PyPardisoError
except ImportError:  # installed on x86-64 only
    PyPardisoSolver = None
try:
    from cvxopt import cholmod, spmatrix
    from cvxopt import matrix as dense
except ImportError:
    cholmod = None

_SEPARATORS, _MANY_NODES = 5, 30_000  # separators that are tried for graphs of more nodes


class Factorisation(Protocol):
    """Factorised symmetric matrix."""

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for (3N,) or (3N, b) right-hand sides."""

    def negative_pivots(self) -> int | None:
        """Count negative eigenvalues of the matrix (Sylvester); None if pivoting spoiled the count."""


class Pardiso:
    """LDL^T, or L L^T if positive definite."""

    def __init__(self, matrix: sp.csr_matrix, order: np.ndarray, definite: bool):
        upper = sp.csr_matrix(sp.triu(matrix))
        upper.sort_indices()
        self._size = upper.shape[0]
        self._arrays = upper.data, upper.indptr.astype(np.int32) + 1, upper.indices.astype(np.int32) + 1
        self._solver = PyPardisoSolver(mtype=2 if definite else -2)
        weakref.finalize(self, self._solver.free_memory, everything=True)
        self._solver.perm = order.astype(np.int32) + 1
        # No defaults, the given order, pivots perturbed below 1e-8. The defaults refine every solution, at
        # four times the cost.
        for name, value in {1: 1, 5: 1, 10: 8}.items():
            self._solver.set_iparm(name, value)
        self._call(12, np.zeros((self._size, 1), order="F"))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for (3N,) or (3N, b) right-hand sides."""
        return self._call(33, np.asfortranarray(right, np.float64))

    def _call(self, phase: int, right: np.ndarray) -> np.ndarray:
        """Call the library. PyPardisoSolver's own method compares and copies the matrix at every call."""
        solution, error = np.zeros_like(right), ctypes.c_int32(0)
        values, rows, columns = self._arrays
        columns_of_right = 1 if right.ndim == 1 else right.shape[1]

        def pointer(array: np.ndarray) -> Any:
            return array.ctypes.data_as(ctypes.POINTER(np.ctypeslib.as_ctypes_type(array.dtype)))

        def number(value: int) -> Any:
            return ctypes.byref(ctypes.c_int32(value))

        self._solver._mkl_pardiso(
            pointer(self._solver.pt),
            *(number(value) for value in (1, 1, self._solver.mtype, phase, self._size)),
            *(pointer(array) for array in (values, rows, columns, self._solver.perm)),
            number(columns_of_right),
            pointer(self._solver.iparm),
            number(0),
            pointer(right),
            pointer(solution),
            ctypes.byref(error),
        )
        if error.value == -4:  # a pivot is zero, or negative in L L^T
            raise ObjectFolderError(
                "a matrix is not positive definite, since elements have no volume or a negative one; take "
                "another voxelize.resolutions or voxelize.element"
            )
        if error.value:
            raise PyPardisoError(error.value)
        return solution

    def negative_pivots(self) -> int | None:
        """Count negative eigenvalues of the matrix (Sylvester); None if pivoting spoiled the count."""
        perturbed, negative = self._solver.get_iparm(14), self._solver.get_iparm(23)
        return None if perturbed else int(negative)


class SuperLU:
    """LDL^T."""

    def __init__(self, matrix: sp.csr_matrix, order: np.ndarray, definite: bool):
        self._order = order
        self._inverse = np.argsort(self._order)
        self._lu = sla.splu(
            matrix[self._order][:, self._order].tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for (3N,) or (3N, b) right-hand sides."""
        return self._lu.solve(np.asfortranarray(right[self._order]))[self._inverse]

    def negative_pivots(self) -> int | None:
        """Count negative eigenvalues of the matrix (Sylvester); None if pivoting spoiled the count."""
        if not np.array_equal(self._lu.perm_r, np.arange(len(self._order))):
            return None
        return int((self._lu.U.diagonal() < 0).sum())


class Cholmod:
    """L L^T of a positive definite matrix."""

    def __init__(self, matrix: sp.csr_matrix, order: np.ndarray, definite: bool):
        self._order = order
        self._inverse = np.argsort(self._order)
        lower = sp.tril(matrix[self._order][:, self._order]).tocoo()
        rows, columns = (dense(index.astype(np.int64)) for index in (lower.row, lower.col))
        cells = spmatrix(dense(lower.data), rows, columns, matrix.shape)
        cholmod.options["supernodal"] = 2
        self._factor = cholmod.symbolic(cells, p=dense(np.arange(matrix.shape[0])))
        cholmod.numeric(cells, self._factor)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for (3N,) or (3N, b) right-hand sides."""
        solution = dense(np.asfortranarray(right[self._order]))
        cholmod.solve(self._factor, solution)
        return np.array(solution).reshape(right.shape)[self._inverse]

    def negative_pivots(self) -> int | None:
        """Return 0: the matrix is positive definite."""
        return 0


def factorise(matrix: sp.csr_matrix, order: np.ndarray, definite: bool = False) -> Factorisation:
    """Factorise a symmetric matrix (3N, 3N) with three unknowns per node, known to be definite or not.

    The order of elimination (3N,) is that of `nested_dissection`.
    """
    if PyPardisoSolver is not None:
        return Pardiso(matrix, order, definite)
    if definite and cholmod is not None:
        return Cholmod(matrix, order, definite)
    return SuperLU(matrix, order, definite)


def nested_dissection(nodal_graph: sp.csr_matrix) -> np.ndarray:
    """Return a fill-reducing order of the unknowns by METIS, (3N,), from the adjacency (N, N) of the nodes.

    All matrices of a solid share it. It is found on the nodes, a ninth of the work of an order of unknowns.
    """
    graph = nodal_graph.copy()
    graph.setdiag(0)
    graph.eliminate_zeros()
    # Of several separators the best: a tenth to a fifth of the operations of a large matrix.
    options = pymetis.Options(nseps=_SEPARATORS if graph.shape[0] > _MANY_NODES else 1)
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    order = np.asarray(pymetis.nested_dissection(adjacency, options=options)[0])
    return (3 * order[:, None] + np.arange(3)).ravel()
