"""Contact microphones: vibration at a point of the surface."""

import numpy as np
import pytest
from refusals import refused

RATE = 96000


@pytest.fixture
def spots(brick):
    return brick.sample_surface(6, seed=5)


def unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def test_strike_and_pickup_can_change_places(brick, spots):
    """Reciprocity: a strike at A along a does at B along b what one at B along b does at A along a."""
    a, b = unit(np.random.default_rng(0).normal(size=(2, 3, 3)).reshape(6, 3)).reshape(2, 3, 3)
    played = {"sample_rate": RATE, "duration": 0.05, "response": "acceleration", "contact_time": 0.0}
    there = brick.impact(spots[:3], a, pickup=spots[3:], axis=b, **played)
    back = brick.impact(spots[3:], b, pickup=spots[:3], axis=a, **played)
    np.testing.assert_allclose(there, back, atol=1e-4 * np.abs(there).max())
    assert np.abs(there).max(1).min() > 0


def test_modes_move_the_surface_by_their_shapes(brick, spots):
    """After an ideal impulse: each mode rings with gain at the strike times shape at the pickup."""
    force = np.array([[0.2, -0.1, 1.0]])
    heard = brick.impact(
        spots[:1], force, RATE, 0.05, "velocity", contact_time=0.0, pickup=spots[1:2], axis=[[0, 0, 3.0]]
    )
    tuning = brick.tuning()
    s = -tuning.damping.numpy() + 1j * tuning.damped_frequency.numpy()
    struck, seen = brick.mode_shapes(spots[:2])
    weight = (force @ struck)[0] * seen[2]
    time = np.arange(heard.shape[1])[:, None] / RATE
    exact = (weight * s / s.imag * np.exp(s * time)).imag.sum(1)
    np.testing.assert_allclose(heard[0], exact, atol=1e-3 * np.abs(exact).max())


def test_without_an_axis_it_measures_along_the_normal(brick):
    top = np.array([[0.01, 0.005, brick.bounds[1, 2]]])
    played = {"duration": 0.05, "response": "acceleration", "pickup": top}
    by_default = brick.impact(top, [[0, 0, -0.02]], **played)
    np.testing.assert_allclose(
        by_default, brick.impact(top, [[0, 0, -0.02]], axis=[[0, 0, 1]], **played), rtol=1e-3
    )
    one = brick.impact(np.repeat(top, 3, 0), [[0, 0, -0.02]], axis=[[0, 0, 1]], **played)
    assert one.shape == (3, 800)
    np.testing.assert_array_equal(one[0], one[2])


def test_twice_the_size_moves_an_eighth_as_much_and_half_as_fast(brick, spots):
    """Mode shapes fall with the square root of the mass, frequencies with the size."""
    played = {"response": "velocity", "contact_time": 0.0, "axis": [[0, 0, 1]]}
    forces = [[0, 0, 1.0]]
    own = brick.impact(spots[:1], forces, RATE, 0.01, pickup=spots[1:2], **played)
    large = brick.impact(
        2 * spots[:1], forces, RATE / 2, 0.02, pickup=2 * spots[1:2], scale=2 * brick.scale, **played
    )
    early = slice(0, 6)  # while the damping does not matter
    np.testing.assert_allclose(8 * large[0, early], own[0, early], atol=0.02 * np.abs(own).max())


def test_what_makes_no_sense_is_refused(brick, spectrograms, spots):
    strike = spots[:1], [[0, 0, 1.0]]
    refused("axis is the direction of a pickup", brick.impact, *strike, axis=[[0, 0, 1]])
    refused("axis: a row is zero", brick.impact, *strike, pickup=spots[1:2], axis=[[0, 0, 0]])
    refused(
        "listener and pickup are both given", brick.impact, *strike, pickup=spots[1:2], listener=[[0, 0, 1]]
    )
    refused("pickup", brick.impact, *strike, pickup=[[0, 0]])
    refused("1 of 1 points are off the surface", brick.impact, *strike, pickup=[[0, 0, 9.0]])
    refused("stores spectrograms", spectrograms.impact, *strike, pickup=spots[1:2])
