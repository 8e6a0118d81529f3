import re

import numpy as np
import pytest
from solids import box

from objectfolder.base.materials import material
from objectfolder.sound.fem import modal
from objectfolder.sound.fem.certainty import is_uncertain, solver_warning, uncertainty_warning
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.modal import Request, modal_analysis, shape_points

SOLID = box((1, 0.5, 0.2))


@pytest.fixture(scope="module")
def cells():
    return cut_cells(*SOLID, 6, 4)


def analyse(cells, stuff, max_frequency=20000.0, count=40, scale=0.1):
    return modal_analysis(cells, SOLID[0], Request(stuff, scale, max_frequency, count), "slab")


def test_rayleigh_damping_and_damped_frequency(cells):
    wood = material("wood")
    data = analyse(cells, wood)
    assert len(data.eigenvalues) > 5
    np.testing.assert_allclose(data.damping, (60 + 2e-6 * data.eigenvalues) / 2)
    np.testing.assert_allclose(data.damped_frequency**2 + data.damping**2, data.eigenvalues)
    assert (np.diff(data.eigenvalues) >= 0).all()


def test_shapes_at_points_have_the_scale_of_a_free_solid(cells):
    """A mass-normalised mode of a mass m is of order 1 / sqrt(m)."""
    steel = material("steel")
    data = analyse(cells, steel)
    mass = 7850 * 0.1 * 1e-3
    assert data.report["mass_kg"] == pytest.approx(mass, rel=0.01)
    assert data.shapes.shape == (8, 3, len(data.eigenvalues))
    size = np.abs(data.shapes).max((0, 1)) * np.sqrt(mass)
    assert ((size > 0.5) & (size < 5)).all()


def test_corner_shapes_have_the_box_symmetry(cells):
    data = analyse(cells, material("steel"))
    # Reflections take corners to corners: a non-degenerate mode is even or odd, so magnitudes agree.
    size = np.abs(data.shapes)
    assert np.abs(size - size[:1]).max() < 0.02 * size.max()


def test_report_counts(cells):
    data = analyse(cells, material("steel"), count=3, scale=0.3)
    assert data.report["modes"] == len(data.eigenvalues) == 3
    assert data.report["truncated"]
    assert data.report["count_below_max_frequency"] > 3
    assert data.report["residual_max"] < 1e-7
    assert len(data.report["lowest_hz"]) == 3


def test_a_silent_object_has_no_modes(cells):
    data = analyse(cells, material("steel"), scale=0.001)
    assert data.shapes.shape == (8, 3, 0)
    assert data.report["modes"] == data.report["count_below_max_frequency"] == 0
    assert not data.report["truncated"]
    assert data.report["residual_max"] == 0
    assert max(data.report["rigid_hz"]) > 0.1  # rounding, of modes at a megahertz
    assert data.report["rigid_modes_ok"]


def test_the_uncertainty_is_the_largest_estimated_error(cells):
    report = analyse(cells, material("steel")).report
    assert report["frequency_uncertainty"] == max(report["discretisation_error"]) > 0
    silent = analyse(cells, material("steel"), max_frequency=100.0).report
    assert silent["frequency_uncertainty"] is None


@pytest.mark.parametrize(
    ("changes", "said", "uncertain"),
    [
        ({"discretisation_error": [0.1]}, None, False),
        ({"discretisation_error": [0.11]}, "frequencies may be 11% wrong, mode 1 most", False),
        ({"discretisation_error": [0.3]}, "30% wrong", False),
        ({"discretisation_error": [0.1, 0.31, 0.2]}, "31% wrong, mode 2 most", True),
        ({}, r"too thin for the 32\^3 grid to say how much", True),
        ({"element": "tet10"}, None, False),
        ({"modes": 0}, None, False),
    ],
)
def test_uncertain_frequencies_are_warned_of(changes, said, uncertain):
    """Cut cells without an estimate are as uncertain as can be."""
    report = {"discretisation_error": None, "resolution": 32, "element": "hex20 cut cells", "modes": 3}
    report |= changes
    report["frequency_uncertainty"] = max(report["discretisation_error"] or [None])
    assert is_uncertain(report) == uncertain
    text = uncertainty_warning(report, "cabinet")
    assert text is None if said is None else re.search(rf"^cabinet: .*{said}", text)
    assert not text or "marked" not in text  # accepted
    if uncertain:
        marked = uncertainty_warning(report | {"uncertain": True}, "cabinet")
        assert re.search(rf"^cabinet: .*{said}.*; the sound is marked .*: thicken .*allow_uncertain", marked)


def test_a_solve_whose_checks_fail_is_warned_of(cells):
    report = analyse(cells, material("steel")).report
    report |= {"residuals_ok": True, "rigid_modes_ok": True}
    assert solver_warning(report, "plate") is None
    assert "plate: the solver is less exact" in solver_warning(report | {"residuals_ok": False}, "plate")


def test_shapes_are_stored_at_a_bounded_number_of_vertices(monkeypatch):
    everything = shape_points(*SOLID, 50, np.random.default_rng(0))
    assert np.array_equal(everything[:8], SOLID[0])
    monkeypatch.setattr(modal, "MAX_VERTICES", 5)
    points = shape_points(*SOLID, 50, np.random.default_rng(0))
    assert points.shape == (55, 3)
    assert len({tuple(p) for p in points[:5]} & {tuple(v) for v in SOLID[0]}) == 5
    assert (np.abs(np.abs(points[5:]) - np.array([0.5, 0.25, 0.1])).min(1) < 1e-12).all()
