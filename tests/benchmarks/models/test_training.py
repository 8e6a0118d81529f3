import math

import numpy as np
import pytest
import torch
from refusals import refused
from torch import nn

from objectfolder.base.seeding import numpy_generator, seeded
from objectfolder.benchmarks.models.training import (
    Objective,
    TrainSettings,
    count_batches,
    has_bfloat16,
    shuffle,
    train,
)


def _data(noise, count):
    """Points of two classes, some with the other's label; the first half is for training."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((count, 4)).astype(np.float32)
    labels = (x @ [1, -2, 0.5, 0] > 0).astype(np.int64)
    flipped = np.where(rng.random(count) < noise, 1 - labels, labels)
    return torch.from_numpy(x), torch.from_numpy(flipped), torch.from_numpy(labels)


def _problem(noise=0.0, width=16, count=256):
    """Arguments of `train`, and a fresh net with batch normalisation."""
    x, noisy, labels = _data(noise, count)
    half = len(x) // 2
    with seeded(0, "test"):
        net = nn.Sequential(nn.Linear(4, width), nn.BatchNorm1d(width), nn.ReLU(), nn.Linear(width, 2))

    def batches(epoch):
        return shuffle(np.arange(half), 32, numpy_generator(0, "test", str(epoch)))

    def loss(rows):
        return nn.functional.cross_entropy(net(x[rows]), noisy[rows])

    def score():
        return (net(x[half:]).argmax(1) == labels[half:]).double().mean().item()

    return net, (batches, loss, score), {"epochs": 6, "learning_rate": 0.02, "patience": 6}


def _state(net):
    return {name: value.numpy().tobytes() for name, value in net.state_dict().items()}


def test_net_learns_in_spite_of_label_noise():
    net, functions, settings = _problem(noise=0.2, count=1024)
    curve = train(Objective(net, *functions), TrainSettings(**settings))
    assert [point.epoch for point in curve] == [1, 2, 3, 4, 5, 6]
    assert functions[2]() == max(point.val_score for point in curve) > 0.9
    assert not net.training


def test_best_epoch_is_kept_and_patience_ends_the_training(tmp_path):
    net, (batches, loss, _), settings = _problem()
    scores, states = iter([0.1, 0.5, 0.5, 0.4, 0.9]), []

    def score():
        states.append(_state(net))
        return next(scores)

    curve = train(Objective(net, batches, loss, score), TrainSettings(**settings | {"patience": 2}))
    assert [point.val_score for point in curve] == [0.1, 0.5, 0.5, 0.4]
    assert _state(net) == states[1]  # the first of equals


@pytest.fixture
def rates(monkeypatch):
    """Learning rates of the steps that are made."""
    rates = []

    class Recorder(torch.optim.AdamW):
        def step(self, closure=None):
            rates.append(self.param_groups[0]["lr"])
            return super().step(closure)

    monkeypatch.setattr(torch.optim, "AdamW", Recorder)
    return rates


def test_rate_warms_up_and_then_falls_as_a_cosine(rates):
    net, functions, settings = _problem()
    train(Objective(net, *functions), TrainSettings(**settings | {"epochs": 10, "patience": 10}))
    rates = np.reshape(rates, (10, 4))
    decay = [0.5 + 0.5 * math.cos(math.pi * epoch / 10) for epoch in range(10)]
    expected = 0.02 * np.outer(decay, np.ones(4)) * np.minimum(1, np.arange(1, 41) / 20).reshape(10, 4)
    np.testing.assert_allclose(rates, expected, rtol=1e-12)


def test_one_cycle_rises_over_a_fifth_and_falls_to_nothing(rates):
    net, functions, settings = _problem()
    train(Objective(net, *functions), TrainSettings(**settings | {"epochs": 10, "patience": 10, "cycle": 40}))
    assert len(rates) == 40
    expected = [i / 8 if i < 8 else 0.5 + 0.5 * math.cos(math.pi * (i - 8) / 32) for i in range(1, 41)]
    np.testing.assert_allclose(rates, 0.02 * np.array(expected), atol=1e-12)


def test_only_weights_of_layers_decay_in_one_cycle():
    """Without a gradient, the optimizer's only step is the decay."""
    decayed = {}
    for cycle in (None, 4):
        net, (batches, _, score), settings = _problem()
        before = {name: p.detach().clone() for name, p in net.named_parameters()}

        def loss(rows, net=net):
            return 0 * sum(p.sum() for p in net.parameters())

        settings |= {"epochs": 1, "weight_decay": 0.5, "cycle": cycle}
        train(Objective(net, batches, loss, score), TrainSettings(**settings))
        after = dict(net.named_parameters())
        decayed[cycle] = {name for name, p in before.items() if not torch.equal(p, after[name])}
    assert decayed == {
        None: {"0.weight", "0.bias", "1.weight", "3.weight", "3.bias"},
        4: {"0.weight", "3.weight"},
    }


@pytest.mark.parametrize("available", [True, False])
def test_training_in_bfloat16_agrees_with_float32(monkeypatch, available):
    """Where the processor lacks it, training is in float32, and equal but for channels last."""
    monkeypatch.setattr("objectfolder.benchmarks.models.training.has_bfloat16", lambda: available)
    rng = np.random.default_rng(0)
    labels = torch.arange(96) % 3
    x = 0.3 * torch.from_numpy(rng.standard_normal((96, 3, 12, 12))).float()
    x[torch.arange(96), labels] += 1
    nets, losses, kinds = {}, {}, {}
    for precision in ("float32", "bfloat16"):
        with seeded(0, "test"):
            net = nn.Sequential(
                *(nn.Conv2d(3, 8, 3, 2), nn.BatchNorm2d(8), nn.ReLU()),
                *(nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(8, 3)),
            )

        def loss(rows, net=net, precision=precision):
            answer = net(x[rows])
            kinds.setdefault(precision, answer.dtype)
            return nn.functional.cross_entropy(answer, labels[rows])

        def batches(epoch):
            return shuffle(np.arange(64), 16, numpy_generator(0, "test", str(epoch)))

        def score(net=net):
            answer = net(x[64:])
            assert answer.dtype == torch.float32
            return (answer.argmax(1) == labels[64:]).double().mean().item()

        settings = {"epochs": 4, "learning_rate": 0.01, "patience": 4, "precision": precision}
        curve = train(Objective(net, batches, loss, score), TrainSettings(**settings))
        assert all(value.dtype != torch.bfloat16 for value in net.state_dict().values())
        nets[precision], losses[precision] = net, [point.train_loss for point in curve]
        assert curve[-1].val_score > 0.9
    assert kinds == {"float32": torch.float32, "bfloat16": torch.bfloat16 if available else torch.float32}
    assert nets["bfloat16"][0].weight.is_contiguous(memory_format=torch.channels_last)
    np.testing.assert_allclose(losses["bfloat16"], losses["float32"], rtol=0.02 if available else 1e-4)


def test_processors_of_this_kind_are_recognised(monkeypatch):
    for name in ("avx512_bf16", "amx_bf16"):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda name=name: {"avx2": True, name: True})
        assert has_bfloat16()
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx2": True, "avx512_bf16": False})
    assert not has_bfloat16()


def test_statistics_of_batch_normalisation_forget_what_they_held_before():
    """Inputs of variance 1e-6 take no more steps than others to be normalised in evaluation."""
    norm = nn.BatchNorm1d(4)
    net = nn.Sequential(norm, nn.Linear(4, 2))
    x = 5 + 1e-3 * torch.randn(64, 4, generator=torch.Generator().manual_seed(0))
    batches = list(x.split(8))

    def loss(batch):
        return net(batch).square().mean()

    objective = Objective(net, lambda epoch: batches, loss, lambda: 0.0)
    train(objective, TrainSettings(epochs=1, learning_rate=1e-3, patience=1))
    expected = [torch.stack([f(batch, 0) for batch in batches]).mean(0) for f in (torch.mean, torch.var)]
    torch.testing.assert_close(norm.running_mean, expected[0])
    torch.testing.assert_close(norm.running_var, expected[1], rtol=1e-3, atol=0)


def test_net_is_in_evaluation_and_without_gradients_while_it_is_scored():
    net, (batches, loss, _), settings = _problem()

    def batch_loss(rows):
        assert net.training
        return loss(rows)

    def score():
        assert not net.training
        assert not torch.is_grad_enabled()
        return 0.0

    train(Objective(net, batches, batch_loss, score), TrainSettings(**settings))


@pytest.mark.parametrize(
    ("factor", "score", "message"),
    [
        (math.nan, 0.0, r"epoch 1 has a training loss of nan.*learning_rate than 0\.02"),
        (1.0, math.nan, "validation score of nan"),
    ],
)
def test_diverging_training_is_an_error(factor, score, message):
    net, (batches, loss, _), settings = _problem()
    objective = Objective(net, batches, lambda rows: factor * loss(rows), lambda: score)
    refused(message, train, objective, TrainSettings(**settings))


@pytest.mark.parametrize(("width", "changes"), [(16, {"learning_rate": 0.01}), (8, {})])
def test_a_checkpoint_of_other_settings_or_another_net_is_refused(tmp_path, width, changes):
    checkpoint = tmp_path / "training.pt"
    net, functions, settings = _problem()
    settings["epochs"] = 1
    train(Objective(net, *functions), TrainSettings(**settings), checkpoint)
    net, functions, _ = _problem(width=width)
    before = _state(net)
    message = r"training\.pt is of a training with .*'learning_rate': 0\.02.*delete it"
    refused(message, train, Objective(net, *functions), TrainSettings(**settings | changes), checkpoint)
    assert _state(net) == before


@pytest.mark.parametrize(
    ("count", "sizes"),
    [(8, [4, 4]), (9, [4, 5]), (10, [4, 4, 2]), (3, [3]), (4, [4]), (5, [5]), (6, [4, 2]), (1, [1])],
)
def test_batches_of_an_epoch_hold_each_row_once_in_random_order(count, sizes):
    rows = np.arange(100, 100 + count)
    epochs = [list(shuffle(rows, 4, np.random.default_rng(seed))) for seed in (1, 1, 2)]
    assert [len(batch) for batch in epochs[0]] == sizes
    assert count_batches(count, 4) == len(sizes)
    first, again, other = (np.concatenate(batches) for batches in epochs)
    np.testing.assert_array_equal(np.sort(first), rows)
    assert (first == again).all()
    assert count < 8 or all((a != b).any() for a, b in ((first, rows), (first, other)))
