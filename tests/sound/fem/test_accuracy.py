"""Frequencies against analytic truths; the same figures as `perf/modal_accuracy.py` prints."""

from pathlib import Path

import numpy as np
import pytest
from solids import box

from objectfolder.base.materials import Material
from objectfolder.sound.fem.accuracy import Discretisation, discretisation_error, resolved_frequency
from objectfolder.sound.fem.blocks import halve_cells, merge_full_blocks
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import solve_modes
from perf import modal_accuracy as perf

BAR = Material("bar", 1000.0, 1e9, 0.0, 0.0, 0.0)
OBJECTS = Path(__file__).parents[4] / "shared" / "objects"


def test_free_plate_thinner_than_a_cell():
    assert perf.plate().value <= 0.01
    assert perf.plate("converged", perf.KIRCHHOFF).value <= 0.01


def thin_plate(thick, resolution):
    """Cells of a free square plate, and the frequencies of the Kirchhoff plate, Hz."""
    exact = np.array(perf.KIRCHHOFF) * perf.WAVE * thick / np.sqrt(12 * (1 - 0.3**2)) / (2 * np.pi)
    return cut_cells(*perf.box((1, 1, thick), (0, 0, 0.013)), resolution, 8), exact


@pytest.mark.parametrize("slenderness", [50, 100, 200])
def test_plates_of_a_tenth_of_a_cell_do_not_lock(slenderness):
    cells, exact = thin_plate(1 / slenderness, 16)
    assert np.abs(Discretisation(cells, perf.STUFF, 1.0).lowest_frequencies(6) / exact - 1).max() < 0.012


def test_the_error_of_a_thin_plate_falls_with_the_square_of_the_cells_and_is_not_underestimated():
    errors, estimates = [], []
    for resolution in (8, 16):
        cells, exact = thin_plate(1 / 200, resolution)
        found = Discretisation(cells, perf.STUFF, 1.0).lowest_frequencies(6)
        errors.append(found / exact - 1)
        estimates.append(np.array(Discretisation(cells, perf.STUFF, 1.0).errors(found)))
    assert (errors[1] < errors[0] / 4).all()
    assert (np.array(estimates) > errors).all()


@pytest.mark.parametrize("wall", [*(pytest.param(cells, marks=pytest.mark.slow) for cells in (0.5, 2)), 1])
def test_free_cylinder_with_a_wall_of_few_cells(wall):
    assert perf.cylinder(wall).value <= 0.01


def test_the_cylinders_truth_is_the_ring_where_it_is_thin():
    """Inextensional bending of a thin ring (Hoppe)."""
    thick, radius = 0.004, 0.5
    for n in (2, 3):
        exact = n * (n * n - 1) / np.sqrt(n * n + 1) * thick / (np.sqrt(12) * radius**2)
        found = perf.pipe_modes(radius + thick / 2, radius - thick / 2, thick, n, 6)
        assert np.abs(found / (exact * perf.WAVE / (2 * np.pi)) - 1).min() < 2e-3


def test_slender_free_beam():
    assert perf.beam().value <= 0.01


@pytest.mark.slow
def test_volume_of_thin_aligned_boards():
    assert perf.aligned_volume().value <= 0.003


@pytest.mark.slow
def test_the_estimate_is_of_the_size_of_the_error_where_the_solid_is_smooth():
    solid = box((1, 0.3, 0.05), (0, 0.01, 0.013))
    grid, fine = (cut_cells(*solid, r, 8) for r in (8, 48))
    coarse, exact = (Discretisation(cells, BAR, 1.0).lowest_frequencies(4) for cells in (grid, fine))
    error, estimate = coarse / exact - 1, np.array(Discretisation(grid, BAR, 1.0).errors(coarse))
    assert (estimate > 0.8 * error).all()
    assert estimate.max() < 10 * error.max()


@pytest.mark.parametrize("order", [1, 1.5, 2])
def test_the_estimate_is_within_a_factor_of_two_for_usual_orders_of_convergence(order):
    grids = (np.full(3, 1 + 0.01 * 2 ** (order * halvings)) for halvings in range(3))
    estimate = discretisation_error(*grids)
    assert 0.5 < min(estimate) / 0.01 <= max(estimate) / 0.01 < 2
    if order == 1.5:
        np.testing.assert_allclose(estimate, 0.01, rtol=0.02)


def test_where_differences_do_not_fall_the_last_one_is_the_estimate():
    np.testing.assert_allclose(discretisation_error(np.ones(3), np.full(3, 1.1), np.full(3, 1.15)), 0.1)


def test_quick_frequencies_are_those_of_the_full_solve():
    cells = cut_cells(*box((1, 0.7, 0.1)), 8, 4)
    exact = np.sqrt(solve_modes(cells.assemble(BAR, 1.0), 2000, 8).eigenvalues) / (2 * np.pi)
    np.testing.assert_allclose(Discretisation(cells, BAR, 1.0).lowest_frequencies(8), exact, rtol=1e-6)


def test_no_estimate_where_there_is_no_coarser_grid_or_no_mode():
    odd = cut_cells(*box((1, 0.5, 0.5)), 5, 4)
    assert halve_cells(odd) is None
    assert Discretisation(odd, BAR, 1.0).errors(np.array([1e6])) is None
    assert Discretisation(cut_cells(*box((1, 0.5, 0.5)), 4, 4), BAR, 1.0).errors(np.empty(0)) is None


def test_the_resolved_frequency_is_that_of_waves_three_elements_long():
    cells = cut_cells(*box((1, 1, 0.5)), 8, 4)
    length = 3 * 0.2 / 8
    stuff = Material("stuff", 1000.0, 1e9, 0.3, 0.0, 0.0)
    assert resolved_frequency(cells, stuff, 0.2, np.inf) == pytest.approx(np.sqrt(1e9 / 2.6 / 1000) / length)
    merged = merge_full_blocks(cut_cells(*box((1, 1, 1)), 16, 4))  # full elements are the largest
    assert merged.width[~merged.is_full].max() < merged.width.max()
    expected = np.sqrt(1e9 / 2.6 / 1000) / (3 * merged.width.max() * 0.2 / 16)
    assert resolved_frequency(merged, stuff, 0.2, np.inf) == pytest.approx(expected)
    wall = 0.004
    rigidity = 1e9 * (wall * 0.2) ** 3 / (12 * (1 - 0.3**2))
    bending = (2 * np.pi / length) ** 2 * np.sqrt(rigidity / (1000 * wall * 0.2)) / (2 * np.pi)
    assert resolved_frequency(cells, stuff, 0.2, wall) == pytest.approx(bending)


@pytest.mark.slow
def test_shapes_are_the_same_with_one_thread_and_two():
    assert perf.threads().value < 1e-8


@pytest.mark.slow
def test_mug_with_a_wall_of_four_millimetres_agrees_with_tetrahedra():
    """Within the error that a build accepts (`modal.fine.max_error`), which docs/modal.md claims."""
    assert perf.mug().value <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("key", ["gso_salad_plate", "gso_school_bell"])
def test_real_objects_agree_with_a_refined_grid(key):
    path = OBJECTS / key / "mesh.obj"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    rows = {row.name.split(": ")[1]: row for row in perf.real(path)}
    del rows["CPU s"]
    assert all(row.value <= row.target for row in rows.values()), rows
