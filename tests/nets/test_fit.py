import itertools

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.nets.fit import FitSettings, Session, fit, minibatches, sum_in_parts
from objectfolder.nets.optimizers import make_papers_adam


def test_the_net_is_left_at_its_best_validation_loss():
    net = nn.Linear(1, 1, bias=False)
    with torch.no_grad():
        net.weight.fill_(0.0)
    seen = []

    def val_loss():  # best on the way, not at the end
        seen.append((abs(net.weight.item() - 0.5), net.weight.item()))
        return seen[-1][0]

    curve = fit(net, lambda: (net.weight - 2).square().sum(), val_loss, FitSettings(200, 0.05), Session())
    assert len(curve) == len(seen) == 20
    best = min(seen)
    assert seen.index(best) < 19
    assert net.weight.item() == best[1]
    assert [p.step for p in curve] == list(range(10, 201, 10))
    assert curve[-1].train_loss < curve[0].train_loss


def test_it_minimises():
    torch.manual_seed(0)
    net = nn.Linear(3, 1)
    x = torch.randn(100, 3)
    y = x @ torch.tensor([[1.0], [2], [-1]]) + 0.5

    def loss():
        return (net(x) - y).square().mean()

    reported = []
    fit(net, loss, lambda: loss().item(), FitSettings(500, 0.05), Session(report=reported.append))
    assert loss().item() < 1e-5
    assert len(reported) == 20


def test_a_training_that_diverges_says_so():
    net = nn.Linear(1, 1)
    with pytest.raises(ObjectFolderError, match=r"diverged: the loss of step \d+ of 100 is (inf|nan); lower"):
        fit(net, lambda: net.weight.square().sum(), lambda: 1.0, FitSettings(100, 1e30), Session())


@pytest.mark.parametrize("steps", [1, 3, 19])
def test_few_steps_end_with_an_evaluation(steps):
    net = nn.Linear(1, 1)
    curve = fit(net, lambda: net.weight.square().sum(), lambda: 1.0, FitSettings(steps, 0.1), Session())
    assert curve[-1].step == steps


@given(st.integers(1, 40), st.integers(1, 50), st.integers(0, 99))
def test_an_epoch_takes_no_sample_twice(count, size, seed):
    batches = minibatches(count, size, torch.Generator().manual_seed(seed))
    per_epoch = count // min(size, count)
    for _ in range(2):
        epoch = torch.cat(list(itertools.islice(batches, per_epoch)))
        assert len(epoch) == per_epoch * min(size, count)
        assert len(epoch.unique()) == len(epoch)
        assert epoch.max() < count


def test_gradients_of_a_batch_in_parts_are_those_of_the_whole():
    torch.manual_seed(0)
    net, x, y = nn.Linear(3, 1).double(), torch.randn(10, 3).double(), torch.randn(10, 1).double()

    def loss(x, y):
        return (net(x) - y).square().mean()

    loss(x, y).backward()
    expected, net.weight.grad = net.weight.grad, None
    total = sum_in_parts(loss, 4, x, y)
    total.backward()
    torch.testing.assert_close(net.weight.grad, expected)
    assert total.item() == pytest.approx(loss(x, y).item())


def test_a_constant_rate_is_constant_from_the_first_step():
    net = nn.Linear(1, 1)
    adam, rates = make_papers_adam(net), []
    assert (adam.defaults["betas"], adam.defaults["eps"]) == ((0.9, 0.999), 1e-7)  # supplementary E

    def loss():
        rates.append(adam.param_groups[0]["lr"])
        return net.weight.square().sum()

    fit(net, loss, lambda: 0.0, FitSettings(60, 5e-4, final_rate=1.0), Session(), adam)
    assert rates == [5e-4] * 60
