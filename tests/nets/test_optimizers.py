import pytest
import torch
from torch import nn

from objectfolder.nets.optimizers import Soap


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
