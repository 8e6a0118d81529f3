"""A training that is killed and continued gives the bytes of one that is not."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

from objectfolder.io import read_safetensors, safetensors_bytes
from objectfolder.nets.adam import papers_adam
from objectfolder.nets.audio_config import SpectrogramConfig
from objectfolder.nets.audio_spectrogram_training import train_spectrogram
from objectfolder.nets.checkpoint import Checkpoint, identity
from objectfolder.nets.fit import fit, in_parts
from objectfolder.nets.positional import HiddenLinear, PointwiseNetwork, train_in
from objectfolder.nets.touch_config import ImageConfig
from objectfolder.nets.touch_image_training import train_image
from objectfolder.nets.vision_config import OsfConfig
from objectfolder.nets.vision_osf_training import train_osf
from objectfolder.vision.cameras import Intrinsics, look_at, sphere_points

TRAINING = {"steps": 30, "learning_rate": 0.01, "final_rate": 1.0, "precision": "float32"}


class Killed(Exception):
    """Stands for a signal: nothing is written after it."""


class KilledAfter(Checkpoint):
    """Writes at every other step, and dies on the way."""

    def __init__(self, path, generator, steps):
        super().__init__(path, "task", generator)
        self.left = steps

    def due(self):
        self.left -= 1
        if self.left == 0:
            raise Killed
        return self.left % 2 == 0


def train_views(generator, checkpoint):
    rng = np.random.default_rng(0)
    views = {
        "rgba": rng.random((3, 8, 8, 4)).astype(np.float16),
        "camera_to_world": look_at(sphere_points(3, 2.5, rng)),
        "light": sphere_points(3, 1.0, rng),
        "focal": np.float64(Intrinsics.square(8).focal),
        "center": np.full((3, 2), 4.0),
    }
    shape = {"width": 16, "depth": 2, "branch_width": 16, "branch_depth": 2, "point_octaves": 2}
    shape |= {"direction_octaves": 1, "coarse_samples": 4, "fine_samples": 4, "hull_cells": 8}
    config = OsfConfig(**shape, batch=100, **TRAINING)
    return train_osf(views, views, config, generator, checkpoint=checkpoint)


def train_sounds(generator, checkpoint):
    rng = np.random.default_rng(0)
    points, shapes = rng.uniform(-0.5, 0.5, (20, 3)), rng.standard_normal((20, 3, 2))
    tuning = 2 * np.pi * np.array([400.0, 1500]), np.array([3.0, 4])
    rows = np.arange(15), np.arange(15, 20)
    shape = {"width": 8, "depth": 2, "point_octaves": 1, "bin_octaves": 2}
    config = SpectrogramConfig(**shape, batch=64, loud=0.0, **TRAINING)
    return train_spectrogram(points, shapes, *tuning, *rows, config, generator, checkpoint=checkpoint)


def train_touches(generator, checkpoint):
    rng = np.random.default_rng(0)
    contacts = {
        "images": rng.integers(0, 255, (5, 6, 8, 3), dtype=np.uint8),
        "points": rng.uniform(-0.1, 0.1, (5, 3)),
        "depths": np.full(5, 0.001),
        "angles": np.zeros(5),
    }
    config = ImageConfig(width=8, depth=2, point_octaves=2, pixel_octaves=2, batch=64, **TRAINING)
    return train_image(contacts, contacts, 0.2, "digit", config, generator, checkpoint=checkpoint)


@pytest.mark.parametrize("train", [train_views, train_sounds, train_touches])
def test_a_killed_training_continues_to_the_bytes_of_one_that_was_not(tmp_path, train):
    whole, curve = train(torch.Generator().manual_seed(0), None)
    path = tmp_path / "checkpoint.safetensors"
    for steps in (12, 9, None):  # dies twice, both times a step or two after what it wrote
        generator = torch.Generator().manual_seed(0)
        if steps:
            with pytest.raises(Killed):
                train(generator, KilledAfter(path, generator, steps))
        else:
            assert read_safetensors(path)[1]["numbers"]["step"] == 17
            net, again = train(generator, Checkpoint(path, "task", generator))
    assert safetensors_bytes(*net.to_tensors()) == safetensors_bytes(*whole.to_tensors())
    assert [dataclasses.replace(p, seconds=0) for p in again] == [
        dataclasses.replace(p, seconds=0) for p in curve
    ]


def test_a_continued_training_reports_its_whole_curve(tmp_path):
    path, generator, reported = tmp_path / "checkpoint.safetensors", torch.Generator(), []

    def run(checkpoint, report):
        net = nn.Linear(1, 1)
        return fit(
            net,
            lambda: net.weight.square().sum(),
            lambda: 1.0,
            steps=20,
            learning_rate=0.1,
            optimizer=papers_adam(net),
            report=report,
            checkpoint=checkpoint,
        )

    with pytest.raises(Killed):
        run(KilledAfter(path, generator, 12), lambda point: None)
    curve = run(Checkpoint(path, "task", generator), reported.append)
    assert [point.step for point in reported] == list(range(1, 21))
    assert reported == curve


def test_a_training_that_was_killed_before_its_first_evaluation_continues(tmp_path):
    path, generator, net = tmp_path / "checkpoint.safetensors", torch.Generator(), nn.Linear(1, 1)
    steps = []

    def run(checkpoint):
        def loss():
            steps.append(None)
            return net.weight.square().sum()

        fit(net, loss, lambda: 1.0, 100, 0.1, 1, optimizer=papers_adam(net), checkpoint=checkpoint)

    with pytest.raises(Killed):
        run(KilledAfter(path, generator, 12))
    del steps[:]
    run(Checkpoint(path, "task", generator))
    assert len(steps) == 90


def test_checkpoints_of_another_task_or_damaged_ones_are_not_continued(tmp_path):
    path, generator = tmp_path / "c.safetensors", torch.Generator().manual_seed(0)
    before = generator.get_state()
    saved = Checkpoint(path, "one", generator)
    saved.save({"net.weight": torch.zeros(2)}, {"step": 3})
    tensors, numbers = Checkpoint(path, "one", generator).load()
    assert numbers == {"step": 3}
    assert torch.equal(tensors["net.weight"], torch.zeros(2))
    generator.manual_seed(1)
    assert Checkpoint(path, "other", generator).load() is None
    path.write_bytes(path.read_bytes()[:-3])
    assert Checkpoint(path, "one", generator).load() is None
    assert not torch.equal(generator.get_state(), before)  # nothing was restored


def test_what_a_training_depends_on_changes_its_identity(tmp_path):
    config, data = (
        ImageConfig(width=8, depth=2, point_octaves=2, pixel_octaves=2, batch=4, **TRAINING),
        tmp_path / "data",
    )
    data.write_bytes(b"1")
    one = identity(config, 0, [data])
    assert identity(config, 0, [data]) == one
    assert identity(dataclasses.replace(config, steps=31), 0, [data]) != one
    assert identity(config, 1, [data]) != one
    data.write_bytes(b"2")
    assert identity(config, 0, [data]) != one


def test_gradients_of_a_batch_in_parts_are_those_of_the_whole():
    torch.manual_seed(0)
    net, x, y = nn.Linear(3, 1).double(), torch.randn(10, 3).double(), torch.randn(10, 1).double()

    def loss(x, y):
        return (net(x) - y).square().mean()

    loss(x, y).backward()
    expected, net.weight.grad = net.weight.grad, None
    total = in_parts(loss, 4, x, y)
    total.backward()
    torch.testing.assert_close(net.weight.grad, expected)
    assert total.item() == pytest.approx(loss(x, y).item())


def test_a_constant_rate_is_constant_from_the_first_step():
    net = nn.Linear(1, 1)
    adam, rates = papers_adam(net), []
    assert (adam.betas, adam.eps) == ((0.9, 0.999), 1e-7)  # supplementary E

    def loss():
        rates.append(adam.param_groups[0]["lr"])
        return net.weight.square().sum()

    fit(net, loss, lambda: 0.0, steps=60, learning_rate=5e-4, final_rate=1.0, optimizer=adam)
    assert rates == [5e-4] * 60


def test_a_layer_between_hidden_layers_is_trained_in_their_precision_and_answers_in_float32():
    torch.manual_seed(0)
    layer, x = HiddenLinear(64, 32), torch.randn(200, 64)
    exact = layer(x)
    train_in(layer, "bfloat16")
    trained = layer.train()(x)
    assert trained.dtype == torch.float32
    assert 1e-4 < (trained - exact).norm() / exact.norm() < 0.01
    assert torch.equal(layer.eval()(x), exact)


def test_bfloat16_gives_nearly_the_gradients_of_float32_and_the_same_answers():
    torch.manual_seed(0)
    net, x = PointwiseNetwork(64, 8, 6, 6, outputs=2), torch.rand(200, 5) * 2 - 1
    gradients = []
    for precision in ("float32", "bfloat16"):
        train_in(net, precision)
        net.zero_grad()
        out = net.train()(x)
        assert out.dtype == torch.float32
        (out - x[:, :2]).square().mean().backward()
        gradients.append(torch.cat([p.grad.flatten() for p in net.parameters()]))
        assert gradients[-1].dtype == torch.float32
    difference = (gradients[1] - gradients[0]).norm() / gradients[0].norm()
    assert 1e-4 < difference < 0.03  # 8 bits of a hidden value: 0.4 %
    answer = net.eval()(x)  # an answer does not depend on how the net was trained
    train_in(net, "float32")
    assert torch.equal(net(x), answer)
