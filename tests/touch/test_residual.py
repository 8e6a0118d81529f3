from dataclasses import replace

import numpy as np
import pytest
import torch

from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import RESIDUAL_TERMS, SensorProfile
from objectfolder.touch.residual import places, residual_levels, residual_terms


def ramp(profile, slope):
    """A gel that rises to the right at a constant angle, its tangent given, around the centre."""
    width = profile.pixel_pitch * np.arange(profile.width)
    moved = np.zeros((1, profile.height, profile.width), np.float32)
    moved[0, 20:-20, 20:-20] = 1e-3 + slope * width[20:-20]
    return torch.from_numpy(moved)


def test_there_are_as_many_terms_as_coefficients_and_none_at_rest():
    place = np.random.default_rng(0).uniform(-1, 1, (2, 5))
    terms = residual_terms(np.zeros((2, 5)), place)
    assert len(terms) == RESIDUAL_TERMS
    assert not np.any(terms)


def test_residual_adds_its_polynomial_to_the_lights(flat):
    """To green: 40 times the sine of the slope along y, and 30 times that times the place up."""
    coefficients = np.zeros((3, RESIDUAL_TERMS))
    coefficients[1, [0, 2]] = 40, 30
    fitted = replace(flat, residual=tuple(map(tuple, coefficients)), image_smoothing=0.0)
    moved = ramp(fitted, 0.2)
    added = Optics(fitted).change(moved)[0] - Optics(replace(fitted, residual=())).change(moved)[0]
    assert not added[[0, 2]].any()
    inner = np.s_[40:-40, 40:-40]
    _, up = places(fitted)
    sine = -0.2 / np.hypot(1, 0.2)  # y points left
    np.testing.assert_allclose(added[1].numpy()[inner], (sine * (40 + 30 * up))[inner], rtol=0.02, atol=0.02)
    assert not added[1][:15].any()  # untouched gel


def test_places_span_the_longer_side(digit):
    left, up = places(digit)
    assert up[0, 0] == pytest.approx(1 - 1 / digit.height)
    assert left[0, 0] == pytest.approx((1 - 1 / digit.width) * digit.width / digit.height)


def test_residual_is_cubic_in_the_tilt():
    place = np.zeros((2, 1))
    one, two, three = (
        residual_levels(np.full((2, 1), 0.1 * k), place, ((1.0,) * RESIDUAL_TERMS,) * 3)[0, 0]
        for k in (1, 2, 3)
    )
    # Third difference of c1 t + c2 t² + c3 t³ at 0, with 4 terms of third degree.
    assert three - 3 * two + 3 * one == pytest.approx(6 * 4 * 0.1**3, rel=1e-4)


def test_profile_keeps_its_residual_and_leaves_out_an_empty_one(digit):
    assert "residual" not in digit.to_dict()
    fitted = replace(digit, residual=((0.5,) * RESIDUAL_TERMS,) * 3)
    assert SensorProfile.from_dict(fitted.to_dict()) == fitted
    assert SensorProfile.from_dict(digit.to_dict()) == digit
