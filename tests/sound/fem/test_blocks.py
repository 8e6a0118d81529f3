import numpy as np
import pytest
from solids import STUFF, box, sphere

from objectfolder.sound.fem.blocks import halve_cells, merge_full_blocks
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.eigen import solve_modes


@pytest.fixture(scope="module")
def ball():
    return cut_cells(*sphere(0.5, 4), 8, 4)


@pytest.fixture(scope="module")
def merged(ball):
    return merge_full_blocks(ball)


def test_merging_keeps_the_volume_and_saves_unknowns(ball, merged):
    assert merged.volume == pytest.approx(ball.volume, rel=1e-12)
    assert merged.degrees_of_freedom < 0.85 * ball.degrees_of_freedom
    assert set(merged.width) == {1, 2}


def test_merged_elements_are_full_and_do_not_overlap(ball, merged):
    large = merged.width == 2
    assert (merged.fill[large] > 0.999).all()
    assert (merged.index[large] % 2 == 0).all()
    assert (~large).sum() + 8 * large.sum() == len(ball.index)


def test_displacements_are_continuous_where_sizes_meet(merged, rng):
    """From both sides of a face between a large element and a small one."""
    values = rng.standard_normal((merged.degrees_of_freedom // 3, 2))
    large = merged.index[merged.width == 2]
    on_top = np.concatenate([rng.random((20, 2)) * 2, np.full((20, 1), 2.0)], 1)
    face = (large[:, None] + on_top).reshape(-1, 3)
    places = face * merged.cell_size + merged.lower
    step = np.array([0, 0, 1e-9])
    below, above = merged.interpolate(values, places - step), merged.interpolate(values, places + step)
    np.testing.assert_allclose(below, above, atol=1e-6)


def test_merging_raises_the_lowest_frequencies_by_less_than_a_thousandth(ball, merged):
    fine, coarse = (solve_modes(c.assemble(STUFF, 1.0), 520, 5).eigenvalues for c in (ball, merged))
    # A subspace of displacements: no frequency can fall.
    assert (coarse >= fine * (1 - 1e-9)).all()
    np.testing.assert_allclose(coarse, fine, rtol=2e-3)


def test_a_thin_solid_has_nothing_to_merge():
    sheet = cut_cells(*box((1, 1, 0.1)), 8, 4)
    assert merge_full_blocks(sheet) is sheet


@pytest.mark.parametrize("merge", [False, True])
def test_halving_gives_the_moments_of_the_coarse_grid(ball, merged, merge):
    coarse = halve_cells(merged if merge else ball)[0]
    direct = cut_cells(*sphere(0.5, 4), 4, 8)
    order = [np.lexsort(c.index.T) for c in (coarse, direct)]
    np.testing.assert_array_equal(coarse.index[order[0]], direct.index[order[1]])
    np.testing.assert_allclose(coarse.occupancy[order[0]], direct.occupancy[order[1]], atol=0.05)
    assert coarse.volume == pytest.approx(ball.volume, rel=1e-6)
    assert coarse.degrees_of_freedom == direct.degrees_of_freedom


def test_a_rod_thinner_than_the_coarse_cells_cannot_be_halved():
    rod = cut_cells(*box((1, 1 / 200, 1 / 200)), 32, 8)
    while rod is not None:
        size, rod = rod.resolution, (halve_cells(rod) or (None,))[0]
    assert size == 16
