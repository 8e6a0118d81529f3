"""Rates at which errors of the lowest modes fall; `perf/modal_convergence.py` prints and draws more."""

import numpy as np
import pytest

from perf import modal_convergence as perf

COARSE = (12, 16, 24)
#: Least power of the cells' size: inner edges are singular, and the L-profile's wall is a quarter of a cell.
ORDERS = {
    "plate 1/10": 2.0,
    "plate 1/50": 2.0,
    "plate 1/200": 2.0,
    "pipe, wall 1/100": 2.0,
    "L-profile, wall 1/50": 1.3,
    "open box, boards 3/100": 1.3,
}


@pytest.fixture(scope="module")
def cases():
    return {case.name: case for case in perf.cases()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDERS)
def test_errors_fall_with_the_power_that_the_solid_allows(cases, name):
    worst = np.array([np.abs(perf.errors(cases[name], resolution)).max() for resolution in COARSE])
    assert (np.diff(worst) < 0).all()
    assert perf.order(1 / np.array(COARSE), worst) > ORDERS[name]


def test_the_boxes_truth_has_the_lame_mode_of_a_square_prism():
    """omega a = sqrt(2) pi c_s, exact for every Poisson's ratio and height."""
    shear = np.sqrt(perf.STUFF.youngs_modulus / (2 * (1 + perf.STUFF.poisson_ratio)) / perf.STUFF.density)
    found = 2 * np.pi * perf.box_modes((1.0, 1.0, 0.5), 30, 9)
    assert np.abs(found / (np.sqrt(2) * np.pi * shear) - 1).min() < 1e-5
