import math

import numpy as np
import pytest
import torch

from objectfolder.benchmarks.models.resnet import ResNet18
from objectfolder.benchmarks.models.touch_frame import (
    DEEPEST,
    DEPTH,
    Mirrored,
    gel_inputs,
    levelled,
    mirror_each,
    mirrored,
    upright,
)


def _hill(angle, size=(40, 30), at=(0.0, 0.0)):
    """A hill of 1 mm, three times as long as wide, its length at an angle to the columns."""
    down, across = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in size), indexing="ij")
    down, across = down - at[0], across - at[1]
    along = np.cos(angle) * across + np.sin(angle) * down
    beside = np.cos(angle) * down - np.sin(angle) * across
    return torch.from_numpy(np.exp(-((along / 9) ** 2) - (beside / 3) ** 2)).float()[None]


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
    torch.testing.assert_close(mirrored(gel_inputs(hill), across, down), gel_inputs(flipped))


def test_training_sees_all_four_mirror_images_and_scores_do_not_depend_on_them():
    inputs = gel_inputs(_hill(0.3, at=(4.0, -3.0)))
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
