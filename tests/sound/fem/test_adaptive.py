from dataclasses import replace
from math import ceil

import numpy as np
import pytest
from solids import STUFF, box, join, sphere, tetrahedral_box

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sound.fem import adaptive
from objectfolder.sound.fem.accuracy import Discretisation
from objectfolder.sound.fem.adaptive import adaptive_cut_cells, fill_unsure, refine_grid
from objectfolder.sound.fem.blocks import merge_full_blocks
from objectfolder.sound.fem.cutcell import CutCells, cut_cells
from objectfolder.sound.fem.settings import FineGrids
from objectfolder.sound.fem.tetrahedra import Tetrahedra, simplified
from objectfolder.sound.fem.voxel import voxels

FINE = FineGrids(resolutions=(12, 16), subdivisions=4, max_degrees_of_freedom=10**6, max_error=0.02)
SHEET = box((1, 1, 0.03))  # 0.24 cells of eight
THICK = box((1, 1, 0.06))


@pytest.fixture(autouse=True)
def no_grid_is_small_and_none_too_coarse(monkeypatch):
    monkeypatch.setattr(adaptive, "_EXTRA_SIZE", 0)
    monkeypatch.setattr(adaptive, "_MAX_COARSENESS", np.inf)


def fine(size, max_error):
    return replace(FINE, max_degrees_of_freedom=size, max_error=max_error)


def frame():
    """Two boards on a third, with inner edges."""
    sides = [box((0.1, 0.5, 0.8), (x, 0, 0.0)) for x in (-0.4, 0.4)]
    return join(box((1, 0.5, 0.1), (0, 0, 0.45)), *sides)


def refine(surface, fine=FINE, resolution=8):
    return refine_grid(cut_cells(*surface, resolution, 4), surface, fine, STUFF, 1.0).solid


def estimating(monkeypatch, errors):
    """Let the estimate depend on the resolution; returns the resolutions asked about."""
    asked = []

    def estimate(candidate, _):
        asked.append(candidate.solid.resolution)
        error = errors[asked[-1]]
        return None if error is None else [error]

    monkeypatch.setattr(Discretisation, "lowest_frequencies", lambda *_: np.ones(1))
    monkeypatch.setattr(Discretisation, "errors", estimate)
    return asked


def no_solve(*_):
    raise AssertionError("modes were sought")


def test_resolution_is_the_first_that_is_small_enough():
    solid = sphere(0.5, 3)
    sizes = [merge_full_blocks(cut_cells(*solid, r, 4)).degrees_of_freedom for r in (8, 6, 4)]
    assert sizes[0] > sizes[1] > sizes[2]
    for limit, resolution in ((sizes[0], 8), (sizes[0] - 1, 6), (sizes[2], 4), (1, 4)):
        assert adaptive_cut_cells(*solid, [8, 6, 4], 4, limit).resolution == resolution


@pytest.mark.parametrize("solid", [sphere(0.5, 3), box((1, 1, 1)), SHEET, frame()])
@pytest.mark.parametrize("resolution", [8, 13])
def test_a_grid_has_never_fewer_unknowns_than_the_bound(solid, resolution):
    cells = merge_full_blocks(cut_cells(*solid, resolution, 4))
    bound = adaptive._least_unknowns(*solid)(resolution)
    assert 0.25 * cells.degrees_of_freedom < bound <= cells.degrees_of_freedom


def test_a_grid_that_is_surely_too_large_is_not_cut(monkeypatch):
    cut = []
    monkeypatch.setattr(adaptive, "cut_cells", lambda *args: cut.append(args[2]) or cut_cells(*args))
    assert adaptive_cut_cells(*SHEET, [32, 8], 4, 5000).resolution == 8
    assert cut == [8]


def test_large_errors_are_refined_and_small_ones_are_not():
    cells = cut_cells(*THICK, 8, 4)
    candidate = Discretisation(cells, STUFF, 1.0)
    error = max(candidate.errors(candidate.lowest_frequencies()))
    assert refine(THICK, fine(10**6, error * 0.99)).resolution == 12
    assert refine(THICK, fine(10**6, error * 1.01)).resolution == 8


@pytest.mark.parametrize(
    ("errors", "small", "chosen"),
    [
        pytest.param({8: 0.02 * 1.5**1.5 * 0.99, 12: 0.01}, 0, 12, id="the coarsest that should suffice"),
        pytest.param({8: 0.02 * 1.5**1.5 * 1.01}, 0, 16, id="nothing is finer than 16"),
        pytest.param({8: 0.021, 12: 0.021}, 0, 16, id="until it is accepted"),
        pytest.param({8: 0.01, 12: 0.006}, 1, 12, id="small ones until a third of it is accepted"),
        pytest.param({8: 0.01}, 1e-4, 8, id="not small"),
        pytest.param({8: None, 12: 0.01}, 0, 12, id="the next without an estimate"),
    ],
)
def test_grids_follow_the_estimates(monkeypatch, errors, small, chosen):
    monkeypatch.setattr(adaptive, "_EXTRA_SIZE", small)
    asked = estimating(monkeypatch, errors)
    assert refine(THICK).resolution == chosen
    assert asked == [*errors]


@pytest.mark.slow
def test_refining_brings_the_frequencies_nearer():
    solid = frame()
    finer, coarse = refine(solid, fine(10**6, 1e-9)), cut_cells(*solid, 8, 4)
    assert finer.resolution == 16
    grids = coarse, finer, cut_cells(*solid, 32, 4)
    found = [Discretisation(cells, STUFF, 1.0).lowest_frequencies() for cells in grids]
    errors = [np.abs(f / found[2] - 1).max() for f in found[:2]]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("wall", [0.03, 0.06])
def test_the_budget_of_unknowns_is_used_and_kept(wall):
    solid = box((1, 1, wall))
    size = merge_full_blocks(cut_cells(*solid, 16, 4)).degrees_of_freedom
    assert refine(solid, fine(size, 1e-9)).resolution == 16
    assert refine(solid, fine(size - 1, 1e-9)).resolution == 12


def test_nothing_finer_is_tried_where_there_is_none(monkeypatch):
    monkeypatch.setattr(Discretisation, "lowest_frequencies", no_solve)
    assert refine(SHEET, resolution=16).resolution == 16
    other = voxels(*box((1, 1, 0.3)), 8, incompatible=False)
    assert refine_grid(other, THICK, FINE, STUFF, 1.0).solid is other


def unsure(monkeypatch, made, errors, cells=8):
    """Fill `THICK` where cut cells and tetrahedra have these estimated errors; ``made`` makes the latter."""
    monkeypatch.setattr(adaptive, "tetrahedra", made)
    monkeypatch.setattr(Discretisation, "lowest_frequencies", lambda *_: np.ones(1))
    monkeypatch.setattr(Discretisation, "errors", lambda candidate, _: errors[candidate.solid.name])
    candidate = Discretisation(cut_cells(*THICK, cells, 4), STUFF, 1.0)
    return candidate, fill_unsure(candidate, THICK, FINE)


def blocks(vertices, faces, resolution, name, envelope):
    return tetrahedral_box((1, 1, 0.06), (resolution, resolution, 1))


@pytest.mark.parametrize(
    ("cut", "filled", "taken"),
    [([0.051], [0.05], True), (None, [0.2], True), ([0.051], [0.052], False)],
)
def test_the_surer_of_cut_cells_and_tetrahedra_is_taken(monkeypatch, cut, filled, taken):
    candidate, found = unsure(monkeypatch, blocks, {CutCells.name: cut, Tetrahedra.name: filled})
    assert isinstance(found.solid, Tetrahedra) is taken
    assert (found is candidate) is not taken
    assert not taken or found.coarse.elements < found.solid.elements


def test_cells_that_are_sure_are_not_filled(monkeypatch):
    candidate, found = unsure(monkeypatch, no_solve, {CutCells.name: [2.5 * FINE.max_error]})
    assert found is candidate


def test_a_solid_that_falls_apart_in_tetrahedra_keeps_its_cells(monkeypatch):
    def pieces(*_, **__):
        raise ObjectFolderError("two pieces")

    candidate, found = unsure(monkeypatch, pieces, {CutCells.name: [0.4]})
    assert found is candidate


def test_the_fine_tetrahedra_are_as_many_as_the_limit_allows(monkeypatch):
    asked = []

    def made(vertices, faces, resolution, name, envelope):
        asked.append((resolution, envelope))
        return tetrahedral_box((1, 1, 0.06), (resolution, resolution, 1))

    coarse = tetrahedral_box((1, 1, 0.06), (6, 6, 1)).degrees_of_freedom
    for growth, times in ((1.1, 0), (2, 1), (8, 2), (1e9, 2)):
        monkeypatch.setattr(adaptive, "_TETRAHEDRAL", growth * coarse / FINE.max_degrees_of_freedom)
        asked.clear()
        unsure(monkeypatch, made, {CutCells.name: [0.4], Tetrahedra.name: [0.1]})
        assert len(asked) == times
        if times == 2:
            finer = max(growth ** (-1 / 2.8), 0.45)
            assert asked[1] == (ceil(6 / finer), pytest.approx(asked[0][1] * finer**2))


@pytest.mark.parametrize(("share", "tried"), [(0.9, False), (1.1, True)])
def test_a_surface_of_too_many_details_is_not_filled(monkeypatch, share, tried):
    """Minutes of meshing would end in a mesh that is too large to have a finer one."""
    vertices, faces = sphere(0.4, 4)
    rough = vertices * np.random.default_rng(0).uniform(0.95, 1, (len(vertices), 1)), faces
    diagonal = np.linalg.norm(np.ptp(rough[0], axis=0))
    details = len(simplified(*rough, adaptive._ENVELOPE * diagonal)[1])
    assert details > 1000
    limit = share * 6 * details / adaptive._FINER**adaptive._FINENESS
    monkeypatch.setattr(adaptive, "_TETRAHEDRAL", limit / FINE.max_degrees_of_freedom)
    asked = []

    def made(*given):
        asked.append(given)
        raise ObjectFolderError("not needed here")

    monkeypatch.setattr(adaptive, "tetrahedra", made)
    monkeypatch.setattr(Discretisation, "lowest_frequencies", lambda *_: np.ones(1))
    monkeypatch.setattr(Discretisation, "errors", lambda *_: [0.4])
    candidate = Discretisation(cut_cells(*rough, 8, 4), STUFF, 1.0)
    assert fill_unsure(candidate, rough, FINE) is candidate
    assert bool(asked) is tried


def test_the_error_of_tetrahedra_is_estimated_from_coarser_ones():
    bars = [tetrahedral_box((1, 0.2, 0.1), counts) for counts in ((5, 1, 1), (10, 2, 1), (30, 6, 4))]
    found, truth = (Discretisation(bar, STUFF, 1.0).lowest_frequencies(4) for bar in bars[1:])
    error = np.abs(found / truth - 1)
    estimate = np.array(Discretisation(bars[1], STUFF, 1.0, bars[0]).errors(found))
    assert (estimate > 0.9 * error).all()
    assert estimate.max() < 2 * error.max()
