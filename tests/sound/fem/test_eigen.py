import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from refusals import refused
from scipy.optimize import brentq
from solids import STUFF, box, full_cells, sphere

from objectfolder.base.materials import Material
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import canonicalise, rigid_motions, solve_modes
from objectfolder.sound.fem.elasticity import FiniteElements

BAR = Material("bar", 1000.0, 1e9, 0.0, 0.0, 0.0)  # no Poisson effect: a bar is one-dimensional
THICK = 0.1


def beam(resolution, material=STUFF, subdivisions=8):
    return cut_cells(*box((1, THICK, THICK)), resolution, subdivisions).assemble(material, 1.0)


def hertz(modes):
    return np.sqrt(modes.eigenvalues) / (2 * np.pi)


def timoshenko_lowest(material):
    """First bending frequency of the free beam, from the determinant of Timoshenko's equations."""
    e, rho, nu = material.youngs_modulus, material.density, material.poisson_ratio
    area, inertia, shear = THICK**2, THICK**4 / 12, e / (2 * (1 + nu))
    kappa = 10 * (1 + nu) / (12 + 11 * nu)

    # Spectral elements are awkward by hand; Legendre polynomials converge to machine precision.
    n = 16
    x, w = np.polynomial.legendre.leggauss(2 * n)
    values = np.stack([np.polynomial.legendre.legval(x, u) for u in np.eye(n)])
    slopes = np.stack([np.polynomial.legendre.legval(x, np.polynomial.legendre.legder(u)) for u in np.eye(n)])
    w, slopes = w / 2, slopes * 2  # length 1

    def inner(a, b):
        return (a * w) @ b.T

    rigidity = kappa * shear * area
    across = -rigidity * inner(slopes, values)
    turning = rigidity * inner(values, values) + e * inertia * inner(slopes, slopes)
    stiffness = np.block([[rigidity * inner(slopes, slopes), across], [across.T, turning]])
    mass = scipy.linalg.block_diag(rho * area * inner(values, values), rho * inertia * inner(values, values))
    return np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[2]) / (2 * np.pi)


def test_bending_of_a_free_beam_converges_to_timoshenko():
    exact = timoshenko_lowest(STUFF)
    errors = [abs(hertz(solve_modes(beam(r), 150, 4))[0] / exact - 1) for r in (5, 10, 20)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1.5e-3


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e3, 1e5])
def test_frequencies_follow_the_size_from_millimetres_to_kilometres(scale):
    cells = cut_cells(*box((1, 0.31, 0.13)), 6, 4)
    one, other = (solve_modes(cells.assemble(STUFF, size), 300 / size, 6) for size in (1.0, scale))
    np.testing.assert_allclose(hertz(other) * scale, hertz(one), rtol=1e-9)


def test_longitudinal_frequencies_of_a_bar():
    f = hertz(solve_modes(beam(10, BAR), 2100, 60))
    for order in (1, 2, 3):
        exact = order / 2 * np.sqrt(1e9 / 1000)
        # No column ends within the grid's margin: the bar is 1e-4 longer.
        assert np.abs(f / exact - 1).min() < 1e-4 + 1e-4 * order**4


def test_torsion_of_a_square_bar():
    f = hertz(solve_modes(beam(20), 320, 20))
    shear = 1e9 / 2.6
    exact = 0.5 * np.sqrt(0.1406 * THICK**4 * shear / (1000 * THICK**4 / 6))  # Saint-Venant
    assert np.abs(f / exact - 1).min() < 0.01


def test_breathing_mode_of_a_sphere():
    """Lamb's radial mode: tan x = x / (1 - (x c_l / 2 c_t)^2)."""
    nu, radius = 0.3, 0.5
    longitudinal = np.sqrt(1e9 * (1 - nu) / (1000 * (1 + nu) * (1 - 2 * nu)))
    ratio = (1 - nu) / (1 - 2 * nu) / 2  # (c_l / 2 c_t)^2
    x = brentq(lambda x: np.sin(x) * (1 - ratio * x * x) - x * np.cos(x), 2, 3)
    exact = x * longitudinal / (2 * np.pi * radius)
    fem = cut_cells(*sphere(0.5, 4), 6, 4).assemble(STUFF, 1.0)
    modes = solve_modes(fem, 1.05 * exact, 80)
    radial = (fem.nodes / np.maximum(np.linalg.norm(fem.nodes, axis=1, keepdims=True), 1e-9)).ravel()
    radial *= np.repeat(np.linalg.norm(fem.nodes, axis=1), 3)
    overlap = np.abs(modes.shapes.T @ (fem.mass @ radial))
    breathing = overlap.argmax()
    assert hertz(modes)[breathing] == pytest.approx(exact, rel=0.01)
    assert overlap[breathing] > 3 * np.delete(overlap, breathing).max()


@pytest.fixture(scope="module")
def plate():
    fem = cut_cells(*box((1, 0.62, 0.2)), 6, 4).assemble(STUFF, 1.0)
    return fem, solve_modes(fem, 1500, 100)


def test_modes_satisfy_the_eigenproblem_and_are_mass_normalised(plate):
    fem, modes = plate
    assert modes.residuals.max() < 1e-7
    gram = modes.shapes.T @ fem.mass @ modes.shapes
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-9)
    rayleigh = modes.shapes.T @ fem.stiffness @ modes.shapes
    np.testing.assert_allclose(np.diag(rayleigh), modes.eigenvalues, rtol=1e-9)


def test_rigid_modes_are_at_zero_and_elastic_modes_orthogonal_to_them(plate):
    fem, modes = plate
    assert modes.rigid_frequencies.shape == (6,)
    assert modes.rigid_frequencies.max() < 1e-4 * hertz(modes)[0]
    rigid = rigid_motions(fem.nodes)
    rigid /= np.sqrt(np.einsum("ij,ij->j", rigid, fem.mass @ rigid))
    assert np.abs(rigid.T @ fem.mass @ modes.shapes).max() < 1e-6


def test_every_mode_that_inertia_counts_is_found(plate):
    fem, modes = plate
    values = scipy.linalg.eigh(fem.stiffness.toarray(), fem.mass.toarray(), eigvals_only=True)
    elastic = values[6:][values[6:] < (2 * np.pi * 1500) ** 2]
    assert modes.count_below == len(modes.eigenvalues) == len(elastic)
    assert not modes.truncated
    np.testing.assert_allclose(modes.eigenvalues, elastic, rtol=1e-8)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_keeping_fewer_modes_keeps_the_lowest_and_says_so(plate, count):
    fem, modes = plate
    fewer = solve_modes(fem, 1500, count)
    assert fewer.truncated
    assert fewer.count_below == modes.count_below
    np.testing.assert_allclose(fewer.shapes, modes.shapes[:, :count], atol=1e-6 * np.abs(modes.shapes).max())


@pytest.fixture(scope="module")
def square_bar():
    """A grid-aligned bar of square section: its bending modes are exactly repeated."""
    grid = np.array([[i, 2, 2] for i in range(5)])
    fem = full_cells(grid, 5).assemble(STUFF, 1.0)
    return fem, solve_modes(fem, 1500, 20)


def test_repeated_eigenvalues_are_found_and_get_the_same_basis_from_any_other(square_bar, rng):
    fem, modes = square_bar
    values, shapes = modes.eigenvalues, modes.shapes
    pairs = np.flatnonzero(np.diff(values) < 1e-9 * values[1:])
    assert len(pairs) >= 3
    mixed = shapes * rng.choice([-1, 1], shapes.shape[1])
    for i in pairs:
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        mixed[:, i : i + 2] = mixed[:, i : i + 2] @ turn
    np.testing.assert_allclose(canonicalise(values, mixed, fem), shapes, atol=1e-8 * np.abs(shapes).max())
    np.testing.assert_allclose(canonicalise(values, shapes, fem), shapes, atol=1e-8 * np.abs(shapes).max())


def test_nearly_repeated_eigenvalues_are_solved_as_well_as_others(square_bar):
    """They span one subspace, in a basis of which no vector alone is a mode."""
    fem, _ = square_bar
    heavier = fem.nodal_mass.copy()
    heavier[7, 7] *= 1 + 2e-5
    fem = FiniteElements.of(fem.stiffness, heavier, fem.nodes)
    modes = solve_modes(fem, 1500, 20)
    split = np.diff(modes.eigenvalues) / modes.eigenvalues[1:]
    assert ((split > 1e-7) & (split < 2e-6)).sum() >= 3
    assert modes.residuals.max() < 1e-8
    assert abs(modes.shapes.T @ fem.mass @ modes.shapes - np.eye(len(split) + 1)).max() < 1e-9


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("kept", [20, 1, 5])
def test_two_solves_from_different_start_vectors_agree(square_bar, monkeypatch, seed, kept):
    """Also where the number of modes kept parts a pair."""
    fem, modes = square_bar
    generator = np.random.default_rng
    monkeypatch.setattr(np.random, "default_rng", lambda _: generator(seed))
    other = solve_modes(fem, 1500, kept)
    expected = modes.shapes[:, :kept]
    np.testing.assert_allclose(other.shapes, expected, atol=1e-6 * np.abs(expected).max())


def test_a_solid_in_two_pieces_is_refused_by_name():
    cells = full_cells(np.array([[0, 0, 0], [3, 3, 3]]), 4)
    refused(r"^lamp: .*rigid modes.*expected 6", solve_modes, cells.assemble(STUFF, 1.0), 1e4, 10, "lamp")


def test_a_node_of_hardly_any_material_does_not_count_as_a_piece():
    """Slivers of cut cells have little mass, and a ratio of stiffness and mass far above all others."""
    fem = beam(10)
    light = np.ones(len(fem.nodes))
    light[0] = 1e-7
    scaled = sp.diags_array(light) @ fem.nodal_mass @ sp.diags_array(light)
    found = solve_modes(FiniteElements.of(fem.stiffness, scaled.tocsr(), fem.nodes), 150, 4)
    np.testing.assert_allclose(hertz(found)[0], hertz(solve_modes(fem, 150, 4))[0], rtol=0.01)
