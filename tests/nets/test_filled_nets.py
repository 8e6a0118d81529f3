"""Stored nets are loaded as they are, whatever the default type and device of torch are."""

from contextlib import contextmanager

import numpy as np
import pytest
import torch
from test_on_a_device import NETS

from objectfolder import ObjectFile


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


DEFAULTS = pytest.mark.parametrize(
    ("dtype", "device"), [(torch.float64, "cpu"), (torch.float16, "cpu"), (torch.float32, "meta")]
)


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
