import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from refusals import refused

from objectfolder.sound.fem.krylov import LowestModes

NODES = 400


@pytest.fixture(scope="module")
def strings():
    """Three equal strings: every eigenvalue is threefold, the lowest are known."""
    main, side = np.full(NODES, 2.0), np.full(NODES - 1, -1.0)
    main[[0, -1]] = 1
    chain = sp.diags_array([side, main, side], offsets=[-1, 0, 1])
    nodal = sp.diags_array(np.linspace(1, 3, NODES)).tocsr()
    stiffness = sp.kron(chain, sp.eye_array(3)).tocsr()
    mass = sp.kron(nodal, sp.eye_array(3)).tocsr()
    values, vectors = scipy.linalg.eigh(stiffness.toarray(), mass.toarray())
    return stiffness, nodal, mass, values, vectors


def solve(strings, known, number, shift=-1e-5):
    stiffness, nodal, mass, _, vectors = strings
    factor = sla.splu((stiffness - shift * mass).tocsc())
    return LowestModes(stiffness, nodal, factor.solve, shift, vectors[:, :known]).find(lambda found: number)


@pytest.mark.parametrize("number", [1, 7, 60, 200, 500, 1197])
def test_every_copy_of_the_lowest_eigenvalues_is_found_beside_the_known(strings, number):
    stiffness, _, mass, values, _ = strings
    found, vectors = solve(strings, 3, number)
    np.testing.assert_allclose(found[:number], values[3 : 3 + number], rtol=1e-8)
    vectors = vectors[:, :number]
    np.testing.assert_allclose(vectors.T @ mass @ vectors, np.eye(number), atol=1e-10)
    pushed = mass @ vectors * found[:number]
    residual = np.linalg.norm(stiffness @ vectors - pushed, axis=0)
    assert (residual < 1e-8 * np.linalg.norm(pushed, axis=0) + 1e-11).all()  # rounding of K


def test_what_does_not_converge_is_refused(strings):
    """The answers of a solver that are nothing but rounding."""
    stiffness, nodal, _, _, vectors = strings
    rng = np.random.default_rng(0)
    search = LowestModes(stiffness, nodal, lambda b: rng.normal(size=b.shape), -1e-5, vectors[:, :3])
    refused(
        r"^4 modes of 1200 unknowns do not converge in \d+ .*check its scale", search.find, lambda found: 4
    )


def test_a_later_request_continues_the_search(strings):
    stiffness, nodal, mass, values, vectors = strings
    factor, solves = sla.splu((stiffness + 1e-5 * mass).tocsc()), []

    def counted(right):
        solves.append(right.shape[1])
        return factor.solve(right)

    search = LowestModes(stiffness, nodal, counted, -1e-5, vectors[:, :3])
    rough, _ = search.find(lambda found: 5, 1e-3)
    np.testing.assert_allclose(rough, values[3:8], rtol=1e-5)
    first = len(solves)
    assert search.find(lambda found: 5, 1e-3)[0].tolist() == rough.tolist()
    assert len(solves) == first  # nothing new was needed
    found, _ = search.find(lambda found: 60)
    np.testing.assert_allclose(found, values[3:63], rtol=1e-8)
    both = len(solves)
    LowestModes(stiffness, nodal, counted, -1e-5, vectors[:, :3]).find(lambda found: 60)
    assert both <= len(solves) - both + 1


def test_the_known_vectors_stay_out(strings):
    _, _, mass, values, known = strings
    found, vectors = solve(strings, 9, 12)
    np.testing.assert_allclose(found[:12], values[9:21], rtol=1e-9)
    assert np.abs(known[:, :9].T @ mass @ vectors).max() < 1e-10


def test_a_shift_far_below_the_eigenvalues_finds_them_too(strings):
    found, _ = solve(strings, 3, 6, shift=-0.1)
    np.testing.assert_allclose(found[:6], strings[3][3:9], rtol=1e-7)


def test_the_wanted_number_may_depend_on_what_is_found(strings):
    stiffness, nodal, mass, values, vectors = strings
    limit = values[40] * 1.0001
    factor = sla.splu((stiffness + 1e-5 * mass).tocsc())
    search = LowestModes(stiffness, nodal, factor.solve, -1e-5, vectors[:, :3])
    found, _ = search.find(lambda ritz: int((ritz < limit).sum()) + 1)
    assert (found < limit).sum() == (values[3:] < limit).sum()
