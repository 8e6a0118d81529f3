from functools import cache

import numpy as np
import pytest
from assembled import crossings
from procedural_cases import APPLIANCES, SAMPLE, SMALL

from objectfolder.mesh.raycast import RayCaster
from objectfolder.shapes import GENERATORS
from objectfolder.shapes.electronics import superellipse
from objectfolder.shapes.extrusion import area
from objectfolder.shapes.fittings import bars, torus

NAMES = [name if name in SAMPLE else pytest.param(name, marks=pytest.mark.slow) for name in APPLIANCES]


@cache
def made(name):
    generator, parameters = APPLIANCES[name]
    return GENERATORS[generator](**parameters, span=1.0, texture_size=SMALL)


@cache
def caster(name):
    mesh = made(name)
    return RayCaster(mesh.vertices, mesh.faces)


def first(name, origins, direction):
    """Distances (N,) to the surface along one direction or several."""
    origins = np.asarray(origins, float)
    return caster(name).first_hit(origins, np.broadcast_to(np.asarray(direction, float), origins.shape))[0]


@pytest.mark.parametrize("name", NAMES)
def test_the_size_is_that_of_the_longest_side(name):
    assert np.ptp(made(name).bounds, axis=0).max() == pytest.approx(1, rel=1e-3)


def test_toast_falls_through_both_slots_to_the_floor_of_a_hollow_body():
    mesh = made("toaster")
    for y in (0.105, -0.105):
        down = crossings(mesh, (0.0, y, 1.0), (0, 0, -1))
        np.testing.assert_allclose(1 - down, [0.09, 0.03], atol=1e-3)  # floor and underside of the base
    through = crossings(mesh, (0.0, 1.0, 0.36), (0, -1, 0))
    np.testing.assert_allclose(np.diff(through)[[0, 2]], 0.04, atol=1e-3)


def test_screen_bulges_out_of_its_recess():
    front = -0.19
    rays = [(-0.125 + x, -1.0, 0.3711) for x in (0.0, 0.15, 0.27, 0.32)]
    depth = first("television", rays, (0, 1, 0)) - 1
    assert depth[3] == pytest.approx(front - 0.015, abs=1e-6)  # the bezel
    assert depth[0] == pytest.approx(front + 0.05 - 0.015 - 0.045, abs=1e-3)
    assert depth[0] < depth[1] < depth[2] - 0.01
    assert np.diff(crossings(made("television"), (0.3, 0.1, 1.0), (0, 0, -1)))[0] == pytest.approx(
        0.04, abs=1e-6
    )


@pytest.mark.slow
def test_grille_of_the_radio_opens_into_its_case():
    mesh, middle = made("radio"), 0.295
    bar, slot = (crossings(mesh, (-0.22, -1.0, z), (0, 1, 0)) - 1 for z in (middle, middle + 0.031))
    # A bar ends in the front wall's inner plane; the slot opens on the rear wall, with its cover.
    np.testing.assert_allclose(bar, [-0.148, -0.105, 0.105, 0.165], atol=1e-6)
    np.testing.assert_allclose(slot, [0.105, 0.165], atol=1e-6)


def test_clock_has_twelve_raised_marks_and_hands_above_them():
    face = -0.11 + 0.035

    def height(degrees, r):
        at = np.radians(degrees)
        rays = np.stack([r * np.sin(at), np.full_like(at, -1.0), 0.44 + r * np.cos(at)], 1)
        return face - (first("clock", rays, (0, 1, 0)) - 1)

    hours = np.setdiff1d(np.arange(12), [2, 10])  # the others are below the hands
    raised = np.where(hours % 3, 0.018, 0.022)
    np.testing.assert_allclose(height(30.0 * hours + 0.5, 0.203), raised, atol=1e-6)
    np.testing.assert_allclose(height(30.0 * np.arange(12) + 15, 0.203), 0, atol=1e-6)
    hands = height(np.array([60.0, -55.0, 30.0]), np.array([0.10, 0.08, 0.005]))
    np.testing.assert_allclose(hands, [0.034, 0.022, 0.046], atol=1e-6)  # minute, hour, pin


def test_lantern_has_a_ribbed_lamp_behind_its_posts():
    def radius(degrees):
        at = np.radians(degrees)
        out = np.stack([np.cos(at), np.sin(at), 0 * at], 1)
        return 1 - first("lantern", out + np.array([0, 0, 0.435]), -out)

    np.testing.assert_allclose(radius(45.0 + 90 * np.arange(4)), 0.222 + 1.3 * 0.027 / 2, rtol=0.01)
    turn = np.arange(14) * 360 / 14
    free = np.abs((turn + 45) % 90 - 45) < 30  # no post in front of a rib or the groove beside it
    assert free.sum() >= 6
    assert radius(turn[free]).min() > radius(turn[free] + 180 / 14).max() + 0.006


@pytest.mark.slow
def test_iron_has_blind_holes_in_its_flat_sole():
    depth = first("clothes iron", [(0.4, 1e-4, -1.0), (0.45, 1e-4, -1.0)], (0, 0, 1)) - 1
    np.testing.assert_allclose(depth, [0.025, 0.0], atol=1e-6)


@pytest.mark.slow
def test_air_flows_through_the_dryer():
    mesh, axis = made("hair dryer"), 0.805
    back = crossings(mesh, (1.0, 1e-3, axis), (-1, 0, 0))
    np.testing.assert_allclose(1 - back[:2], [-0.225, -0.27], atol=1e-6)  # the rear wall, between two slots
    assert len(crossings(mesh, (1.0, 1e-3, axis + 0.025), (-1, 0, 0))) == 0
    nozzle = crossings(mesh, (0.36, 0.0, axis), (0, 1, 0))
    np.testing.assert_allclose(nozzle, [0.08, 0.115], atol=2e-3)


def test_superellipse_has_the_area_of_an_ellipse_and_tends_to_a_rectangle():
    assert area(superellipse(0.3, 0.2, 2.0, 400)) == pytest.approx(np.pi * 0.06, rel=1e-3)
    assert area(superellipse(0.3, 0.2, 60.0, 400)) == pytest.approx(0.24, rel=0.01)


def test_bars_and_rings_have_their_volumes():
    solid = bars([0.3, 0.2], 0.02, 0.05, 0.1)
    circle = 16 / 2 * np.sin(2 * np.pi / 16) * 0.01**2  # of sixteen sides
    assert solid.volume() == pytest.approx(0.1 * (0.02 * (0.28 + 0.18) + 2 * circle), rel=1e-6)
    assert torus(0.1, 0.02, 48).volume() == pytest.approx(2 * np.pi**2 * 0.1 * 0.01**2, rel=0.01)
