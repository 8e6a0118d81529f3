from dataclasses import replace

import numpy as np
import pytest
import torch

from objectfolder.touch import inverse as inverse_module
from objectfolder.touch.ball import BallModel
from objectfolder.touch.inverse import PhotometricInverse, integrated
from objectfolder.touch.profiles import load_profile

SIZE = (20, 15)
DIGIT = replace(load_profile("digit"), height=40, width=30)


@pytest.fixture(scope="module")
def inverse():
    return PhotometricInverse.fitted(DIGIT, BallModel(DIGIT, 0.01).optics.background.numpy(), SIZE)


def test_shapes_follow_from_images(inverse):
    """Of balls that the inverse was not fitted to."""
    rng = np.random.default_rng(5)
    found, true = [], []
    for radius in (0.002, 0.004, 0.008, 0.02):
        ball = BallModel(DIGIT, radius)
        moved = ball.displacement(np.array([*rng.uniform((15, 10), (25, 20)), rng.uniform(0.0008, 0.0018)]))
        found.append(inverse.displacement(ball.optics.render(moved).numpy()))
        true.append(1e3 * torch.nn.functional.adaptive_avg_pool2d(moved, SIZE))
    found, true = (torch.cat(of) for of in (found, true))
    found, true = (of - of[:, 9:11, 7:8].mean((1, 2), keepdim=True) for of in (found, true))
    error = (found - true).square().mean().sqrt() / (
        true - true.mean((1, 2), keepdim=True)
    ).square().mean().sqrt()
    assert error < 0.3
    assert 0 < inverse.error < 0.25


def test_a_sensor_that_touches_nothing_is_flat(inverse):
    background = BallModel(DIGIT, 0.01).optics.background.numpy()[None]
    assert not inverse.displacement(background).any()


def test_a_surface_follows_from_its_slopes_up_to_its_mean():
    """Of quadratic surfaces the mean slope of two pixels is the step between them."""
    down, across = torch.meshgrid(torch.arange(9.0), torch.arange(7.0), indexing="ij")
    surface = torch.stack([across**2 - 3 * across * down, down**2 / 2 + across - 2])
    slopes = torch.stack(
        [
            torch.stack([2 * across - 3 * down, torch.ones_like(across)]),
            torch.stack([-3 * across, down]),
        ]
    )
    expected = surface - surface.mean((1, 2), keepdim=True)
    torch.testing.assert_close(integrated(slopes), expected, atol=2e-4, rtol=1e-5)


def test_an_inverse_is_fitted_once_for_a_sensor_and_size(inverse, monkeypatch):
    monkeypatch.setattr(inverse_module, "BallModel", None)
    again = PhotometricInverse.fitted(DIGIT, np.zeros((40, 30, 3), np.uint8), SIZE)
    assert torch.equal(again.coefficients, inverse.coefficients)
    assert not again.background.any()
