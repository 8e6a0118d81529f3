import subprocess
import sys

import pytest
import torch
from torch import nn

from objectfolder.nets.adam import Adam


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
    ours = trained(lambda groups: Adam(groups, (0.9, 0.99), 1e-12))
    assert torch.equal(
        ours, trained(lambda groups: torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-12, fused=True))
    )


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
from objectfolder.nets.fit import fit
from objectfolder.nets.soap import Soap
net = torch.nn.Linear(2, 2)
loss = lambda: net(torch.ones(1, 2)).square().sum()
for optimizer in (None, Soap([{"params": list(net.parameters())}])):
    fit(net, loss, lambda: 0.0, 2, 0.01, optimizer=optimizer)
sys.exit("torch._dynamo" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
