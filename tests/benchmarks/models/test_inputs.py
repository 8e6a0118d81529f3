import numpy as np
import pytest
import torch
from made_up import observations
from refusals import refused
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.models import inputs
from objectfolder.benchmarks.models.inputs import DEVIATION, MEAN, encoder_inputs
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.sound.spectrogram import SAMPLE_RATE

SIZES = InputSizes(image=56, spectrogram=(64, 50), touch=(64, 48))


def test_views_are_cropped_at_the_centre_and_normalised(rng):
    raw = rng.integers(256, size=(2, 64, 60, 3), dtype=np.uint8)
    x = encoder_inputs("vision", raw, SIZES)
    assert x.dtype == torch.float32
    expected = (raw[:, 4:60, 2:58] / 255 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    np.testing.assert_allclose(x, expected.transpose(0, 3, 1, 2), atol=1e-5)


def test_random_crops_reach_every_place_and_follow_from_the_generator():
    row, column = np.mgrid[:64, :64].astype(np.uint8)
    raw = np.tile(np.stack([row, column, row], -1), (2000, 1, 1, 1))
    crops = inputs._crops(raw, 56, np.random.default_rng(0))
    corners = crops[:, :2, 0, 0].numpy()
    assert {tuple(c) for c in corners} == {(r, c) for r in range(9) for c in range(9)}
    for crop, (top, left) in zip(crops[:20].numpy(), corners[:20]):
        np.testing.assert_array_equal(crop[:2], np.mgrid[top : top + 56, left : left + 56])
    assert torch.equal(crops, inputs._crops(raw, 56, np.random.default_rng(0)))


def test_spectrogram_is_relative_to_the_sounds_own_maximum(rng):
    seconds = np.arange(2 * SAMPLE_RATE) / SAMPLE_RATE
    tone = (np.sin(2 * np.pi * 1000 * seconds) * np.exp(-4 * seconds)).astype(np.float32)
    raw = np.stack([tone, 1e-6 * tone, 1e3 * tone, 0 * tone]).astype(np.float32)
    full = encoder_inputs("audio", raw, InputSizes(56, (257, 201), (64, 48)))
    assert full.shape == (4, 1, 257, 201)
    torch.testing.assert_close(full[1], full[0], rtol=0, atol=1e-3)
    torch.testing.assert_close(full[2], full[0], rtol=0, atol=1e-3)
    assert not full[3].any()
    assert full.min() >= 0
    assert full[0].max() == 1
    assert full[0, 0].argmax() // 201 == 32  # 1000 Hz of 31.25 Hz per row
    # It decays by 20 log10(e) * 4 = 34.74 dB per second, 100 columns apart.
    assert (full[0, 0, 32, 20] - full[0, 0, 32, 120]).item() == pytest.approx(34.74 / 80, abs=1e-3)
    pooled = encoder_inputs("audio", raw, SIZES)
    torch.testing.assert_close(pooled, nn.functional.adaptive_avg_pool2d(full, (64, 50)))


def test_the_ground_of_touches_is_the_sensors_picture_without_an_object(rng):
    """Each of 41 touches covers a third of the picture, with slopes of either sign."""
    background = torch.from_numpy(rng.standard_normal((3, 8, 9))).float()
    touches = background.repeat(41, 1, 1, 1)
    for i, touch in enumerate(touches):
        touch[:, :, 3 * (i % 3) : 3 * (i % 3) + 3] += 2.0 * (-1) ** (i // 3)
    ground = inputs.Ground.of(touches)
    torch.testing.assert_close(ground.median, background)
    assert ground.deviation.item() == pytest.approx((4 / 3) ** 0.5, rel=1e-5)
    shown = ground.subtracted(touches)
    assert shown[0, :, :, 3:].abs().max() < 1e-5
    torch.testing.assert_close(shown[0, :, :, :3], torch.full((3, 8, 3), 3**0.5))
    # Touches that are all alike stay finite.
    assert not inputs.Ground.of(touches[:1].repeat(3, 1, 1, 1)).subtracted(touches[:1]).any()


def test_shifted_pictures_move_by_whole_pixels_and_repeat_their_border():
    row, column = torch.meshgrid(torch.arange(6.0), torch.arange(5.0), indexing="ij")
    x = torch.stack([row, column]).repeat(300, 1, 1, 1)
    moved = inputs.shift_each(x, 2, np.random.default_rng(0))
    steps = {tuple(int(n) for n in picture[:, 2, 2]) for picture in moved}
    assert steps == {(2 + dy, 2 + dx) for dy in range(-2, 3) for dx in range(-2, 3)}
    for picture in moved[:20]:
        dy, dx = picture[:, 2, 2] - 2
        torch.testing.assert_close(picture[0], (row + dy).clamp(0, 5))
        torch.testing.assert_close(picture[1], (column + dx).clamp(0, 4))
    assert torch.equal(moved, inputs.shift_each(x, 2, np.random.default_rng(0)))


def test_half_of_the_pictures_are_mirrored_left_to_right():
    x = torch.arange(24.0).reshape(1, 2, 3, 4).repeat(400, 1, 1, 1)
    seen = inputs.flip_some(x, np.random.default_rng(0))
    mirrored = (seen != x).flatten(1).any(1)
    assert 160 < mirrored.sum() < 240
    assert torch.equal(seen[mirrored], x[mirrored][..., [3, 2, 1, 0]])
    assert torch.equal(seen, inputs.flip_some(x, np.random.default_rng(0)))


@pytest.mark.parametrize("modality", ["vision", "audio", "touch"])
def test_rows_do_not_depend_on_each_other(rng, modality):
    raw = observations(rng, 3)[modality]
    together = encoder_inputs(modality, raw, SIZES)
    alone = torch.cat([encoder_inputs(modality, raw[i : i + 1], SIZES) for i in range(3)])
    torch.testing.assert_close(alone, together, rtol=0, atol=1e-6)


def test_observations_smaller_than_the_sizes_are_refused(rng):
    message = "views of 48 x 64 pixels are smaller than the encoder's image 56"
    refused(message, encoder_inputs, "vision", np.zeros((1, 48, 64, 3), np.uint8), SIZES)
    with pytest.raises(ObjectFolderError, match="touch of 60 x 48 is smaller than the encoder's 64 x 48"):
        encoder_inputs("touch", np.zeros((1, 60, 48, 3), np.uint8), SIZES)


@pytest.mark.parametrize("size", [(80, 60), (160, 120), (10, 10), (64, 48)])
def test_touches_are_averaged_pixels_however_they_divide(size):
    raw = np.random.default_rng(0).integers(256, size=(2, 160, 120, 3), dtype=np.uint8)
    raw[0] = 255  # the largest sum
    pixels = torch.from_numpy(raw).movedim(-1, 1).double() / 255
    mean, deviation = (torch.tensor(x, dtype=torch.double)[:, None, None] for x in (MEAN, DEVIATION))
    expected = (nn.functional.adaptive_avg_pool2d(pixels, size) - mean) / deviation
    found = encoder_inputs("touch", raw, InputSizes(56, (64, 50), size))
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-5)


def test_touches_that_divide_are_summed_as_integers(monkeypatch):
    monkeypatch.setattr(inputs, "_pooled", lambda *_: pytest.fail("averaged floats"))
    encoder_inputs("touch", np.zeros((1, 16, 12, 3), np.uint8), InputSizes(8, (8, 8), (8, 6)))
