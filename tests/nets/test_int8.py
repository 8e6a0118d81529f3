import numpy as np
import pytest
import torch

from objectfolder.nets import int8


@pytest.fixture
def matrix():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(30, 20, generator=generator) * 10.0 ** torch.linspace(-6, 3, 30)[:, None]
    rows[4] = 0
    return rows


def test_every_entry_is_within_half_a_step(matrix):
    codes, exponent = int8.to_codes(matrix)
    assert codes.dtype == exponent.dtype == np.int8
    step = torch.ldexp(torch.ones(30), torch.from_numpy(exponent).int())
    back = int8.from_codes(codes, exponent)
    assert ((back - matrix).abs() <= step[:, None] / 2).all()
    largest = torch.from_numpy(np.abs(codes.astype(int)).max(1))
    full = torch.arange(30) != 4
    assert ((largest >= 63) & (largest <= 127))[full].all()
    assert largest[4] == 0


def test_what_is_stored_stays_the_same_when_stored_again(matrix):
    once = int8.round_to_codes(matrix)
    assert torch.equal(int8.round_to_codes(once), once)
    coarse = once.clone()
    coarse[:, 0] = 0  # rows may lose the entry that gave their step
    assert torch.equal(int8.round_to_codes(coarse), coarse)
    assert torch.equal(once.half().float()[10:], once[10:])  # not among float16's smallest


def test_empty_matrices():
    for shape in ((0, 5), (5, 0)):
        codes, exponent = int8.to_codes(torch.zeros(shape))
        assert int8.from_codes(codes, exponent).shape == shape


@pytest.mark.parametrize("correlated", [False, True])
def test_rounding_with_the_data_keeps_outputs(correlated):
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(4000, 60, generator=generator, dtype=torch.float64)
    if correlated:
        x = x[:, :12] @ torch.randn(12, 60, generator=generator, dtype=torch.float64) + 0.05 * x
    weight = torch.randn(15, 60, generator=generator)
    found = int8.rounded_with(weight, x.T @ x)
    assert torch.equal(int8.round_to_codes(found), found)
    rounded = (found, int8.round_to_codes(weight))
    errors = [(x @ (w - weight).T.double()).square().mean().sqrt() for w in rounded]
    assert errors[0] < (0.5 if correlated else 1.001) * errors[1]
