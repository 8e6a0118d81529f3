import subprocess
import sys

import pytest
import torch
from torch import nn

from objectfolder.nets.optimizers import Adam, Soap


def trained(make):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net, unused = nn.Linear(5, 7), nn.Parameter(torch.ones(3))
        x, y = torch.randn(64, 5), torch.randn(64, 7)
    optimizer = make([{"params": [*net.parameters(), unused], "lr": 0.01}])
    for step in range(50):
        optimizer.param_groups[0]["lr"] = 0.01 / (1 + step)
        net.zero_grad()
        (net(x) - y).square().mean().backward()
        optimizer.step()
    assert (unused == 1).all()
    return net.weight.detach()


def test_it_is_the_adam_of_pytorch():
    options = {"betas": (0.9, 0.99), "eps": 1e-12}
    theirs = trained(lambda groups: torch.optim.Adam(groups, **options, fused=True))
    assert torch.equal(trained(lambda groups: Adam(groups, **options)), theirs)


@pytest.mark.slow
def test_groups_without_a_gradient_stay():
    moving, still = nn.Parameter(torch.ones(2)), nn.Parameter(torch.ones(2))
    moving.grad = torch.ones(2)
    optimizer = Adam([{"params": [still], "lr": 0.1}, {"params": [moving], "lr": 0.1}], (0.9, 0.99), 1e-8)
    optimizer.step()
    assert torch.equal(still, torch.ones(2))
    torch.testing.assert_close(moving.detach(), torch.full((2,), 0.9))


def test_training_does_not_import_the_compiler_of_pytorch():
    """It takes a second and 75 MB, in every stage that trains."""
    code = """
import sys, torch
from objectfolder.nets.fit import FitSettings, Session, fit
from objectfolder.nets.optimizers import Soap
net = torch.nn.Linear(2, 2)
loss = lambda: net(torch.ones(1, 2)).square().sum()
for optimizer in (None, Soap([{"params": list(net.parameters())}])):
    fit(net, loss, lambda: 0.0, FitSettings(2, 0.01), Session(), optimizer)
sys.exit("torch._dynamo" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def regression(optimizer, steps=150):
    """Final loss of a linear layer whose inputs are correlated: the curvature spans six decades."""
    generator = torch.Generator().manual_seed(0)
    mix = torch.linalg.qr(torch.randn(16, 16, generator=generator))[0] * torch.logspace(0, -3, 16)
    x = torch.randn(256, 16, generator=generator) @ mix.T
    truth = torch.randn(16, 300, generator=generator)  # a side too long to precondition
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net = nn.Linear(16, 300)
    optimizer = optimizer(list(net.parameters()))
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 0.05 * (1 - step / steps)
        net.zero_grad()
        loss = (net(x) - x @ truth).square().mean()
        loss.backward()
        optimizer.step()
    return loss.item()


def test_soap_sees_through_correlated_inputs():
    adam = regression(lambda p: torch.optim.Adam(p, betas=(0.95, 0.95)))
    soap = regression(lambda p: Soap([{"params": p}]))
    assert soap < 0.2 * adam


def test_one_step_of_soap_with_a_vector_has_the_length_of_the_rate_in_every_entry():
    """Without a matrix there is nothing to rotate: it is Adam."""
    vector = nn.Parameter(torch.tensor([1.0, -2.0, 3.0]))
    optimizer = Soap([{"params": [vector], "lr": 0.01}])
    vector.grad = torch.tensor([5.0, -0.1, 2.0])
    before = vector.detach().clone()
    optimizer.step()
    left = before - vector.detach()
    assert left.tolist() == pytest.approx([0.01, -0.01, 0.01], rel=1e-3)
