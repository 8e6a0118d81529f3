import manifold3d
import numpy as np
import pytest
from assembled import crossings, welded
from procedural_cases import CLUB, LADLE, MALLET, SMALL

from objectfolder.shapes.airplane import TIP, airplane
from objectfolder.shapes.block import block
from objectfolder.shapes.hammer import hammer
from objectfolder.shapes.spoon import spoon
from objectfolder.shapes.toy import ramp, toy
from objectfolder.shapes.wrench import JAW_ANGLE, RECESS, wrench


def test_wings_are_lenses_as_thick_as_asked():
    wing, chord, span = 0.002, 0.05, 0.24
    mesh = airplane(wing=wing, chord=chord, span=span, sweep=0.0, texture_size=SMALL)
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0)[:2], [0.22, span], rtol=1e-3)
    x, y = 0.08 * 0.22, 0.25 * span
    # A superellipse of exponent 2, half way to the tip: 3/4 of the thickness, (1 + TIP) / 2 of the chord.
    for share in (0.0, 0.6):
        at = (x + share * chord / 2 * (1 + TIP) / 2, y, 1.0)
        through = np.diff(crossings(mesh, at, (0, 0, -1)))
        assert through == pytest.approx([0.75 * wing * np.sqrt(1 - share**2)], rel=0.02)


@pytest.mark.parametrize("ends", ["open", "combination"])
def test_jaws_fit_the_nut(ends):
    length, size = 0.18, 0.015
    mesh = wrench(length, size, 0.006, ends, texture_size=SMALL)
    turn = np.pi + JAW_ANGLE
    out, across = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])
    origin = np.array([-length / 2, 0, 0.0039]) + 0.4 * size * out
    for sign in (-1, 1):
        assert crossings(mesh, tuple(origin), tuple(sign * across))[0] == pytest.approx(size / 2, abs=1e-7)


def test_ring_takes_a_hexagon_of_its_size_and_none_much_larger():
    length, size = 0.18, 0.015
    mesh = wrench(length, size, 0.006, texture_size=SMALL)
    angles = np.linspace(0, np.pi / 6, 7)
    first = [crossings(mesh, (length / 2, 0, 0.0039), (np.cos(a), np.sin(a), 0))[0] for a in angles]
    # Between the hexagon's flat and its corner; two of them cover each other's flats in part.
    assert min(first) == pytest.approx(size / 2 / np.cos(np.pi / 12), rel=1e-6)
    assert max(first) == pytest.approx(size / np.sqrt(3), rel=1e-6)


def test_bar_of_a_wrench_is_as_thick_as_asked_and_thinner_in_its_panels():
    thickness = 0.006
    mesh = wrench(thickness=thickness, texture_size=SMALL)
    middle, edge = (crossings(mesh, (0.001, y, 1.0), (0, 0, -1)) for y in (0.0003, 0.0045))
    assert np.diff(middle) == pytest.approx([(1 - 2 * RECESS) * thickness], abs=1e-8)
    assert 0.9 * thickness < np.diff(edge)[0] <= thickness + 1e-8


@pytest.mark.parametrize("parameters", [CLUB, MALLET, {}])
def test_hammer_has_the_size_asked_for(parameters):
    mesh = hammer(**parameters, texture_size=SMALL)
    size = np.ptp(mesh.bounds, axis=0)
    head_length, diameter = parameters.get("head_length", 0.13), parameters.get("head_diameter", 0.03)
    assert mesh.bounds[1, 0] == pytest.approx(parameters.get("length", 0.32), abs=1e-9)
    assert size[1] == pytest.approx(head_length, rel=0.02)
    assert diameter * 0.999 <= size[2] <= 1.15 * diameter


def test_mallet_has_the_volume_of_its_block_and_more():
    length, d = 0.13, 0.075
    volume = welded(hammer(**MALLET, texture_size=SMALL)).volume
    block_volume = np.pi * d**2 / 4 * length
    handle = 0.28 * 0.03 * 0.74 * 0.03
    assert 0.97 * block_volume < volume < block_volume + handle


@pytest.mark.parametrize("parameters", [{"wall": 0.0018}, {"wall": 0.003}, LADLE])
def test_bowl_of_a_spoon_is_as_thick_as_asked(parameters):
    mesh = spoon(**parameters, texture_size=SMALL)
    down = crossings(mesh, (1e-5, 2e-5, 1.0), (0, 0, -1))
    np.testing.assert_allclose(down, [1 - parameters["wall"], 1], atol=2e-5)


def test_spoon_is_an_open_bowl_on_a_slim_handle():
    a, b, depth, wall = 0.030, 0.020, 0.011, 0.0018
    mesh = spoon(point=0, texture_size=SMALL)
    bowl = 2 / 3 * np.pi * (a * b * depth - (a - wall) * (b - wall) * (depth - wall))
    volume = welded(mesh).volume
    assert bowl < volume < bowl + 0.14 * 0.014 * 0.004
    assert np.ptp(mesh.bounds, axis=0)[0] == pytest.approx(0.19, abs=1e-3)
    assert mesh.bounds[0, 0] == pytest.approx(-a, abs=1e-9)


def polygon_area(sides: int, diameter: float) -> float:
    return sides / 2 * np.sin(2 * np.pi / sides) * diameter**2 / 4


@pytest.mark.parametrize("depth", [None, 0.03])
@pytest.mark.parametrize(("hole", "sides"), [("round", 32), ("square", 4), ("hexagon", 6)])
def test_block_lacks_the_volume_of_its_holes(hole, sides, depth):
    l, w, h, d = 0.12, 0.10, 0.05, 0.02
    mesh = block(l, w, h, "holes", 2, 3, d, depth, hole, rounding=0, texture_size=SMALL)
    np.testing.assert_allclose(mesh.bounds, [[-l / 2, -w / 2, 0], [l / 2, w / 2, h]], atol=1e-9)
    surface = welded(mesh)
    assert surface.volume == pytest.approx(l * w * h - 6 * polygon_area(sides, d) * (depth or h), rel=1e-9)
    assert surface.euler_number == (2 if depth else 2 - 2 * 6)


def test_brick_has_its_studs_on_top():
    l, w, h, d = 0.064, 0.032, 0.0192, 0.0098
    mesh = block(l, w, h, "studs", 2, 4, d, 0.004, rounding=0, finish="plastic", texture_size=SMALL)
    assert welded(mesh).volume == pytest.approx(l * w * h + 8 * polygon_area(40, d) * 0.004, rel=1e-9)
    assert mesh.bounds[1, 2] == pytest.approx(h + 0.004, abs=1e-12)


@pytest.mark.parametrize(("kind", "wheels"), [("car", 4), ("truck", 6)])
def test_vehicle_stands_on_its_wheels(kind, wheels):
    mesh = toy(kind, 0.2, texture_size=SMALL)
    low = np.unique(np.round(mesh.vertices[mesh.vertices[:, 2] < 1e-4][:, :2], 4), axis=0)
    places = {(round(x / 0.03), y > 0) for x, y in low}
    assert len(places) == wheels


def test_duck_is_the_same_on_both_sides():
    surface = welded(toy("duck", texture_size=SMALL))
    assert surface.center_mass[1] == pytest.approx(0, abs=2e-4 * 0.16)
    assert surface.euler_number == 2
    faces = np.array(surface.faces, np.uint64)
    whole = manifold3d.Manifold(manifold3d.Mesh64(np.array(surface.vertices), faces))
    left, right = whole.split_by_plane((0, 1, 0), 0)
    assert left.volume() == pytest.approx(right.volume(), rel=1e-3)


@pytest.mark.parametrize("count", [3, 8])
def test_rings_shrink_upwards_to_the_ball(count):
    size = 0.2
    mesh = toy("rings", size, count=count, texture_size=SMALL)
    assert np.ptp(mesh.bounds, axis=0)[2] == pytest.approx(size, abs=1e-9)
    foot, ball = 0.09 * size, 0.11 * size
    pitch = (size - foot - 1.75 * ball) / count
    reach = [1 - crossings(mesh, (1.0, 1e-4, foot + pitch * (k + 0.5)), (-1, 0, 0))[0] for k in range(count)]
    assert np.all(np.diff(reach) < 0)


def test_ramp_goes_from_the_first_colour_to_the_last():
    assert ramp("000000", "ff8000", 3) == ["000000", "804000", "ff8000"]
    assert len(set(ramp(None, None, 7))) == 7
