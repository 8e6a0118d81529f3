"""Samples of several objects are read as one table, whatever they are of; what is not whole is refused."""

import json
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from refusals import refused

from objectfolder.benchmarks.datasets.grasps import ARRAYS, FORMAT, Grasps
from objectfolder.benchmarks.datasets.observations import Observations, certain_observations
from objectfolder.benchmarks.datasets.samples import Samples

COUNT = 10
SHAPES = {"image": (6, 8, 3), "touch": (2, 5, 4, 3), "explicit": (2, 5, 4, 3), "offset": (3,)}


class Kind(NamedTuple):
    """What is read, and how it is stored."""

    read: Callable[..., Samples]
    name: str
    record: str
    arrays: dict[str, tuple[str, tuple[int, ...]]]  # types and shapes of rows
    says: dict[str, object]  # in the record
    again: str


OBSERVED = {"vision": ("uint8", (8, 8, 3)), "audio": ("float32", (400,)), "touch": ("uint8", (5, 4, 3))}
WHOLE = {"arrays": {name: {"shape": [COUNT, *shape]} for name, (_, shape) in OBSERVED.items()}}
KINDS = [
    Kind(*(Observations, "observations", "observations.json", OBSERVED), {"version": 1, **WHOLE}, "sample"),
    Kind(
        *(
            Grasps,
            "grasps",
            "record.json",
            {name: (kind, SHAPES.get(name, ())) for name, (kind, _) in ARRAYS.items()},
        ),
        *({"format": FORMAT, "digest": "of all"}, "collect"),
    ),
]
SEEN, HELD = KINDS


@pytest.fixture(params=KINDS, ids=[kind.name for kind in KINDS])
def kind(request):
    return request.param


def change_record(kind, folder, **changes):
    path = folder / kind.record
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def load(folder, name):
    return np.load(folder / f"{name}.npy", allow_pickle=False)


@pytest.fixture
def folders(kind, tmp_path, rng):
    """Samples of three objects."""
    for key in ("own_thing", "die", "mug"):
        (tmp_path / key).mkdir()
        for name, (dtype, shape) in kind.arrays.items():
            values = rng.integers(2 if dtype == "bool" else 256, size=(COUNT, *shape))
            np.save(tmp_path / key / f"{name}.npy", values.astype(dtype))
        record = {"key": key, "count": COUNT, "material": "wood", **kind.says}
        (tmp_path / key / kind.record).write_text(json.dumps(record))
    return {path.name: path for path in tmp_path.iterdir()}


def test_objects_are_in_the_order_of_labels(kind, folders):
    table = kind.read(folders)
    assert table.keys == ("mug", "die", "own_thing")
    assert (table.count, len(table)) == (10, 30)
    assert table.labels.dtype == np.int64
    assert table.labels.tolist() == [0] * 10 + [1] * 10 + [2] * 10
    assert [table.records[key]["key"] for key in table.keys] == [*table.keys]
    if kind is HELD:
        assert table.has_explicit
        assert table.success.dtype == bool
        assert (table.success == np.concatenate([load(folders[key], "success") for key in table.keys])).all()


def test_rows_are_read_in_any_order_and_twice(kind, folders, rng):
    table = kind.read(folders)
    for name in kind.arrays:
        whole = np.concatenate([load(folders[key], name) for key in table.keys])
        rows = rng.permutation(np.repeat(np.arange(30), 2))
        found = table.read(name, rows)
        assert found.dtype == whole.dtype
        assert found.flags.writeable
        assert (found == whole[rows]).all()
        assert table.shape(name) == whole.shape[1:]
        assert table.read(name, np.zeros(0, np.int64)).shape == (0, *whole.shape[1:])


def test_rows_and_arrays_that_are_not_there(kind, folders):
    table, (first, *_) = kind.read(folders), kind.arrays
    for row in (-1, 30):
        with pytest.raises(IndexError, match=f"row {row} of 30"):
            table.read(first, np.array([0, row]))
    refused(f"no array 'smell', expected one of {', '.join(kind.arrays)}", table.read, "smell", np.array([0]))


def test_digest_is_of_what_is_in_the_folders(kind, folders):
    digest = kind.read(folders).digest
    assert kind.read(dict(reversed(folders.items()))).digest == digest
    assert kind.read({key: folder for key, folder in folders.items() if key != "die"}).digest != digest
    change_record(kind, folders["die"], digest="of others")
    assert kind.read(folders).digest != digest


def test_folders_that_are_not_there_whole_or_of_others(kind, folders):
    refused("no objects given", kind.read, {})
    other = {"bell": folders["mug"], "die": folders["die"]}
    refused(f"holds {kind.name} of mug, expected those of bell", kind.read, other)
    (folders["die"] / kind.record).unlink()
    refused(rf"die: {folders['die']} holds no complete {kind.name} .*; {kind.again}", kind.read, folders)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (SEEN, "{", "is damaged"),
        (SEEN, "[]", "has version None, expected 1"),
        (SEEN, '{"version": 0}', "has version 0, expected 1; sample the object again"),
        (HELD, "{", "is damaged"),
        (HELD, "[]", "has format None, expected 'objectfolder grasps 1'"),
        (HELD, '{"format": "objectfolder grasps 0"}', "has format 'objectfolder grasps 0'"),
        (HELD, f'{{"format": "{FORMAT}", "key": "die", "count": 0}}', "lacks count and digest; collect"),
    ],
    indirect=["kind"],
)
def test_foreign_record_is_refused(kind, folders, text, message):
    (folders["die"] / kind.record).write_text(text)
    refused(message, kind.read, folders)


@pytest.mark.parametrize("cut", [0, 5, 100, -1, None])
def test_damaged_array_is_refused(kind, folders, cut):
    path = folders["die"] / "touch.npy"
    content = path.read_bytes()
    path.unlink()
    if cut is not None:
        path.write_bytes(content[:cut])
    refused(f"die: {path} is damaged .*{kind.again}", kind.read, folders)


@pytest.mark.parametrize(
    ("kind", "name", "array", "message"),
    [
        (SEEN, "audio", np.zeros((10, 399), np.float32), r"has shape \(10, 399\), expected \(10, 400\)"),
        (SEEN, "touch", np.array([{}], object), "is damaged"),
        (HELD, "success", np.zeros(COUNT), r"holds float64 of shape \(10,\), expected bool of \(10\)"),
        (HELD, "soft", np.zeros(9, np.float32), r"expected float32 of \(10\)"),
        (HELD, "width", np.full(COUNT, np.nan, np.float32), "not finite"),
        (HELD, "touch", np.zeros((COUNT, 3, 5, 4, 3), np.uint8), r"uint8 of \(10, 2, any, any, 3\)"),
        (HELD, "image", np.zeros((COUNT, 6, 8), np.uint8), r"expected uint8 of \(10, any, any, 3\)"),
        (HELD, "image", np.zeros((COUNT, 6, 9, 3), np.uint8), r"die: image has shape .*that of mug"),
        (HELD, "explicit", np.array([{}], object), "is damaged"),
    ],
    indirect=["kind"],
)
def test_other_contents_are_refused(kind, folders, name, array, message):
    np.save(folders["die"] / f"{name}.npy", array, allow_pickle=True)
    refused(message, kind.read, folders)


def test_objects_with_other_numbers_of_samples_are_refused(kind, folders):
    for name in kind.arrays:
        np.save(folders["die"] / f"{name}.npy", np.repeat(load(folders["die"], name), 2, 0))
    more = {name: {"shape": [2 * COUNT, *shape]} for name, (_, shape) in kind.arrays.items()}
    change_record(kind, folders["die"], count=2 * COUNT, arrays=more)
    first = next(iter(kind.arrays))
    refused(rf"die: {first} has shape \(20,.*\), that of mug \(10,.*same settings", kind.read, folders)


@pytest.mark.parametrize("kind", [HELD], indirect=True)
def test_explicit_touches_are_there_for_all_objects_or_none_and_of_one_shape(kind, folders):
    for folder in folders.values():
        np.save(folder / "explicit.npy", np.zeros((COUNT, 2, 5, 5, 3), np.uint8))
    refused("mug: explicit touches have shape", kind.read, folders)
    for key in ("die", "mug"):
        (folders[key] / "explicit.npy").unlink()
    refused(r"mug, die: no explicit touches .*for all objects or for none", kind.read, folders)
    (folders["own_thing"] / "explicit.npy").unlink()
    grasps = Grasps(folders)
    assert not grasps.has_explicit
    refused("no array 'explicit'", grasps.read, "explicit", np.array([0]))


@pytest.mark.parametrize("kind", [SEEN], indirect=True)
def test_objects_whose_sound_is_marked_uncertain_are_left_out_of_tasks_that_use_sound(kind, folders):
    plain = certain_observations(folders)
    assert (plain.keys, plain.uncertain, plain.digest) == (
        ("mug", "die", "own_thing"),
        (),
        kind.read(folders).digest,
    )
    change_record(kind, folders["die"], uncertain=True)
    assert kind.read(folders).keys == ("mug", "die", "own_thing")
    left = certain_observations(folders)
    assert (left.keys, left.uncertain) == (("mug", "own_thing"), ("die",))
    others = kind.read({key: folder for key, folder in folders.items() if key != "die"})
    assert left.digest == others.digest
    rows = np.arange(len(left))
    np.testing.assert_array_equal(left.read("audio", rows), others.read("audio", rows))
    for folder in folders.values():
        change_record(kind, folder, uncertain=True)
    refused(
        "mug, die, own_thing: the sound of all objects is marked uncertain.*allow",
        certain_observations,
        folders,
    )


@pytest.mark.parametrize("kind", [SEEN], indirect=True)
def test_queries_are_those_of_the_object(kind, folders):
    for number, folder in enumerate(folders.values()):
        np.savez(folder / "queries.npz", touch_point=np.full((COUNT, 3), number))
    queries = [Observations(folders).queries(key)["touch_point"][0, 0] for key in folders]
    assert queries == [0, 1, 2]
