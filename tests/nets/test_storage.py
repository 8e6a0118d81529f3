"""Stored nets are loaded as they are, whatever the default type and device of torch are; int8 codes."""

from contextlib import contextmanager

import numpy as np
import pytest
import torch
from test_on_a_device import NETS

from objectfolder import ObjectFile
from objectfolder.nets.storage import from_codes, round_to_codes, round_with, to_codes


@contextmanager
def defaults(dtype, device):
    """Set torch's defaults for a while."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        with torch.device(device):
            yield
    finally:
        torch.set_default_dtype(before)


_TYPES = [(torch.float64, "cpu"), (torch.float16, "cpu"), (torch.float32, "meta")]
DEFAULTS = pytest.mark.parametrize(("dtype", "device"), _TYPES)


def loaded(file):
    """State of the nets of an Object File: what queries read."""
    parts = file._parts
    return parts.vision.net.state_dict() | parts.audio.net.state_dict()


@DEFAULTS
def test_the_nets_of_a_file_are_those_that_it_stores(brick, dtype, device):
    expected, state = loaded(brick), torch.get_rng_state()
    with defaults(dtype, device):
        found = loaded(ObjectFile(brick.header, brick.tensors))
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=0, atol=0)
    assert torch.equal(torch.get_rng_state(), state), "nothing is drawn"


@DEFAULTS
def test_touches_and_mode_shapes_are_the_same(brick, dtype, device):
    points = brick.sample_surface(3)
    expected = brick.touch(points), brick.mode_shapes(points), brick.base_colors(points / brick.scale)
    with defaults(dtype, device):
        file = ObjectFile(brick.header, brick.tensors)
        found = file.touch(points), file.mode_shapes(points), file.base_colors(points / brick.scale)
    for answer, same in zip(found, expected):
        assert answer.dtype == same.dtype
        np.testing.assert_array_equal(answer, same)


@pytest.mark.parametrize("kind", NETS)
def test_every_kind_of_net_answers_the_same(kind, tmp_path):
    make, ask = NETS[kind]
    with torch.random.fork_rng():
        torch.manual_seed(3)
        net = make(tmp_path)
    stored = net.to_tensors()
    expected = ask(type(net).from_tensors(*stored))
    with defaults(torch.float64, "cpu"):
        doubled = ask(type(net).from_tensors(*stored))
    with torch.device("meta"):
        elsewhere = type(net).from_tensors(*stored)
    for found in (doubled, ask(elsewhere)):
        for answer, same in zip(*(x if isinstance(x, tuple) else [x] for x in (found, expected))):
            assert answer.dtype == same.dtype
            np.testing.assert_array_equal(np.asarray(answer), np.asarray(same))


@pytest.fixture
def matrix():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(30, 20, generator=generator) * 10.0 ** torch.linspace(-6, 3, 30)[:, None]
    rows[4] = 0
    return rows


def test_every_entry_is_within_half_a_step(matrix):
    codes, exponent = to_codes(matrix)
    assert codes.dtype == exponent.dtype == np.int8
    step = torch.ldexp(torch.ones(30), torch.from_numpy(exponent).int())
    back = from_codes(codes, exponent)
    assert ((back - matrix).abs() <= step[:, None] / 2).all()
    largest = torch.from_numpy(np.abs(codes.astype(int)).max(1))
    full = torch.arange(30) != 4
    assert ((largest >= 63) & (largest <= 127))[full].all()
    assert largest[4] == 0


def test_what_is_stored_stays_the_same_when_stored_again(matrix):
    once = round_to_codes(matrix)
    assert torch.equal(round_to_codes(once), once)
    coarse = once.clone()
    coarse[:, 0] = 0  # rows may lose the entry that gave their step
    assert torch.equal(round_to_codes(coarse), coarse)
    assert torch.equal(once.half().float()[10:], once[10:])  # not among float16's smallest


def test_empty_matrices():
    for shape in ((0, 5), (5, 0)):
        codes, exponent = to_codes(torch.zeros(shape))
        assert from_codes(codes, exponent).shape == shape


@pytest.mark.parametrize("correlated", [False, True])
def test_rounding_with_the_data_keeps_outputs(correlated):
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(4000, 60, generator=generator, dtype=torch.float64)
    if correlated:
        x = x[:, :12] @ torch.randn(12, 60, generator=generator, dtype=torch.float64) + 0.05 * x
    weight = torch.randn(15, 60, generator=generator)
    found = round_with(weight, x.T @ x)
    assert torch.equal(round_to_codes(found), found)
    rounded = (found, round_to_codes(weight))
    errors = [(x @ (w - weight).T.double()).square().mean().sqrt() for w in rounded]
    assert errors[0] < (0.5 if correlated else 1.001) * errors[1]
