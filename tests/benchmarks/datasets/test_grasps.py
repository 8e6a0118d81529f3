import json

import numpy as np
import pytest

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.grasps import ARRAYS, FORMAT, Grasps

COUNT = 10
SHAPES = {"image": (6, 8, 3), "touch": (2, 5, 4, 3), "explicit": (2, 5, 4, 3), "offset": (3,)}


@pytest.fixture
def folders(tmp_path, rng):
    """Grasps of three objects."""
    for key in ("own_thing", "die", "mug"):
        (tmp_path / key).mkdir()
        for name, (dtype, _) in ARRAYS.items():
            values = rng.integers(2 if dtype == "bool" else 256, size=(COUNT, *SHAPES.get(name, ())))
            np.save(tmp_path / key / f"{name}.npy", values.astype(dtype))
        record = {"format": FORMAT, "key": key, "count": COUNT, "digest": f"of {key}", "material": "wood"}
        (tmp_path / key / "record.json").write_text(json.dumps(record))
    return {path.name: path for path in tmp_path.iterdir()}


def test_objects_are_in_the_order_of_labels(folders):
    grasps = Grasps(folders)
    assert grasps.keys == ("mug", "die", "own_thing")
    assert (grasps.count, len(grasps), grasps.has_explicit) == (10, 30, True)
    assert grasps.labels.dtype == np.int64
    assert grasps.labels.tolist() == [0] * 10 + [1] * 10 + [2] * 10
    stored = np.concatenate(
        [np.load(folders[key] / "success.npy", allow_pickle=False) for key in grasps.keys]
    )
    assert grasps.success.dtype == bool
    assert (grasps.success == stored).all()
    assert grasps.records["die"]["material"] == "wood"


@pytest.mark.parametrize("name", ARRAYS)
def test_rows_are_read_in_any_order_and_twice(folders, name, rng):
    grasps = Grasps(folders)
    whole = np.concatenate([np.load(folders[key] / f"{name}.npy", allow_pickle=False) for key in grasps.keys])
    rows = rng.permutation(np.repeat(np.arange(30), 2))
    found = grasps.read(name, rows)
    assert found.dtype == whole.dtype
    assert (found == whole[rows]).all()
    assert grasps.shape(name) == whole.shape[1:]


@pytest.mark.parametrize("row", [-1, 30])
def test_rows_that_are_not_there(folders, row):
    with pytest.raises(IndexError, match=f"row {row} of 30"):
        Grasps(folders).read("width", np.array([0, row]))


def test_unknown_array(folders):
    with pytest.raises(ObjectFolderError, match="no array 'audio', expected one of success, soft, width"):
        Grasps(folders).read("audio", np.array([0]))


def test_digest_is_of_what_is_in_the_folders(folders):
    digest = Grasps(folders).digest
    assert Grasps(dict(reversed(folders.items()))).digest == digest
    assert Grasps({key: folder for key, folder in folders.items() if key != "die"}).digest != digest
    record = json.loads((folders["die"] / "record.json").read_text())
    (folders["die"] / "record.json").write_text(json.dumps(record | {"digest": "of other grasps"}))
    assert Grasps(folders).digest != digest


def test_explicit_touches_are_there_for_all_objects_or_none(folders):
    for key in ("die", "mug"):
        (folders[key] / "explicit.npy").unlink()
    with pytest.raises(
        ObjectFolderError, match=r"mug, die: no explicit touches .*for all objects or for none"
    ):
        Grasps(folders)
    (folders["own_thing"] / "explicit.npy").unlink()
    grasps = Grasps(folders)
    assert not grasps.has_explicit
    with pytest.raises(ObjectFolderError, match="no array 'explicit'"):
        grasps.read("explicit", np.array([0]))


def test_no_objects():
    with pytest.raises(ObjectFolderError, match="no objects given"):
        Grasps({})


def test_incomplete_folder_is_refused(folders):
    (folders["die"] / "record.json").unlink()
    with pytest.raises(ObjectFolderError, match=f"die: {folders['die']} holds no complete grasps"):
        Grasps(folders)


def test_folder_of_another_object_is_refused(folders):
    with pytest.raises(ObjectFolderError, match="holds grasps of mug, expected those of bell"):
        Grasps({"bell": folders["mug"], "die": folders["die"]})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is damaged"),
        ("[]", "has format None, expected 'objectfolder grasps 1'"),
        ('{"format": "objectfolder grasps 0"}', "has format 'objectfolder grasps 0'"),
        (f'{{"format": "{FORMAT}", "key": "die", "count": 0}}', "lacks count and digest; collect"),
    ],
)
def test_foreign_record_is_refused(folders, text, message):
    (folders["die"] / "record.json").write_text(text)
    with pytest.raises(ObjectFolderError, match=message):
        Grasps(folders)


@pytest.mark.parametrize("cut", [0, 5, 100, -1])
def test_damaged_array_is_refused(folders, cut):
    path = folders["die"] / "touch.npy"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ObjectFolderError, match=f"die: {path} is damaged .*collect its grasps again"):
        Grasps(folders)


def test_lacking_array_is_refused(folders):
    (folders["die"] / "width.npy").unlink()
    with pytest.raises(ObjectFolderError, match=r"die: .*width.npy is damaged .*No such file"):
        Grasps(folders)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("success", np.zeros(COUNT), r"holds float64 of shape \(10,\), expected bool of \(10\)"),
        ("soft", np.zeros(9, np.float32), r"expected float32 of \(10\)"),
        ("width", np.full(COUNT, np.nan, np.float32), "not finite"),
        ("touch", np.zeros((COUNT, 3, 5, 4, 3), np.uint8), r"expected uint8 of \(10, 2, any, any, 3\)"),
        ("image", np.zeros((COUNT, 6, 8), np.uint8), r"expected uint8 of \(10, any, any, 3\)"),
        ("image", np.zeros((COUNT, 6, 9, 3), np.uint8), r"die: image has shape .*that of mug"),
        ("explicit", np.array([{}], object), "is damaged"),
    ],
)
def test_other_contents_are_refused(folders, name, array, message):
    np.save(folders["die"] / f"{name}.npy", array, allow_pickle=True)
    with pytest.raises(ObjectFolderError, match=message):
        Grasps(folders)


def test_objects_with_other_numbers_of_grasps_are_refused(folders):
    for name in ARRAYS:
        path = folders["die"] / f"{name}.npy"
        np.save(
            path,
            np.tile(
                np.load(path, allow_pickle=False), (2, *[1] * (np.load(path, allow_pickle=False).ndim - 1))
            ),
        )
    record = json.loads((folders["die"] / "record.json").read_text())
    (folders["die"] / "record.json").write_text(json.dumps(record | {"count": 20}))
    with pytest.raises(ObjectFolderError, match=r"die: success has shape \(20,\), that of mug \(10,\)"):
        Grasps(folders)


def test_touches_of_either_source_have_one_shape(folders):
    for folder in folders.values():
        np.save(folder / "explicit.npy", np.zeros((COUNT, 2, 5, 5, 3), np.uint8))
    with pytest.raises(ObjectFolderError, match="mug: explicit touches have shape"):
        Grasps(folders)
