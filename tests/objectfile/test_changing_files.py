"""What happens to a file after `load` changes no answer; what a file says twice is refused."""

import copy
import io
import json
import os
import pickle
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from refusals import refused

from objectfolder import ObjectFile
from objectfolder.base.arrays import (
    open_safetensors,
    read_npz,
    read_rows,
    read_safetensors,
    write_safetensors,
)
from objectfolder.base.errors import ObjectFolderError

TOP, UP = [[0.0, 0.0, 0.015]], [[0.0, 0.0, 1.0]]


def answers(file):
    return (
        file.view([2.0, 1.0, 1.0], [0.5, 0.5, 0.9], 16),
        file.impact(TOP, UP, duration=0.05),
        file.touch(TOP),
    )


def assert_same(found, expected):
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.fixture
def path(brick_path, tmp_path):
    (tmp_path / "file.safetensors").write_bytes(brick_path.read_bytes())
    return tmp_path / "file.safetensors"


def test_a_file_that_changes_after_it_was_loaded_changes_no_answer(brick, path):
    """Written over in place with another of the same layout, cut off, deleted; nor do its tensors."""
    files = [ObjectFile.load(path) for _ in range(4)]
    tensors, header = read_safetensors(path)
    write_safetensors(path.with_name("other"), {name: value * 0 for name, value in tensors.items()}, header)
    with path.open("r+b") as stream:
        stream.write(path.with_name("other").read_bytes())
    assert_same(answers(files[0]), answers(brick))
    os.truncate(path, 100)
    assert_same(answers(files[1]), answers(brick))
    path.unlink()
    assert_same(answers(files[2]), answers(brick))
    for name in files[3].tensors:
        files[3].tensors[name][...] = 0
    assert_same(answers(files[3]), answers(brick))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda file: pickle.loads(pickle.dumps(file))])
@pytest.mark.parametrize("asked", [False, True])
def test_a_copy_answers_the_same_without_the_file(brick, path, copied, asked):
    file = ObjectFile.load(path)
    if asked:
        answers(file)
    twin = copied(file)
    path.unlink()
    assert_same(answers(twin), answers(brick))
    assert twin.header == brick.header
    twin.save(path)
    assert_same(answers(ObjectFile.load(path)), answers(brick))


WORKERS = """
import sys
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from objectfolder import ObjectFile

class Sounds(Dataset):
    def __init__(self, file, points):
        self.file, self.points = file, points
    def __len__(self):
        return len(self.points)
    def __getitem__(self, row):
        return self.file.impact(self.points[row], [0, 0, 1.0], duration=0.05)[0]

if __name__ == "__main__":
    torch.set_num_threads(2)
    points = [[x / 200, 0, 0.015] for x in range(-4, 4)]
    sounds = {}
    for method in ("fork", "spawn"):
        data = Sounds(ObjectFile.load(sys.argv[1]), points)
        loader = DataLoader(data, 4, num_workers=1, multiprocessing_context=method, timeout=60)
        sounds[method] = torch.cat(list(loader)).numpy()
    expected = np.stack([data[row] for row in range(len(data))])
    assert np.abs(expected).max() > 0
    for found in sounds.values():
        np.testing.assert_array_equal(found, expected)
    print("same")
"""


@pytest.mark.slow
def test_workers_of_a_data_loader_answer_the_same(path, tmp_path):
    (tmp_path / "workers.py").write_text(WORKERS)
    done = subprocess.run(
        [sys.executable, tmp_path / "workers.py", path], capture_output=True, text=True, timeout=180
    )
    assert (done.stdout, done.returncode) == ("same\n", 0), done.stderr


def twice(path, name):
    """Write a safetensors file that names something twice."""
    content = path.read_bytes()
    length = struct.unpack("<Q", content[:8])[0]
    header, body = content[8 : 8 + length].decode().rstrip(), content[8 + length :]
    if name == "scale":
        described = json.loads(header)
        text = described["__metadata__"]["objectfolder"]
        described["__metadata__"]["objectfolder"] = f'{{"scale": 5.0, {text[1:]}'
        header = json.dumps(described)
    elif name == "__metadata__":
        header = header[:-1] + ', "__metadata__": {"objectfolder": "{}"}}'
    else:
        header = header[:-1] + f', "{name}": {json.dumps(json.loads(header)[name])}}}'
    raw = header.encode()
    path.write_bytes(struct.pack("<Q", len(raw)) + raw + body)


@pytest.mark.parametrize(
    ("name", "said"),
    [*((name, f": it holds '{name}' 2 times") for name in ("scale", "audio.damping")), ("__metadata__", "")],
)
def test_an_object_file_that_names_something_twice_is_refused(path, name, said):
    twice(path, name)
    refused(f"nor another readable safetensors file{said}", ObjectFile.load, path)


def test_a_query_file_that_names_something_twice_is_refused(tmp_path):
    content = io.BytesIO()
    np.save(content, np.zeros((2, 3)), allow_pickle=False)
    raw = content.getvalue()
    # The second of two shapes is the one that numpy takes; spaces make room.
    text = raw[10:128].decode().replace("{", "{'shape': (1, 3), ", 1)[:117].encode() + b"\n"
    (tmp_path / "q.npy").write_bytes(raw[:10] + text + raw[128:])
    assert np.load(tmp_path / "q.npy", allow_pickle=False).shape == (2, 3)
    refused(r"q\.npy is not a .npy file of numbers: .*a name twice", read_rows, tmp_path / "q.npy", 3)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_arrays_of_one_name_are_refused(tmp_path):
    content = io.BytesIO()
    np.save(content, np.zeros(2), allow_pickle=False)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for _ in range(2):
            archive.writestr("x.npy", content.getvalue())
    refused(r"a\.npz is damaged \(it holds 'x' 2 times", read_npz, tmp_path / "a.npz", "x")


def test_a_type_of_numbers_that_numpy_lacks_is_an_error_of_its_tensor(tmp_path):
    body = json.dumps({"a": {"dtype": "BF16", "shape": [2], "data_offsets": [0, 4]}}).encode()
    (tmp_path / "b.safetensors").write_bytes(struct.pack("<Q", len(body)) + body + bytes(4))
    tensors, _ = open_safetensors(tmp_path / "b.safetensors")
    with pytest.raises(ObjectFolderError, match=r"b\.safetensors: tensor a holds BF16, expected one of"):
        tensors["a"]
    assert "b" not in tensors


def test_tensors_of_all_types_and_shapes_come_back(tmp_path):
    kinds = "?", "<f8", "<f4", "<f2", "<i8", "<i4", "<i2", "<i1", "<u8", "<u4", "<u2", "<u1"
    shapes = (0,), (3,), (2, 0, 3), (2, 3)
    given = {f"{kind}{shape}": np.ones(shape, kind) for kind in kinds for shape in shapes}
    write_safetensors(tmp_path / "t.safetensors", given, {})
    back, _ = open_safetensors(tmp_path / "t.safetensors")
    assert list(back) == sorted(given)
    for name, value in given.items():
        np.testing.assert_array_equal(back[name], value, strict=True)


@pytest.mark.parametrize("device", ["cuda:99", "nonsense", "meta", 3.5, None, object()])
def test_a_device_that_torch_cannot_use_is_refused_at_once(path, device):
    refused(r"device is .*which torch cannot use here", ObjectFile.load, path, device=device)
