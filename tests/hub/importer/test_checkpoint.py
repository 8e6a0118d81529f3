import io
import pickle
import struct
import zipfile
from collections import OrderedDict
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refused

from objectfolder.base.arrays import torch_problem
from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.models.encoders import read_weights
from objectfolder.hub.importer.checkpoint import read_released

FORMATS = pytest.mark.parametrize("zipped", [True, False], ids=["zip", "older"])


def save(path, values, zipped=True):
    torch.save(values, path, _use_new_zipfile_serialization=zipped)
    return path


@FORMATS
def test_tensors_arrays_and_numbers_come_back(tmp_path, rng, zipped):
    values = {
        "a": {
            "tensor": torch.arange(6.0).reshape(2, 3),
            "half": torch.arange(4).half(),
            "array": rng.normal(size=(4, 3)),
            "columns": np.asfortranarray(rng.normal(size=(3, 2))),
            "big": np.arange(3, dtype=">f4"),
            "int": np.arange(5, dtype=np.int32),
            "scalar": np.float32(0.25),
            "number": 7,
            "list": [1.5, np.float64(2.5), 3],
            "rows": [[1, 2], [3, 4]],
            "mask": torch.tensor([True, False]),
            "bools": np.array([[True], [False]]),
            "state": OrderedDict({"module.x.weight": torch.ones(2)}),
            "parameter": torch.nn.Parameter(torch.ones(3)),
        }
    }
    part = read_released(save(tmp_path / "file.pth", values, zipped)).part("a")
    given = values["a"]
    assert torch.equal(part.tensor("tensor", 2, None), given["tensor"])
    assert part.tensor("half", 4).dtype == torch.float32
    for name, shape in {"array": (4, 3), "columns": (3, 2), "big": (3,), "int": (5,)}.items():
        np.testing.assert_array_equal(part.numbers(name, *shape), given[name])
    np.testing.assert_array_equal(part.numbers("tensor", 2, 3), given["tensor"])
    np.testing.assert_array_equal(part.numbers("list", 3), [1.5, 2.5, 3])
    np.testing.assert_array_equal(part.numbers("rows", None, 2), [[1, 2], [3, 4]])
    assert part.number("scalar") == 0.25
    assert part.integer("number", 0, 9) == 7
    np.testing.assert_array_equal(part.numbers_or_one("scalar", 3), [0.25] * 3)
    assert part.mask("mask", 2).tolist() == part.mask("bools", 2).tolist() == [True, False]
    assert torch.equal(part.state("state").tensor("x.weight", 2), torch.ones(2))
    assert torch.equal(part.tensor("parameter", 3), torch.ones(3))


class Touch:
    """What a pickle runs when it is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (Path(self.path),)


class Evaluate(Touch):
    def __reduce__(self):
        return eval, (f"__import__('pathlib').Path({str(self.path)!r}).touch()",)


@pytest.mark.parametrize("attack", [Touch, Evaluate])
@FORMATS
def test_pickled_calls_are_never_run(tmp_path, attack, zipped):
    trace, bare = tmp_path / "trace", tmp_path / "bare.pth"
    bare.write_bytes(pickle.dumps(attack(trace), protocol=2))
    refused("not a file of tensors", read_released, bare)
    path = save(tmp_path / "file.pth", {"VisionNet": attack(trace)}, zipped)
    refused(r"it names \S+, which is never run", read_released, path)
    assert not trace.exists()
    torch.load(path, weights_only=False)  # it would have
    assert trace.exists()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"v 0 0 0\nv 1 0 0\nf 1 2 3\n", "Unsupported operand 118"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), "Unsupported operand 80"),
        (b"", "EOFError"),
        (b"\x80\x02}q\x00.", "Invalid magic number; corrupt file?"),
    ],
)
def test_the_advice_to_run_what_a_file_holds_is_not_passed_on(tmp_path, content, reason):
    path = tmp_path / "file.pth"
    path.write_bytes(content)
    for read, what, wanted in (
        (read_released, "a file of tensors and numbers", "a released ObjectFile.pth"),
        (read_weights, "a readable checkpoint", ""),
    ):
        assert f"{path} is not {what} ({reason}); expected {wanted}" in refused(None, read, path)


def test_a_reason_in_other_words_of_torch_gives_none_of_its_advice():
    error = pickle.UnpicklingError("Weights only load failed.\n\tRe-run with `weights_only=False`. Or not.")
    assert torch_problem(error) == "torch.save did not write it, or it is damaged"


@FORMATS
def test_numpy_objects_other_than_numbers_are_refused(tmp_path, zipped):
    """Object arrays hold pickles of their own."""
    for n, array in enumerate((np.array([{"a": 1}], object), np.zeros(2, [("a", "f4")]), np.array(["text"]))):
        path = save(tmp_path / f"{n}.pth", {"a": array}, zipped)
        refused("not a file of tensors and numbers", read_released, path)


def test_what_is_read_does_not_outlive_the_reading(tmp_path):
    """Other readers in the process accept no more than before."""
    before = set(torch.serialization.get_safe_globals())
    read_released(save(tmp_path / "file.pth", {"a": np.ones(2)}))
    assert set(torch.serialization.get_safe_globals()) == before


def test_tensors_larger_than_the_file_are_refused(tmp_path):
    """A stride of zero, or a list that holds another many times, stands for any size."""
    lists = [0.0] * 100
    for _ in range(8):
        lists = [lists] * 100
    values = {"a": torch.zeros(1).expand(10**6, 10**6), "b": lists, "c": [[0.0] * 100] * 1000}
    part = read_released(save(tmp_path / "file.pth", values))
    refused("file.pth: a is ", part.tensor, "a", None, None)
    for name, *shape in (("b", None, None), ("c", 1000, 100), ("a", 10**6, 10**6)):
        refused(f"file.pth: {name} is ", part.numbers, name, *shape)


def test_compressed_archives_are_refused(tmp_path):
    path, packed = save(tmp_path / "file.pth", {"a": torch.zeros(1 << 20)}), tmp_path / "packed.pth"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.infolist():
            target.writestr(entry.filename, source.read(entry))
    refused("compressed", read_released, packed)


def test_files_that_are_none_are_errors(tmp_path):
    for name, data in {"empty": b"", "text": b"hello " * 100, "zip": b"PK\x03\x04" + bytes(100)}.items():
        path = tmp_path / name
        path.write_bytes(data)
        refused(name, read_released, path)
    refused("does not exist", read_released, tmp_path / "none")
    refused("holds a tensor of float32", read_released, save(tmp_path / "tensor", torch.zeros(2)))

    folder = refused(None, read_released, tmp_path)
    assert folder == f"{tmp_path} is a folder; expected a file such as {tmp_path}/ObjectFile.pth"


def test_errors_name_the_key_and_what_is_there(tmp_path):
    inner = {"nan": torch.tensor([np.nan]), "int": torch.arange(3), "inf": np.inf, "text": "x"}
    values = {"a": {"b": inner, "sparse": torch.eye(2).to_sparse()}}
    part = read_released(save(tmp_path / "file.pth", values)).part("a")
    inner = part.part("b")
    for message, ask, *arguments in (
        (r"a\.b\.c is missing; .* a float tensor of shape .*holds inf, int, nan", inner.tensor, "c"),
        (r"a\.b\.nan is values that are not finite", inner.tensor, "nan", 1),
        (r"a\.b\.int is a tensor of int64, shape .3,.; expected a float tensor", inner.tensor, "int", 3),
        (r"shape \(1,\); expected a float tensor of shape \(2, any\)", inner.tensor, "nan", 2, None),
        (r"a\.b\.inf is values that are not finite", inner.number, "inf"),
        (r"a\.b\.text is of type str; expected a number", inner.number, "text"),
        (r"a\.sparse is a tensor", part.tensor, "sparse", 2, 2),
        (r"a\.sparse is a tensor of float32, shape .*; expected a dictionary", part.part, "sparse"),
    ):
        refused(message, ask, *arguments)


@cache  # the older format names tensors by their addresses, whose lengths differ
def whole_bytes(zipped):
    values = {"a": {"b": torch.ones(4), "c": np.ones(3), "d": np.float64(2)}}
    return save(io.BytesIO(), values, zipped).getvalue()


@given(st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_bytes_are_errors_or_read(tmp_path, data):
    raw = bytearray(whole_bytes(data.draw(st.booleans())))
    for _ in range(data.draw(st.integers(1, 8))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "file.pth"
    path.write_bytes(bytes(raw[: data.draw(st.integers(len(raw) // 2, len(raw)))]))
    with suppress(ObjectFolderError):
        part = read_released(path).part("a")
        assert part.tensor("b", 4).shape == (4,)
        assert part.numbers("c", 3).shape == (3,)


def test_a_file_that_claims_a_large_tensor_takes_no_memory(tmp_path):
    """The older format makes room for what it is told."""
    raw = save(io.BytesIO(), {"a": torch.ones(3)}, zipped=False).getvalue()
    assert raw.count(struct.pack("<q", 3)) >= 1  # how many numbers follow
    path = tmp_path / "file.pth"
    path.write_bytes(raw.replace(struct.pack("<q", 3), struct.pack("<q", 1 << 50)))
    refused(r"file\.pth", lambda: read_released(path).tensor("a", 3))
