import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from objectfolder.benchmarks.models import touch_frame
from objectfolder.benchmarks.models.resnet import ResNet18
from objectfolder.benchmarks.models.touch_frame import (
    DEEPEST,
    DEPTH,
    Mirrored,
    PhotometricInverse,
    integrated,
    levelled,
    mirror_each,
    mirrored,
    shape_inputs,
    upright,
)
from objectfolder.touch.ball import BallModel
from objectfolder.touch.profiles import load_profile

SIZE = (20, 15)
DIGIT = replace(load_profile("digit"), height=40, width=30)


def _hill(angle, size=(40, 30), at=(0.0, 0.0)):
    """A hill of 1 mm, three times as long as wide, its length at an angle to the columns."""
    down, across = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in size), indexing="ij")
    down, across = down - at[0], across - at[1]
    along = np.cos(angle) * across + np.sin(angle) * down
    beside = np.cos(angle) * down - np.sin(angle) * across
    return torch.from_numpy(np.exp(-((along / 9) ** 2) - (beside / 3) ** 2)).float()[None]


@pytest.fixture(scope="module")
def inverse():
    return PhotometricInverse.fitted(DIGIT, BallModel(DIGIT, 0.01).optics.background.numpy(), SIZE)


def test_shapes_follow_from_images(inverse):
    """Of balls that the inverse was not fitted to, as if all were pressed equally deep."""
    rng = np.random.default_rng(5)
    found, true = [], []
    for radius in (0.002, 0.004, 0.008, 0.02):
        ball = BallModel(DIGIT, radius)
        moved = ball.displacement(np.array([*rng.uniform((15, 10), (25, 20)), rng.uniform(0.0008, 0.0018)]))
        found.append(inverse.displacement(ball.optics.render(moved).numpy()))
        true.append(1e3 * torch.nn.functional.adaptive_avg_pool2d(moved, SIZE))
    found, true = levelled(torch.cat(found)), levelled(torch.cat(true))
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


def test_levelled_touches_do_not_depend_on_the_depth():
    hill = _hill(0.3)
    torch.testing.assert_close(levelled(hill + 5), levelled(hill), atol=1e-5, rtol=0)
    level = levelled(4 * torch.cat([hill, -hill]))
    assert level[:, 19:21, 14:16].mean((1, 2)).tolist() == pytest.approx([DEPTH] * 2, abs=0.1)
    assert (level.min(), level.max()) == (0, DEEPEST)


@pytest.mark.parametrize("angle", [-1.2, -0.4, 0.0, 0.5, 1.4])
def test_upright_touches_do_not_depend_on_the_angle(angle):
    expected = _hill(math.pi / 2)
    turned = upright(_hill(angle), 40 / 30)
    disc = np.hypot(*np.meshgrid(np.arange(40) - 19.5, np.arange(30) - 14.5, indexing="ij")) < 14
    assert (turned - expected)[0][disc].abs().max() < 0.06
    assert (_hill(angle) - expected)[0][disc].abs().max() > 0.15


def test_upright_touches_have_the_proportions_of_the_gel():
    """Images of 40 x 30 pixels that were averaged to 20 x 30: a pixel is twice as high as wide."""
    squeezed = _hill(0.7).reshape(1, 20, 2, 30).mean(2)
    expected = _hill(math.pi / 2).reshape(1, 20, 2, 30).mean(2)
    disc = np.hypot(*np.meshgrid(2 * np.arange(20) - 19, np.arange(30) - 14.5, indexing="ij")) < 14
    assert (upright(squeezed, 40 / 30) - expected)[0][disc].abs().max() < 0.1


@pytest.mark.parametrize(("across", "down"), [(True, False), (False, True), (True, True)])
def test_mirrored_inputs_are_those_of_the_mirrored_shape(across, down):
    hill = _hill(0.3, at=(4.0, -3.0))
    flipped = hill.flip([axis for axis, chosen in ((1, down), (2, across)) if chosen])
    torch.testing.assert_close(mirrored(shape_inputs(hill), across, down), shape_inputs(flipped))


def test_training_sees_all_four_mirror_images_and_scores_do_not_depend_on_them():
    inputs = shape_inputs(_hill(0.3, at=(4.0, -3.0)))
    four = [mirrored(inputs, across, down) for across in (False, True) for down in (False, True)]
    drawn = mirror_each(inputs.repeat(64, 1, 1, 1), np.random.default_rng(0))
    found = [[torch.equal(one, other[0]) for other in four] for one in drawn]
    assert np.sum(found, 1).tolist() == [1] * 64
    assert np.sum(found, 0).min() > 8
    torch.manual_seed(0)
    net = Mirrored(ResNet18(3, 1 / 16)).eval()
    assert net.features == 32
    with torch.no_grad():
        answers = [net(one) for one in four]
        for answer in answers[1:]:
            torch.testing.assert_close(answer, answers[0], rtol=1e-4, atol=1e-5)
        assert not torch.allclose(net.encoder(four[0]), net.encoder(four[3]), rtol=1e-2)
        net.train()
        assert torch.equal(net(inputs.repeat(2, 1, 1, 1))[0], net(inputs.repeat(2, 1, 1, 1))[1])


def test_an_inverse_is_fitted_once_for_a_sensor_and_size(inverse, monkeypatch):
    monkeypatch.setattr(touch_frame, "BallModel", None)
    again = PhotometricInverse.fitted(DIGIT, np.zeros((40, 30, 3), np.uint8), SIZE)
    assert torch.equal(again.coefficients, inverse.coefficients)
    assert not again.background.any()
