import dataclasses
import json
from unittest.mock import patch

import numpy as np
import pytest
from solids import box

from objectfolder.base.materials import material
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.modal import Request, modal_analysis, solved_band
from objectfolder.sound.fem.settings import ModalConfig
from objectfolder.sound.fem.similarity import similarity
from objectfolder.sound.truth import compute_modes, problem_digest, rescaled

SOLID = box((1, 0.55, 0.3))
GLASS = material("glass")
#: Glass with the stiffness, density and damping of iron.
IRON = dataclasses.replace(material("iron"), poisson_ratio=GLASS.poisson_ratio)
WOOD = dataclasses.replace(material("wood"), poisson_ratio=GLASS.poisson_ratio)
BASE = Request(GLASS, 0.2, 20000.0, 100)


@pytest.fixture(scope="module")
def solve():
    cells, done = cut_cells(*SOLID, 6, 4), {}

    def modes(request):
        if request not in done:
            done[request] = modal_analysis(cells, SOLID[0], request)
        return done[request]

    return modes


def stored(solve, request, task="task"):
    """What the stage keeps of a solve."""
    return computed(solve, request, task, None)[0]


def computed(solve, request, task, earlier):
    with patch("objectfolder.sound.truth.refined_analysis", lambda *_, **__: solve(request)):
        return compute_modes(None, None, None, request, None, task, earlier, "box")


@pytest.mark.parametrize(
    "changes",
    [
        {"scale": 0.15},
        {"scale": 0.07},
        {"material": dataclasses.replace(GLASS, alpha=60.0, beta=2e-6)},
        {"material": IRON, "scale": 0.19},
        {"material": WOOD, "scale": 0.15},
        {"max_frequency": 9000.0},
        {"max_modes": 5},
        {"scale": 0.15, "max_modes": 5},
        {"max_frequency": 300.0},
    ],
)
def test_it_is_what_a_solve_finds(solve, changes):
    wanted = dataclasses.replace(BASE, **changes)
    data, fresh = rescaled(stored(solve, BASE), "task", wanted), solve(wanted)
    assert data is not None
    for name, value in fresh.arrays().items():
        if name != "residuals":
            found = getattr(data, name)
            assert found.dtype == value.dtype
            np.testing.assert_allclose(found, value, rtol=1e-6, atol=1e-6 * np.abs(value).max(initial=0))
    assert data.report.keys() == fresh.report.keys()
    for name, value in fresh.report.items():
        loose = {"rel": 1e-6, "abs": 0.01} if name != "rigid_hz" else {"abs": 0.1}
        exact = value is None or isinstance(value, str)
        assert data.report[name] == (value if exact else pytest.approx(value, **loose)), name
    assert data.report["residual_max"] < 1e-8
    assert solved_band(data, wanted) == pytest.approx(solved_band(fresh, wanted))


def test_the_lowest_modes_of_a_truncated_solve_serve_again(solve):
    few = dataclasses.replace(BASE, max_modes=6)
    wanted = dataclasses.replace(few, scale=0.19)
    data, fresh = rescaled(stored(solve, few), "task", wanted), solve(wanted)
    np.testing.assert_allclose(data.eigenvalues, fresh.eigenvalues, rtol=1e-6)
    assert data.report["truncated"] is fresh.report["truncated"] is True
    assert data.report["count_below_max_frequency"] is None  # it was not counted
    assert solved_band(data, wanted) == pytest.approx(solved_band(fresh, wanted))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, "the stage runs again to solve again"),
        ({"scale": 0.21}, "modes come into the band"),
        ({"material": WOOD, "scale": 0.2}, "a softer object has more modes"),
        ({"max_frequency": 20001.0}, "more modes are wanted"),
    ],
)
def test_it_takes_a_solve(solve, changes, why):
    assert rescaled(stored(solve, BASE), "task", dataclasses.replace(BASE, **changes)) is None, why
    few = dataclasses.replace(BASE, max_modes=6)
    more = dataclasses.replace(few, max_modes=7)
    assert rescaled(stored(solve, few), "task", more) is None


def test_the_same_request_on_tetrahedra_takes_no_solve(solve):
    """fTetWild makes another mesh each time, and the stage is to give the same bytes."""
    arrays, report = computed(solve, BASE, "task", None)
    record = json.loads(str(arrays["solution"]))
    record["report"]["element"] = "tet10"
    earlier = arrays | {"solution": np.asarray(json.dumps(record, sort_keys=True))}
    again, told = computed(None, BASE, "task", earlier)
    assert told == report | {"element": "tet10"}
    assert told["reused"] is False
    assert again.keys() == earlier.keys()
    for name, value in earlier.items():
        np.testing.assert_array_equal(again[name], value, strict=True)
    for task, wanted in (("another", BASE), ("task", dataclasses.replace(BASE, max_frequency=20001.0))):
        with pytest.raises(TypeError):  # it is solved
            computed(None, wanted, task, earlier)


def test_another_solid_or_solver_takes_a_solve(solve):
    wanted, solved = dataclasses.replace(BASE, scale=0.1), stored(solve, BASE)
    for task, earlier, reused in (("task", solved, True), ("another", solved, False), ("task", None, False)):
        arrays, report = computed(solve, wanted, task, earlier)
        assert report["reused"] is reused
        assert json.loads(str(arrays["solution"]))["problem"] == task


def test_a_solve_by_a_version_whose_materials_have_other_fields_takes_a_solve(solve):
    """`problem_digest` covers their names."""
    old = stored(solve, BASE)
    record = json.loads(str(old["solution"]))
    record["request"]["material"]["roughness"] = 0.5
    old["solution"] = np.array(json.dumps(record))
    assert rescaled(old, "another", dataclasses.replace(BASE, scale=0.1)) is None


@pytest.mark.slow
def test_modes_that_were_dropped_take_a_solve(solve):
    large = Request(GLASS, 200.0, 60.0, 100)  # its first modes are below 20 Hz
    assert rescaled(stored(solve, large), "task", dataclasses.replace(large, scale=20.0)) is None
    dull = dataclasses.replace(BASE, material=dataclasses.replace(GLASS, beta=2e-5))
    assert 0 < len(solve(dull).damping) < len(solve(BASE).damping)
    assert rescaled(stored(solve, dull), "task", dataclasses.replace(dull, material=GLASS)) is None


def test_modes_that_become_overdamped_are_dropped(solve):
    dull = dataclasses.replace(BASE, material=dataclasses.replace(GLASS, beta=2e-5))
    data, fresh = rescaled(stored(solve, BASE), "task", dull), solve(dull)
    np.testing.assert_allclose(data.damped_frequency, fresh.damped_frequency, rtol=1e-6)
    assert data.report["count_below_max_frequency"] == fresh.report["count_below_max_frequency"]
    assert np.isfinite(data.damped_frequency).all()


def test_the_band_ends_where_modes_are_overdamped(solve):
    def band(**damping):
        request = dataclasses.replace(BASE, material=dataclasses.replace(GLASS, **damping))
        return solved_band(solve(request), request), len(solve(request).damping)

    (low, high), count = band(beta=2e-5)
    natural = np.sqrt(solve(BASE).eigenvalues) / (2 * np.pi)
    assert low == 20
    assert high == pytest.approx(2 / 2e-5 / (2 * np.pi), rel=1e-4)
    assert ((natural > low) & (natural < high)).sum() == count
    # Damped by its mass alone, the low ones are.
    assert band(alpha=1e5, beta=0.0)[0] == [pytest.approx(1e5 / 4 / np.pi), 20000]
    (low, high), _ = band(alpha=1e5, beta=1e-3)
    assert low == high


@pytest.mark.slow
def test_the_band_of_an_object_that_is_not_heard(solve):
    small = dataclasses.replace(BASE, scale=0.01)
    assert len(solve(small).damping) == 0  # all above 20 kHz
    assert solved_band(solve(small), small) == [0, 20000]
    again = rescaled(stored(solve, BASE), "task", small)
    assert again.shapes.shape == (8, 3, 0)
    assert again.report["lowest_hz"] == []
    # All modes that were kept are below hearing: nothing is known.
    large = Request(GLASS, 200.0, 60.0, 1)
    assert solve(large).report["modes"] == 0
    low, high = solved_band(solve(large), large)
    assert low == high
    # With a loss factor only those are missing, however large alpha and beta.
    slack = dataclasses.replace(GLASS, alpha=1e5, beta=2e-5, loss_factor=((1000.0, 0.01),))
    deep = Request(slack, 200.0, 60.0, 1000)
    assert 0 < solve(deep).report["modes"] < solve(deep).report["count_below_max_frequency"]
    assert solved_band(solve(deep), deep) == [20, 60]


def test_similarity_is_that_of_the_wave_equation():
    assert similarity((GLASS, 0.2), (GLASS, 0.2)) == (1, 1)
    eigenvalue, shape = similarity((GLASS, 0.2), (IRON, 0.4))
    assert eigenvalue == pytest.approx(2.1e11 / 6.2e10 * 2600 / 8000 / 4)
    assert shape == pytest.approx((8000 / 2600 * 8) ** -0.5)


def test_a_problem_is_all_that_scaling_leaves():
    points, config = np.arange(6.0).reshape(2, 3), ModalConfig()
    first = ("solid", "surface"), "code", points, 0.2, config
    others = [
        (("solid",), *first[1:]),
        (first[0], "other code", *first[2:]),
        (*first[:2], points + 1e-9, *first[3:]),
        (*first[:3], 0.21, config),
        (*first[:4], dataclasses.replace(config, surface_points=7)),
        (*first[:4], dataclasses.replace(config, fine=dataclasses.replace(config.fine, max_error=0.5))),
    ]
    assert len({problem_digest(*problem) for problem in (first, *others)}) == 7
    harmless = dataclasses.replace(config, max_modes=7, damping="loss_factor")
    assert problem_digest(*first) == problem_digest(*first[:2], points.copy(), 0.2, harmless)
