"""The device that stands for a GPU is as strict as one."""

import numpy as np
import pytest
import torch
from pretend_device import pretend_device


def test_values_are_those_of_the_cpu_with_gradients():
    x, start = torch.randn(5, 3), torch.randn(3, 2)
    gradients = []
    with pretend_device() as device:
        for where in ("cpu", device):
            w = start.clone().to(where).requires_grad_()
            (x.to(where) @ w).square().mean().backward()
            assert w.grad.device.type == where
            gradients.append(w.grad.cpu())
    torch.testing.assert_close(gradients[0], gradients[1], rtol=0, atol=0)


@pytest.mark.parametrize(
    "mix",
    [
        lambda x, there: x + there,
        lambda x, there: there @ x.mT,
        lambda x, there: torch.cat([there, x]),
        lambda x, there: x.add_(there),
        lambda x, there: there.where(there > 0, x),
        lambda x, there: x[there[:, 0].long().clamp(0, 1)],
        lambda x, there: there.index_add_(0, torch.tensor([0]), there[:1]),
        lambda x, there: there + torch.zeros(3),
        lambda x, there: torch.stack([there, there], out=torch.empty(2, 2, 3)),
    ],
)
def test_two_devices_in_one_operation_are_an_error(mix):
    with pretend_device() as device, pytest.raises((RuntimeError, TypeError), match="device"):
        mix(torch.ones(2, 3), torch.ones(2, 3, device=device))


def test_numbers_indices_and_copies_may_come_from_the_cpu():
    with pretend_device() as device:
        there = torch.ones(2, 3, device=device)
        there[torch.tensor([0])] = 2.0
        there.copy_(there.cpu() * torch.tensor(3.0))
        assert (there * torch.tensor(0.5)).cpu().tolist() == [[3.0] * 3, [1.5] * 3]


def test_a_copy_on_the_device_shares_no_memory_and_numpy_does_not_see_it():
    x = torch.ones(3)
    with pretend_device() as device:
        there = x.to(device)
        there += 1
        assert x.tolist() == [1, 1, 1]
        assert there.tolist() == [2, 2, 2]
        with pytest.raises((RuntimeError, TypeError)):
            np.asarray(there)


def test_other_code_sees_no_device_afterwards():
    with pretend_device() as device:
        torch.ones(2, device=device)
    with torch.random.fork_rng():
        torch.manual_seed(0)
