"""A training that is killed and continued gives the bits of one that was not, whichever trainer runs it."""

import dataclasses
from dataclasses import astuple
from itertools import count

import numpy as np
import pytest
import torch
from small_trainings import train_sounds, train_touches, train_views
from tiny_tasks import Follow, Line
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.models import ppo
from objectfolder.benchmarks.models.ppo import train_ppo
from objectfolder.benchmarks.models.settings import GraspPolicyConfig, ReachConfig
from objectfolder.benchmarks.models.training import Objective, TrainSettings, shuffle, train
from objectfolder.benchmarks.models.trpo import train_trpo
from objectfolder.nets.checkpoint import Checkpoint, identity
from objectfolder.nets.fit import FitSettings, Session, fit
from objectfolder.nets.optimizers import Soap

POLICY = {"seeds": 1, "batch": 16, "learning_rate": 0.01, "discount": 0.9, "width": 4, "log_deviation": -0.5}


class Killed(Exception):
    """Stands for a signal: nothing is written after it."""


def kill_after(monkeypatch, units):
    """Write at every other unit, and die on the way."""
    left = count(units - 1, -1)

    def is_due(self):
        now = next(left)
        if now == 0:
            raise Killed
        return now % 2 == 0

    monkeypatch.setattr(Checkpoint, "is_due", is_due)


def make_session(path, report):
    return Session(torch.Generator().manual_seed(0), checkpoint=Checkpoint(path, "task"), report=report)


def train_papers(train):
    def run(path, report):
        net, curve = train(make_session(path, report))
        return net.state_dict(), curve

    return run


def train_by_soap(path, report):
    """It is killed before its only evaluation."""
    with seeded(0, "test"):
        net = nn.Linear(4, 3)
    course = make_session(path, report)
    optimizer = Soap([{"params": list(net.parameters())}])

    def loss():
        return (net(torch.randn(8, 4, generator=course.generator)) - 1).square().mean()

    curve = fit(net, loss, lambda: 1.0, FitSettings(30, 0.01, evaluations=1), course, optimizer)
    return net.state_dict(), curve


def train_epochs(path, report):
    with seeded(0, "test"):
        net = nn.Sequential(nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), nn.Flatten(), nn.Linear(72, 2))
    rng = np.random.default_rng(0)
    x, labels = torch.from_numpy(rng.random((64, 3, 5, 5), np.float32)), torch.arange(64) % 2
    objective = Objective(
        net,
        lambda epoch: shuffle(np.arange(64), 16, numpy_generator(0, "test", str(epoch))),
        lambda rows: nn.functional.cross_entropy(net(x[rows]), labels[rows]),
        lambda: (net(x).argmax(1) == labels).double().mean().item(),
    )
    settings = TrainSettings(epochs=6, learning_rate=0.02, patience=6, precision="bfloat16")
    curve = train(objective, settings, path, report=report)
    return net.state_dict(), curve


def train_by_ppo(path, report):
    params = ReachConfig(steps=384, horizon=8, goals=2, environments=4, rollout=16, epochs=2, **POLICY)

    def validate(actor):  # no part is solved
        return 0.0, float(actor(np.array([0.8]))[0])

    actor, curve, _ = train_ppo(Line, params, 0, ("test",), validate, path, report)
    return actor.tensors(), curve


def train_by_trpo(path, report):
    settings = {"episodes": 96, "environments": 4, "rollout": 8, "updates": 1, "patience": 9, "gae": 0.97}
    settings |= {"damping": 0.01, "divergence": 0.01, "rollouts": 6, "presses": 4}
    params = GraspPolicyConfig(**settings, **POLICY)

    def validate(actor):
        return float(actor(np.array([0.5, 1.0]))[0])

    actor, curve, _ = train_trpo(Follow(4), params, 0, ("test",), validate, path, report)
    return actor.tensors(), curve


def run(trainer, path, world, report=lambda point: None):
    """Bytes of what is trained, and its curve without seconds; the global generators do not matter."""
    np.random.seed(world)  # noqa: NPY002 - Stable-Baselines3 draws from it
    torch.manual_seed(world)
    before = torch.get_rng_state()
    tensors, curve = trainer(path, report)
    assert trainer in (train_by_ppo, train_by_trpo) or torch.equal(torch.get_rng_state(), before)
    rows = [astuple(point)[:3] if dataclasses.is_dataclass(point) else point for point in curve]
    return {name: np.asarray(value).tobytes() for name, value in tensors.items()}, rows


@pytest.mark.parametrize(
    ("trainer", "kills", "kept", "replays"),
    [
        pytest.param(train_papers(train_views), (12, 9), 17, True, id="osf"),
        pytest.param(train_papers(train_sounds), (12, 9), 17, True, id="spectrogram"),
        pytest.param(train_papers(train_touches), (12, 9), 17, True, id="image"),
        pytest.param(train_by_soap, (12, 9), 17, True, id="soap"),
        pytest.param(train_epochs, (4, 3), 3, False, id="epochs"),
        pytest.param(train_by_ppo, (4, 3), 3, False, id="ppo"),
        pytest.param(train_by_trpo, (4, 3), 3, False, id="trpo"),
    ],
)
def test_a_killed_training_continues_to_the_bits_of_one_that_was_not(
    tmp_path, monkeypatch, trainer, kills, kept, replays
):
    monkeypatch.setattr(ppo, "ROUNDS", 1)
    whole = run(trainer, tmp_path / "whole.pt", 0)
    path = tmp_path / "killed.pt"
    for units in kills:  # dies twice, both times a unit or two after what it wrote
        kill_after(monkeypatch, units)
        with pytest.raises(Killed):
            run(trainer, path, units)
    monkeypatch.undo()
    monkeypatch.setattr(ppo, "ROUNDS", 1)
    assert torch.load(path, weights_only=True)["units"] == kept
    reported = []
    assert run(trainer, path, 1, reported.append) == whole
    assert len(reported) == len(whole[1]) - (0 if replays else kept)
    del reported[:]
    assert run(trainer, path, 2, reported.append) == whole  # what is finished is not trained again
    assert len(reported) == (len(whole[1]) if replays else 0)


def test_checkpoints_of_another_training_or_damaged_ones_are_refused_or_replaced(tmp_path):
    path = tmp_path / "c.pt"
    assert Checkpoint(path, "one").load() is None
    Checkpoint(path, "one").save({"parts": {"net": torch.zeros(2)}, "units": 3})
    state = Checkpoint(path, "one").load()
    assert state["units"] == 3
    assert torch.equal(state["parts"]["net"], torch.zeros(2))
    good = path.read_bytes()

    def refused(message, identity="one"):
        assert Checkpoint(path, identity, replaces=True).load() is None
        with pytest.raises(
            ObjectFolderError, match=rf"c\.pt {message}.*; delete it to restart this training"
        ):
            Checkpoint(path, identity).load()

    refused("is of a training with one, expected other", "other")
    for content in (good[: len(good) // 2], b"", b"text"):
        path.write_bytes(content)
        refused("is damaged")
    torch.save({"weights": torch.ones(2)}, path)
    refused("is not a checkpoint")


def test_what_a_training_depends_on_changes_its_identity(tmp_path):
    data = tmp_path / "data"
    data.write_bytes(b"1")
    one = identity(FitSettings(30, 0.1), [data])
    assert identity(FitSettings(30, 0.1), [data]) == one
    assert identity(FitSettings(31, 0.1), [data]) != one
    data.write_bytes(b"2")
    assert identity(FitSettings(30, 0.1), [data]) != one
