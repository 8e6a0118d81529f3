import dataclasses

import numpy as np
import pytest
import torch

from objectfolder.base.arrays import read_safetensors, write_safetensors
from objectfolder.base.metrics import SpectrogramErrors
from objectfolder.nets.fit import Session
from objectfolder.nets.positional import PointwiseNetwork
from objectfolder.sound.gains_training import ModeSamples
from objectfolder.sound.net_settings import SpectrogramConfig
from objectfolder.sound.spectrogram import SHAPE, invert_spectrogram, phases, spectrogram
from objectfolder.sound.spectrogram_net import SpectrogramNet
from objectfolder.sound.spectrogram_training import train_spectrogram
from objectfolder.sound.synthesis import sinusoid_bank

SHAPE_OF_NET = {"width": 32, "depth": 3, "point_octaves": 1, "bin_octaves": 7}
CONFIG = SpectrogramConfig(**SHAPE_OF_NET, steps=400, batch=1024, learning_rate=1e-2, loud=0.5)
FREQUENCY = 2 * np.pi * np.array([400.0, 1500])
DAMPING = np.array([3.0, 4])


@pytest.fixture(scope="module")
def bar():
    """A bar's first two bending shapes, along z only, and barely along the other axes."""
    x = np.random.default_rng(0).uniform(-0.5, 0.5, (600, 3))
    shapes = np.zeros((600, 3, 2))
    shapes[:, 2] = np.stack([np.cos(4.73 * x[:, 0]), np.sin(7.85 * x[:, 0])], 1)
    shapes[:, :2] = 0.2 * shapes[:, 2:]
    return x, shapes


def train(bar, config=CONFIG, frequency=FREQUENCY):
    samples = ModeSamples(*bar, frequency, DAMPING, np.arange(500), np.arange(500, 550))
    return train_spectrogram(samples, config, Session(torch.Generator().manual_seed(0)))


@pytest.fixture(scope="module")
def trained(bar):
    return train(bar)


@pytest.fixture(scope="module")
def truth(bar):
    bank = spectrogram(sinusoid_bank(torch.from_numpy(FREQUENCY), torch.from_numpy(DAMPING)))
    return torch.einsum("nam,mft->naft", torch.from_numpy(bar[1][500:]).to(bank.dtype), bank)


def error(image, truth):
    return float((image - truth).abs().square().sum() / truth.abs().square().sum())


def test_it_learns_what_held_out_points_sound_like(bar, trained, truth):
    image = trained[0].spectrograms(torch.from_numpy(bar[0][550:562]))
    assert image.shape == (12, 3, *SHAPE)
    held_out, mean = truth[50:62], truth.mean(0)
    assert error(image, held_out) < 0.25  # silence: 1
    assert error(image, held_out) < 0.5 * error(mean, held_out)
    errors = SpectrogramErrors()
    errors.add(image[:, 2], held_out[:, 2])
    scores = errors.scores()
    assert scores["psnr"] > scores["baseline_silence"] + 6
    losses = [point.val_loss for point in trained[1]]
    assert losses[-1] < 0.25 * losses[0]


def test_storing_keeps_the_answer(tmp_path, bar, trained):
    write_safetensors(tmp_path / "n.safetensors", *trained[0].to_tensors())
    back = SpectrogramNet.from_tensors(*read_safetensors(tmp_path / "n.safetensors"))
    points = torch.from_numpy(bar[0][:2])
    assert 0 < error(back.spectrograms(points), trained[0].spectrograms(points)) < 1e-3
    assert back.damped_frequency.tolist() == FREQUENCY.tolist()


def test_the_unit_of_an_axis_is_the_root_mean_square_of_its_training_sounds(bar):
    """Of two modes of nearly one frequency, which share their bins, too."""
    frequency = 2 * np.pi * np.array([400.0, 400.5])
    net, _ = train(bar, dataclasses.replace(CONFIG, steps=1), frequency)
    spectra = spectrogram(sinusoid_bank(torch.from_numpy(frequency), torch.from_numpy(DAMPING)))
    sounds = torch.einsum("nam,mft->naft", torch.from_numpy(bar[1][:500]).to(spectra.dtype), spectra)
    rms = (sounds.abs().square().mean((0, 2, 3)) / 2).sqrt().double()  # of real and imaginary parts
    torch.testing.assert_close(net.range, torch.stack([0 * rms, rms], 1), rtol=1e-4, atol=0)


def test_over_the_phases_of_their_bins_lasting_tones_stand_still():
    hertz = torch.tensor([1950.0, 411.0])
    tones = torch.cos(2 * torch.pi * hertz[:, None] * torch.arange(32000) / 16000 + 0.4)
    for tone, spectra in zip(hertz, spectrogram(tones)):
        peak = int(spectra.abs().sum(1).argmax())
        inside = spectra[:, 5:-5] / phases(tone.expand(SHAPE[0]))[:, 5:-5]
        near = inside[peak - 1 : peak + 2]
        assert (near / near.abs() - torch.polar(torch.ones(()), torch.tensor(0.4))).abs().max() < 0.01


def test_the_answer_turns_back_what_is_stored_over_phases(trained):
    net, points = trained[0], torch.zeros(1, 3)
    tensors, config = net.to_tensors()
    older = {name: values for name, values in tensors.items() if name != "turn"}
    still, whole = (SpectrogramNet.from_tensors(t, config).spectrograms(points) for t in (older, tensors))
    assert torch.equal(whole, still * phases(net.turn))
    hertz = torch.tensor(FREQUENCY / (2 * np.pi))
    assert torch.isin(net.turn, hertz).all()
    for frequency in hertz:
        assert net.turn[round(float(frequency) / 16000 * 512)] == frequency


def test_of_the_papers_target_each_axis_has_its_own_range(bar):
    """The outputs 0 and 1 are the least and the largest values along it, about a fifth along x and y."""
    net, _ = train(bar, dataclasses.replace(CONFIG, target="paper", steps=1))
    assert net.turn is None
    low, high = net.range.unbind(1)
    for axis in (0, 1):
        assert float((high - low)[axis] / (high - low)[2]) == pytest.approx(0.2, rel=1e-5)
    values = torch.stack([low, high], 1)[None].expand(1, 3, 2)
    torch.testing.assert_close(net.scaled(values)[0], torch.tensor([[0.0, 1]] * 3).double())


def test_files_with_one_range_for_all_axes_answer_as_before(bar, trained):
    tensors, config = trained[0].to_tensors()
    one = SpectrogramNet.from_tensors({**tensors, "range": np.array([-1.0, 3.0])}, config)
    each = SpectrogramNet.from_tensors({**tensors, "range": np.array([[-1.0, 3.0]] * 3)}, config)
    points = torch.from_numpy(bar[0][:1])
    assert torch.equal(one.spectrograms(points), each.spectrograms(points))


def test_rows_do_not_depend_on_their_batch(bar, trained):
    points = torch.from_numpy(bar[0][:3])
    whole = trained[0].spectrograms(points)
    assert torch.equal(trained[0].spectrograms(points[1:2])[0], whole[1])
    assert trained[0].spectrograms(points[:0]).shape == (0, 3, *SHAPE)


def test_an_object_that_the_sample_rate_cannot_carry_is_silent(bar):
    net, curve = train(bar, frequency=2 * np.pi * np.array([9000.0, 12000]))
    assert curve == []
    assert not net.spectrograms(torch.zeros(1, 3)).abs().any()


def test_an_object_without_modes_is_silent(tmp_path):
    still = np.zeros((8, 3)), np.zeros((8, 3, 0)), np.zeros(0), np.zeros(0)
    rows = np.arange(6), np.arange(6, 8)
    net, curve = train_spectrogram(ModeSamples(*still, *rows), CONFIG, Session())
    assert curve == []
    write_safetensors(tmp_path / "n.safetensors", *net.to_tensors())
    back = SpectrogramNet.from_tensors(*read_safetensors(tmp_path / "n.safetensors"))
    assert back.spectrograms(torch.zeros(2, 3)).abs().max() == 0


def test_the_papers_branch():
    """Eight layers of 256 channels; five inputs with ten octaves; the input joins again after the fifth."""
    branch = PointwiseNetwork(256, 8, 10, 10, outputs=2)
    sizes = [tuple(layer.weight.shape) for layer in (*branch.hidden, branch.output)]
    assert sizes == [(256, 105), *[(256, 256)] * 4, (256, 361), *[(256, 256)] * 2, (2, 256)]
    assert branch(torch.zeros(7, 5)).shape == (7, 2)


def test_sounds_of_spectrograms_are_the_sounds():
    sounds = torch.randn(2, 32000, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(invert_spectrogram(spectrogram(sounds)), sounds, atol=1e-4, rtol=0)
