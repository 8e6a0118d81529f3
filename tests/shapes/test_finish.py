import numpy as np
import pytest
from refusals import refused

from objectfolder.shapes.finish import FINISHES, PATTERNS, finish
from objectfolder.shapes.texture import rgb, wood

SIZE = 0.12


def cloud(count: int = 4000, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-SIZE / 2, SIZE / 2, (count, 3)) + np.array([0, 0, SIZE / 2])


@pytest.mark.parametrize("name", FINISHES)
def test_paint_maps_points_to_colours_each_on_its_own(name):
    """A solid texture: the colour depends on the point alone, not on its neighbours in the call."""
    points = cloud()
    made = finish(name, SIZE)
    colour = made.paint(points)
    assert colour.shape == (4000, 3)
    assert colour.min() >= 0
    assert colour.max() <= 1
    assert len(np.unique(colour.round(4), axis=0)) > 500
    order = np.random.default_rng(1).permutation(4000)
    np.testing.assert_allclose(made.paint(points[order]), colour[order], atol=1e-12)
    assert 0 < made.roughness < 1
    assert 0 <= made.metallic <= 1


@pytest.mark.parametrize("name", FINISHES)
def test_seed_and_colours_decide_the_look(name):
    points = cloud()
    first = finish(name, SIZE, "3f6f96", "d9973c", 4).paint(points)
    assert np.array_equal(first, finish(name, SIZE, "3f6f96", "d9973c", 4).paint(points))
    assert np.abs(first - finish(name, SIZE, "3f6f96", "d9973c", 5).paint(points)).max() > 0.02
    assert np.abs(first - finish(name, SIZE, "3f6f96", "2a2a2a", 4).paint(points)).max() > 0.02
    red = finish(name, SIZE, "b02020", "a02020").paint(points).mean(0)
    blue = finish(name, SIZE, "2020b0", "2020a0").paint(points).mean(0)
    assert red[0] > 1.5 * red[2]
    assert blue[2] > 1.5 * blue[0]


@pytest.mark.parametrize("name", sorted(set(FINISHES) - {"wood", "cast", "glaze"}))
def test_pattern_grows_with_the_object(name):
    points = cloud()
    small = finish(name, SIZE, seed=2).paint(points)
    np.testing.assert_allclose(finish(name, 2 * SIZE, seed=2).paint(2 * points), small, atol=1e-9)


@pytest.mark.parametrize("name", ["wood", "brushed"])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0.3, -0.5, 0.8)])
def test_grain_runs_along_the_axis(name, axis):
    """Colours change slowly along the grain and fast across it."""
    along = np.array(axis) / np.linalg.norm(axis)
    across = np.cross(along, [0.2, 0.9, 0.1])
    across /= np.linalg.norm(across)
    points, step = cloud(), SIZE / 300
    paint = finish(name, SIZE, axis=axis).paint

    def change(direction: np.ndarray) -> float:
        return float(np.abs(paint(points + step * direction) - paint(points)).mean())

    assert change(across) > 3 * change(along)


def test_lathe_marks_circle_the_axis():
    points = cloud() + np.array([0.02, 0.02, 0])
    turn = np.stack([-points[:, 1], points[:, 0], 0 * points[:, 0]], 1)
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    paint, step = finish("brushed", SIZE).paint, SIZE / 400
    around = np.abs(paint(points + step * turn) - paint(points)).mean()
    upward = np.abs(paint(points + np.array([0, 0, step])) - paint(points)).mean()
    assert upward > 3 * around


def test_glaze_pools_towards_the_foot():
    paint = finish("glaze", SIZE, "f0f0f0", "202080").paint
    points = cloud()
    low, high = (paint(points * [1, 1, 0] + [0, 0, z * SIZE]).mean(0) for z in (0.02, 0.9))
    np.testing.assert_allclose(low, rgb("202080"), atol=0.08)
    np.testing.assert_allclose(high, rgb("f0f0f0"), atol=0.06)


def test_print_has_two_inks_in_three_patterns():
    points = cloud(20000)
    shares = []
    for seed in range(len(PATTERNS)):
        colour = finish("print", SIZE, "ffffff", "000000", seed).paint(points).mean(1)
        assert np.mean((colour < 0.1) | (colour > 0.85)) > 0.9, PATTERNS[seed]
        shares.append(np.mean(colour < 0.5))
    assert all(0.08 < share < 0.6 for share in shares)


def test_wood_of_the_die_keeps_its_colours_when_they_are_named():
    points = cloud()
    axis = np.array([0.93, 0.30, 0.21]) / np.linalg.norm([0.93, 0.30, 0.21])
    named = wood(points, SIZE, 6, rgb("e2b97f"), rgb("a8683a"), axis)
    np.testing.assert_allclose(named, wood(points, SIZE, 6), atol=0.03)  # but for the colour of the pores


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "velvet"}, "unknown finish 'velvet'.*glaze, wood, brushed, cast, plastic, print, glass"),
        ({"name": ["glaze"]}, "unknown finish"),
        ({"color": "blue"}, "glaze: color='blue'.*six hexadecimal digits"),
        ({"color": 123456}, "color=123456.*in quotes"),
        ({"accent": "#aabbcc"}, "accent='#aabbcc'.*six hexadecimal digits"),
        ({"accent": "12345 "}, "accent='12345 '.*six hexadecimal digits"),
        ({"size": 0.0}, r"size=0\.0.*positive"),
        ({"size": float("nan")}, "size=nan.*finite"),
        ({"size": "big"}, "size='big'.*number"),
        ({"seed": -1}, "seed=-1.*whole number"),
        ({"seed": 1.5}, r"seed=1\.5.*whole number"),
        ({"seed": True}, "seed=True.*whole number"),
        ({"axis": (0, 0, 0)}, r"axis=\(0, 0, 0\).*not all zero"),
        ({"axis": (1, 0)}, r"axis=\(1, 0\).*three numbers"),
    ],
)
def test_malformed_finishes_are_refused(arguments, words):
    refused(words, finish, **{"name": "glaze", "size": SIZE, **arguments})
