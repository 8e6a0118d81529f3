import json

import numpy as np
import pytest

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.observations import Observations
from objectfolder.benchmarks.datasets.sampling import sample_observations
from objectfolder.objectfile.file import ObjectFile

COUNT, SIDE = 10, 8


@pytest.fixture(scope="module")
def folders(brick, tmp_path_factory):
    """Three bricks of other sizes and names."""
    root = tmp_path_factory.mktemp("observations")
    for key, scale in (("own_brick", 0.05), ("die", 0.1), ("mug", 0.2)):
        file = ObjectFile(brick.header | {"key": key, "scale": scale}, dict(brick.tensors))
        sample_observations(file, COUNT, SIDE, 0, root / key)
    return {path.name: path for path in root.iterdir()}


@pytest.fixture
def copied(folders, tmp_path):
    for key, folder in folders.items():
        (tmp_path / key).mkdir()
        for path in folder.iterdir():
            (tmp_path / key / path.name).write_bytes(path.read_bytes())
    return {key: tmp_path / key for key in folders}


def test_objects_are_in_the_order_of_labels(folders):
    table = Observations(folders)
    assert table.keys == ("mug", "die", "own_brick")
    assert (table.count, len(table)) == (10, 30)
    assert table.labels.dtype == np.int64
    assert table.labels.tolist() == [0] * 10 + [1] * 10 + [2] * 10
    assert [table.records[key]["scale"] for key in table.keys] == [0.2, 0.1, 0.05]


@pytest.mark.parametrize("modality", ["vision", "audio", "touch"])
def test_rows_are_read_in_any_order_and_twice(folders, modality, rng):
    table = Observations(folders)
    whole = np.concatenate(
        [np.load(folders[key] / f"{modality}.npy", allow_pickle=False) for key in table.keys]
    )
    rows = rng.permutation(np.repeat(np.arange(30), 2))
    found = table.read(modality, rows)
    assert found.dtype == whole.dtype
    assert found.flags.writeable
    assert (found == whole[rows]).all()
    assert table.shape(modality) == whole.shape[1:]
    assert table.read(modality, np.zeros(0, np.int64)).shape == (0, *whole.shape[1:])


@pytest.mark.parametrize("row", [-1, 30])
def test_rows_that_are_not_there(folders, row):
    with pytest.raises(IndexError, match=f"row {row} of 30"):
        Observations(folders).read("audio", np.array([0, row]))


def test_unknown_modality(folders):
    with pytest.raises(ObjectFolderError, match="no array 'smell', expected one of vision, audio, touch"):
        Observations(folders).read("smell", np.array([0]))


def test_digest_is_of_what_is_in_the_folders(folders, copied):
    digest = Observations(folders).digest
    assert Observations(dict(reversed(copied.items()))).digest == digest
    without = {key: folder for key, folder in copied.items() if key != "die"}
    assert Observations(without).digest != digest
    record = json.loads((copied["die"] / "observations.json").read_text())
    record["arrays"]["audio"]["sha256"] = "0" * 64
    (copied["die"] / "observations.json").write_text(json.dumps(record))
    assert Observations(copied).digest != digest


def test_queries_are_those_of_the_object(folders):
    queries = Observations(folders).queries("mug")
    assert queries["audio_force"].shape == (10, 3)
    assert np.abs(queries["touch_point"]).max() > 0.05  # of the largest brick


def test_no_objects():
    with pytest.raises(ObjectFolderError, match="no objects given"):
        Observations({})


def test_incomplete_folder_is_refused(copied):
    (copied["die"] / "observations.json").unlink()
    with pytest.raises(ObjectFolderError, match=f"die: {copied['die']} holds no complete observations"):
        Observations(copied)


@pytest.mark.parametrize("cut", [0, 5, 100, -1])
def test_damaged_array_is_refused(copied, cut):
    path = copied["die"] / "audio.npy"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ObjectFolderError, match=f"die: {path} is damaged"):
        Observations(copied)


def test_array_of_another_shape_is_refused(copied):
    path = copied["die"] / "audio.npy"
    np.save(path, np.zeros((10, 31999), np.float32))
    with pytest.raises(ObjectFolderError, match=r"has shape \(10, 31999\), expected \(10, 32000\)"):
        Observations(copied)


def test_array_of_objects_is_not_unpickled(copied):
    path = copied["die"] / "touch.npy"
    np.save(path, np.array([{}], object), allow_pickle=True)
    with pytest.raises(ObjectFolderError, match=f"die: {path} is damaged"):
        Observations(copied)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is damaged"),
        ("[]", "has version None, expected 1"),
        ('{"version": 0}', "has version 0, expected 1"),
    ],
)
def test_foreign_record_is_refused(copied, text, message):
    (copied["die"] / "observations.json").write_text(text)
    with pytest.raises(ObjectFolderError, match=message):
        Observations(copied)


def test_folder_of_another_object_is_refused(folders):
    with pytest.raises(ObjectFolderError, match="holds observations of mug, expected those of bell"):
        Observations({"bell": folders["mug"], "die": folders["die"]})


@pytest.mark.parametrize(("count", "side", "what"), [(20, SIDE, "vision"), (COUNT, 9, "vision")])
def test_objects_that_were_sampled_differently_are_refused(brick, folders, tmp_path, count, side, what):
    file = ObjectFile(brick.header | {"key": "bell"}, dict(brick.tensors))
    sample_observations(file, count, side, 0, tmp_path)
    message = rf"bell: {what} has shape \({count}, {side}, {side}, 3\), that of mug"
    with pytest.raises(ObjectFolderError, match=message):
        Observations({"bell": tmp_path, **folders})
