import gc

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from refusals import refused
from solids import STUFF, box

from objectfolder.sound.fem import factorisation
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import solve_modes
from objectfolder.sound.fem.factorisation import Cholmod, Pardiso, SuperLU, factorise, nested_dissection

INSTALLED = {Pardiso: factorisation.PyPardisoSolver is not None, Cholmod: factorisation.cholmod is not None}
INSTALLED |= {SuperLU: True}


def library(kind):
    absent = pytest.mark.skipif(not INSTALLED[kind], reason=f"no library for {kind.__name__}")
    return pytest.param(kind, marks=absent)


every = pytest.mark.parametrize("kind", [library(kind) for kind in INSTALLED])
indefinite = pytest.mark.parametrize("kind", [library(Pardiso), library(SuperLU)])


@pytest.fixture(scope="module")
def plate():
    fem = cut_cells(*box((1, 1, 0.1)), 6, 4).assemble(STUFF, 1.0)
    return fem, scipy.linalg.eigvalsh(fem.stiffness.toarray(), fem.mass.toarray())


@every
@pytest.mark.parametrize("columns", [(), (1,), (5,)])
@pytest.mark.parametrize(("definite", "tolerance"), [(True, 1e-9), (False, 1e-6)])
def test_it_solves(kind, columns, definite, tolerance, plate, rng):
    if kind is Cholmod and not definite:
        pytest.skip("it takes definite matrices only")
    fem, values = plate
    shift = -1e6 if definite else values[40:42].mean()
    matrix = (fem.stiffness - shift * fem.mass).tocsr()
    right = rng.standard_normal((matrix.shape[0], *columns))
    solution = kind(matrix, nested_dissection(fem.nodal_mass), definite).solve(right)
    assert solution.shape == right.shape
    assert np.linalg.norm(matrix @ solution - right) < tolerance * np.linalg.norm(right)


@indefinite
def test_negative_pivots_count_the_eigenvalues_below(kind, plate):
    fem, values = plate
    gaps = 6 + np.flatnonzero(np.diff(values[6:120]) > 1e-3 * values[7:120])  # the first six are zero
    assert len(gaps) > 20
    for below in gaps[::5]:
        shift = values[below : below + 2].mean()
        shifted = (fem.stiffness - shift * fem.mass).tocsr()
        factor = kind(shifted, nested_dissection(fem.nodal_mass), definite=False)
        assert factor.negative_pivots() == below + 1


@pytest.mark.parametrize("kind", [library(Pardiso)])
def test_a_matrix_that_is_not_definite_as_said_is_an_error(kind):
    matrix = sp.diags([1.0, -1.0, 1.0]).tocsr()
    refused("not positive definite.*voxelize.element", kind, matrix, np.arange(3), definite=True)


@every
def test_several_live_at_once(kind, plate, rng):
    fem, _ = plate
    matrices = [(fem.stiffness + shift * fem.mass).tocsr() for shift in (1e6, 1e8)]
    factors = [kind(matrix, nested_dissection(fem.nodal_mass), definite=True) for matrix in matrices]
    right = rng.standard_normal(fem.stiffness.shape[0])
    for matrix, factor in zip(matrices, factors):
        assert np.linalg.norm(matrix @ factor.solve(right) - right) < 1e-9 * np.linalg.norm(right)


@indefinite
def test_a_spoiled_count_is_none_and_no_number(kind):
    diagonal = [1.0, 0.0, 0.0]
    matrix = sp.csr_matrix((diagonal, [0, 1, 2], [0, 1, 2, 3]))
    try:
        count = kind(matrix, np.arange(3), definite=False).negative_pivots()
    except RuntimeError:  # SuperLU: exactly singular
        return
    assert count is None


@pytest.mark.skipif(not INSTALLED[Pardiso], reason="no library for Pardiso")
def test_memory_is_given_back(plate):
    fem, _ = plate
    matrix = (fem.stiffness + 1e6 * fem.mass).tocsr()
    factor = factorise(matrix, nested_dissection(fem.nodal_mass), definite=True)
    assert isinstance(factor, Pardiso)
    solver = factor._solver
    assert solver.pt.any()
    del factor
    gc.collect()
    assert solver.factorized_A.shape == (0, 0)


@pytest.mark.parametrize("definite", [True, False])
def test_without_the_fast_libraries_scipy_factorises(definite, plate, monkeypatch):
    monkeypatch.setattr(factorisation, "PyPardisoSolver", None)
    monkeypatch.setattr(factorisation, "cholmod", None)
    fem, _ = plate
    matrix = (fem.stiffness + 1e6 * fem.mass).tocsr()
    assert isinstance(factorise(matrix, nested_dissection(fem.nodal_mass), definite), SuperLU)


def without(kind, monkeypatch):
    """Solve as if only the libraries from this one on were installed."""
    if kind is not Pardiso:
        monkeypatch.setattr(factorisation, "PyPardisoSolver", None)
    if kind is SuperLU:
        monkeypatch.setattr(factorisation, "cholmod", None)


@every
def test_modes_of_all_libraries_differ_by_rounding_alone(kind, plate, monkeypatch):
    fem, exact = plate
    without(kind, monkeypatch)
    modes = solve_modes(fem, 2000.0, 12, "plate")
    np.testing.assert_allclose(modes.eigenvalues, exact[6:18], rtol=1e-9)
    monkeypatch.undo()
    without(SuperLU, monkeypatch)
    same = solve_modes(fem, 2000.0, 12, "plate")
    np.testing.assert_allclose(modes.shapes, same.shapes, atol=1e-7 * np.abs(same.shapes).max())
