import numpy as np
import pytest
from solids import STUFF, box, united

from objectfolder.sound.fem import adaptive
from objectfolder.sound.fem.accuracy import Discretisation, coarser
from objectfolder.sound.fem.adaptive import refine_grid
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.local import refine_locally
from objectfolder.sound.fem.settings import FineGrids

LIMIT = 6_400
#: two blocks that a bar of 1.3 cells joins
DUMBBELL = united(*(box((0.25, 0.3, 0.4), (0, 0, z)) for z in (0.3, -0.3)), box((0.04, 0.04, 0.3)))


@pytest.fixture(scope="module")
def finest():
    return cut_cells(*DUMBBELL, 32, 4)


@pytest.fixture(scope="module")
def mixed(finest):
    return refine_locally(finest, LIMIT, STUFF, 1.0)


@pytest.fixture(scope="module")
def truth(finest):
    return Discretisation(finest, STUFF, 1.0).lowest_frequencies()


def test_small_elements_lie_where_the_solid_bends(mixed):
    solid = mixed.solid
    middle = (solid.index + solid.width[:, None] / 2) * solid.cell_size + solid.lower
    bar = np.abs(middle[:, 2]) < 0.09
    assert (solid.width[bar] == 1).all()
    assert solid.width[~bar].max() >= 4


@pytest.mark.slow
def test_few_unknowns_suffice_and_the_estimate_holds(finest, mixed, truth):
    coarse = Discretisation(coarser(finest), STUFF, 1.0)
    found, half = mixed.lowest_frequencies(), coarse.lowest_frequencies()
    assert mixed.solid.degrees_of_freedom <= LIMIT < 1.1 * coarser(finest).degrees_of_freedom
    error = np.abs(found / truth - 1).max()
    assert error < 0.02
    assert error < 0.1 * np.abs(half / truth - 1).max()
    assert max(mixed.errors(found)) > error


def test_a_grid_that_cannot_be_halved_twice_is_left():
    assert refine_locally(cut_cells(*DUMBBELL, 30, 4), LIMIT, STUFF, 1.0) is None


def test_sizes_are_mixed_where_uniform_grids_do_not_reach(monkeypatch):
    monkeypatch.setattr(adaptive, "_MIXED_RESOLUTIONS", (32,))
    fine = FineGrids(resolutions=(10, 12), subdivisions=4, max_degrees_of_freedom=LIMIT, max_error=0.02)

    def found(bulk):
        monkeypatch.setattr(adaptive, "_MIN_BULK_SHARE", bulk)
        return refine_grid(cut_cells(*DUMBBELL, 8, 4), DUMBBELL, fine, STUFF, 1.0).solid

    assert found(1.0).resolution <= 12
    mixed = found(-1.0)
    assert mixed.resolution == 32
    assert (mixed.width.min(), mixed.width.max()) == (1, 4)
