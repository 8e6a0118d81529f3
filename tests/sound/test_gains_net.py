from dataclasses import replace

import numpy as np
import pytest
import torch

from objectfolder.base.arrays import read_safetensors, safetensors_bytes, write_safetensors
from objectfolder.base.metrics import gain_errors
from objectfolder.nets.fit import Session
from objectfolder.sound import gains_training as audio_gains_training
from objectfolder.sound.gains_net import INT8, GainsNet, energy_weights
from objectfolder.sound.gains_training import ModeSamples, count_features, train_gains
from objectfolder.sound.net_settings import GainsConfig

SHAPE = {"modes": 3, "resolution": 4, "channels": 6, "width": 32, "features": 48, "most_features": 48}
CONFIG = GainsConfig(**SHAPE, frequency=3.0, steps=300, learning_rate=5e-3, grid_rate=3.0)
FREQUENCY = 2 * np.pi * np.array([300.0, 900, 2500])
DAMPING = np.array([3.0, 6, 20])


@pytest.fixture(scope="module")
def field():
    """Smooth mode shapes of very different sizes."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (1200, 3))
    x, y, z = points.T
    one = np.stack([np.sin(3 * x), np.cos(4 * y) * z, x * y], 1)
    two = np.stack([z * z, np.sin(5 * y + z), np.cos(3 * x)], 1)
    three = np.stack([y, x, z], 1)
    return points, np.stack([one, 30 * two, 0.1 * three], 2)


def samples(points, shapes):
    return ModeSamples(points, shapes, FREQUENCY, DAMPING, np.arange(1000), np.arange(1000, 1100))


def train(field, seed=0):
    points, shapes = field
    return train_gains(samples(points, shapes), CONFIG, 256, Session(torch.Generator().manual_seed(seed)))


@pytest.fixture(scope="module")
def trained(field):
    return train(field)


def test_shapes_that_have_little_in_common_get_more_features():
    config = replace(CONFIG, features=2, most_features=6)
    few, many = torch.tensor([1e-6, 1e-6, 1e-6, 1.0]), torch.ones(5)
    counts = [count_features(power, config) for power in (few, many, torch.ones(9), torch.zeros(0))]
    assert counts == [2, 5, 6, 2]


def errors_of(net, field):
    """Of held-out gains."""
    points, shapes = (of[1100:] for of in field)
    predicted = net.shapes(torch.from_numpy(points)).numpy()
    return gain_errors(predicted, shapes, energy_weights(FREQUENCY, DAMPING), 1 / FREQUENCY)


def test_held_out_gains_are_close(field, trained):
    errors = errors_of(trained[0], field)
    assert errors["gain_error"] < 0.05
    assert errors["gain_error_frobenius"] < 0.05
    assert len(trained[1]) == 20


def test_two_runs_are_equal_to_the_byte_and_leave_the_global_random_state(field):
    config = replace(CONFIG, width=8, features=8, steps=2)
    nets = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        before = torch.random.get_rng_state()
        net, _ = train_gains(samples(*field), config, 16, Session(torch.Generator().manual_seed(7)))
        assert torch.equal(torch.random.get_rng_state(), before)
        nets.append(safetensors_bytes(*net.to_tensors()))
    assert nets[0] == nets[1]


def test_what_is_stored_is_what_was_trained_to_the_bit(tmp_path, field, trained):
    net = trained[0]
    tensors, config = net.to_tensors()
    assert {name for name, x in tensors.items() if x.ndim == 2 and x.dtype == np.int8} == set(INT8)
    write_safetensors(tmp_path / "n.safetensors", tensors, config)
    back = GainsNet.from_tensors(*read_safetensors(tmp_path / "n.safetensors"))
    points = torch.from_numpy(field[0][:300])
    assert torch.equal(back.damped_frequency, net.damped_frequency)
    assert torch.equal(back.shapes(points), net.shapes(points))
    for name, value in back.to_tensors()[0].items():
        np.testing.assert_array_equal(value, tensors[name])


def test_rounding_the_net_costs_little(field, trained, monkeypatch):
    """Against the same training with nothing rounded."""
    monkeypatch.setattr(audio_gains_training, "round_to_codes", lambda matrix: matrix)
    monkeypatch.setattr(audio_gains_training, "round_with", lambda matrix, gram: matrix)
    errors = [errors_of(net, field)["gain_error_frobenius"] for net in (trained[0], train(field)[0])]
    assert errors[0] < 1.3 * errors[1]


def test_every_mode_has_its_own_scale(field, trained):
    """Shapes a thousand times larger give the same net but for its amplitudes."""
    points, shapes = field
    loud, _ = train((points, 1024 * shapes))
    assert torch.equal(loud.output.weight, trained[0].output.weight)
    torch.testing.assert_close(loud.amplitude, 1024 * trained[0].amplitude)


@pytest.mark.parametrize("count", [0, 1, 5, 1023, 1024, 1025])
def test_rows_do_not_depend_on_their_batch(trained, count):
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(count)) - 0.5
    whole = trained[0].shapes(points)
    assert whole.shape == (count, 3, 3)
    order = torch.randperm(count, generator=torch.Generator().manual_seed(1))
    assert torch.equal(trained[0].shapes(points[order]), whole[order])
    for i in range(min(count, 3)):
        assert torch.equal(trained[0].shapes(points[i : i + 1])[0], whole[i])


def test_an_object_without_modes(tmp_path):
    still = np.zeros((4, 3)), np.zeros((4, 3, 0)), np.zeros(0), np.zeros(0)
    net, curve = train_gains(ModeSamples(*still, np.arange(2), np.arange(2, 4)), CONFIG, 256, Session())
    assert curve == []
    write_safetensors(tmp_path / "n.safetensors", *net.to_tensors())
    back = GainsNet.from_tensors(*read_safetensors(tmp_path / "n.safetensors"))
    assert back.shapes(torch.zeros(2, 3)).shape == (2, 3, 0)


@pytest.mark.parametrize("c", [4.0, 400.0, 4000.0])
def test_energy_weight_is_the_energy_of_the_displacement(c):
    w = 2 * np.pi * 200
    t = np.linspace(0, 20 / c, 2_000_001)
    energy = np.trapezoid((np.exp(-c * t) * np.sin(w * t) / w) ** 2, t)
    assert energy_weights(np.array([w]), np.array([c]))[0] == pytest.approx(energy, rel=1e-6)
