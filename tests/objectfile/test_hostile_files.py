"""Files that somebody made up are refused with a message, or answer with finite numbers."""

import copy
import math
import resource

import numpy as np
import psutil
import pytest
from damage import leaves
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.arrays import read_rows, read_safetensors, write_safetensors
from objectfolder.base.errors import ObjectFolderError
from objectfolder.stored.header import checked_header
from objectfolder.stored.kinds import checked_nets

quick = settings(deadline=None, suppress_health_check=list(HealthCheck))

WORDS = st.sampled_from(
    ["kind", "net", "gains", "surface", "image", "geometry", "format", "1.0", "none", "../x"]
)
NUMBERS = st.one_of(st.integers(-(2**70), 2**70), st.floats(allow_nan=False, allow_infinity=False))
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=8), WORDS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.one_of(WORDS, st.text(max_size=4)), inner, max_size=5)
    ),
    max_leaves=12,
)


QUESTIONS = (
    lambda file: file.impact([[0, 0, 0.015]], [[0, 0, 1.0]], duration=0.01),
    lambda file: file.touch([[0, 0, 0.015]], 0.0005),
    lambda file: file.nearest([[0, 0, 0.015]])[0],
    lambda file: file.frequencies,
)
#: What a number of a header may be turned into.
EXTREMES = (-1e300, -1, 0, 5e-324, 1e-300, 1e-9, 0.3, 1, 3, 1000, 10**6, 10**9, 1e300, 2**70)


@pytest.fixture
def two_gigabytes_more():
    """Whoever asks for more gets a MemoryError, and the machine lives on."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + 2**31, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def refused_or_finite(path):
    """Ask everything of a file."""
    for question in QUESTIONS:
        try:
            answer = question(ObjectFile.load(path))
        except ObjectFolderError:
            continue
        assert np.isfinite(answer).all()


@quick
@given(JSON)
def test_any_header_is_refused_or_one(value):
    try:
        found = checked_nets(checked_header(value, "x"), "x")
    except ObjectFolderError:
        return
    assert found == value


@pytest.mark.filterwarnings("ignore")
@quick
@given(data=st.data())
def test_a_changed_file_is_refused_or_answers_finitely(
    brick_path, tmp_path_factory, two_gigabytes_more, data
):
    tensors, header = read_safetensors(brick_path)
    header = copy.deepcopy(header)
    for _ in range(data.draw(st.integers(0, 2))):
        container, key = data.draw(st.sampled_from(leaves(header)))
        container[key] = data.draw(JSON)
    if data.draw(st.booleans()):
        name = data.draw(st.sampled_from(sorted(tensors)))
        shapes = st.one_of(st.just(tensors[name].shape), array_shapes(min_dims=0, max_dims=3, max_side=40))
        tensors[name] = data.draw(arrays(tensors[name].dtype, shapes))
    path = tmp_path_factory.mktemp("hostile") / "file.safetensors"
    write_safetensors(path, tensors, header)
    refused_or_finite(path)


def test_weights_that_overflow_are_damage(brick):
    overflowing = {"vision.grid.factors": 2e38, "audio.output.weight_exponent": 127}
    tensors = {name: np.full_like(brick.tensors[name], value) for name, value in overflowing.items()}
    file, view = ObjectFile(brick.header, {**brick.tensors, **tensors}), ([1.5, 1.0, 1.0], [0.5, 0.5, 0.9], 8)
    for question, asked in ((file.view, view), (file.render, view), (file.mode_shapes, [[[0, 0, 0.015]]])):
        refused("is damaged: it gives values that are not finite", question, *asked)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_every_number_of_a_header_is_refused_or_answers_finitely(brick_path, tmp_path, two_gigabytes_more):
    tensors, header = read_safetensors(brick_path)
    for place, (container, key) in enumerate(leaves(header)):
        if isinstance(container[key], bool) or not isinstance(container[key], int | float):
            continue
        for value in EXTREMES:
            changed = copy.deepcopy(header)
            inner, name = leaves(changed)[place]
            inner[name] = value
            write_safetensors(tmp_path / "file.safetensors", tensors, changed)
            refused_or_finite(tmp_path / "file.safetensors")


@quick
@given(content=st.binary(max_size=200), length=st.integers(0, 2**64 - 1))
def test_any_bytes_are_no_object_file_and_no_queries(tmp_path_factory, content, length):
    path = tmp_path_factory.mktemp("hostile") / "bytes"
    for raw in (content, length.to_bytes(8, "little") + content, b"\x93NUMPY\x01\x00" + content):
        path.write_bytes(raw)
        refused("bytes", ObjectFile.load, path)
        refused("bytes", read_rows, path, 3)


@pytest.mark.parametrize(
    ("shape", "dtype", "message"),
    [
        ((2**50, 3), "<f8", "too short for an array of shape"),
        ((-1, 3), "<f8", "is not a .npy file of numbers"),
        ((2, 3), "|O", "holds object, expected real numbers"),
        ((2, 3), "<c16", "holds complex128, expected real numbers"),
        ((2, 4), "<f8", r"has shape \(2, 4\), expected \(N, 3\)"),
    ],
)
def test_a_query_file_takes_no_more_memory_than_it_holds(tmp_path, shape, dtype, message):
    text = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    raw = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(48)
    (tmp_path / "q.npy").write_bytes(raw)
    refused(message, read_rows, tmp_path / "q.npy", 3)


def test_a_header_that_no_json_can_hold_is_refused(brick):
    for value in (math.inf, -math.inf, math.nan):
        refused("its header is not JSON", ObjectFile, {**brick.header, "weight": value}, brick.tensors)
