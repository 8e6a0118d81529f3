"""Which objects of a release an index, a key or a mask gives."""

import csv
import dataclasses

import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.dataset import COLUMNS, INDEX, OBJECTS, Dataset, IndexEntry
from objectfolder.objectfile.file import ObjectFile

KEYS = ("ball", "brick", "cup", "mug")
MATERIALS = ("wood", "plastic", "steel", "steel")


@pytest.fixture
def dataset(tmp_path, brick):
    """Four objects, of which only the brick has a file."""
    blank = {name: "" if kind is str else 0 for name, kind in COLUMNS.items()}
    blank |= {"split": "test", "sha256": 64 * "0", "licence": "CC0-1.0", "bytes": 1, "lowest_hz": 20.0}
    entries = [
        IndexEntry(
            **blank | {"key": key, "path": f"{OBJECTS}/{key}", "material": material, "size": 0.1 * place}
        )
        for place, (key, material) in enumerate(zip(KEYS, MATERIALS), 1)
    ]
    with (tmp_path / INDEX).open("w", newline="") as stream:
        rows = csv.DictWriter(stream, list(COLUMNS))
        rows.writeheader()
        rows.writerows(map(dataclasses.asdict, entries))
    (tmp_path / OBJECTS).mkdir()
    brick.save(tmp_path / OBJECTS / "brick")
    return Dataset(tmp_path)


@pytest.mark.parametrize(
    ("which", "keys"),
    [
        ([2, 0], "cup ball"),
        ([], ""),
        (np.array([0, -1]), "ball mug"),
        (np.array([], int), ""),
        (torch.tensor([3, 3]), "mug mug"),
        (["mug", 1], "mug brick"),
        ([False, True, True, False], "brick cup"),
        (np.array([True, False, False, True]), "ball mug"),
        (torch.tensor([False] * 4), ""),
        ([np.True_, np.False_, np.False_, np.False_], "ball"),
        (slice(None, None, 2), "ball cup"),
    ],
)
def test_a_list_an_array_or_a_mask_gives_a_dataset(dataset, which, keys):
    part = dataset[which]
    assert isinstance(part, Dataset)
    assert part.keys == tuple(keys.split())
    assert part.filter(material="steel").keys == tuple(key for key in part.keys if key in ("cup", "mug"))


@pytest.mark.parametrize("which", [1, -3, "brick", np.int64(1), np.array(1), torch.tensor(1)])
def test_a_number_or_a_key_gives_an_object(dataset, which):
    assert dataset[which].key == "brick"


@pytest.mark.parametrize(
    ("which", "error", "message"),
    [
        (10000, IndexError, "no object 10000; the dataset has 4"),
        (-5, IndexError, "no object -5; the dataset has 4"),
        ([0, 4], IndexError, "no object 4; the dataset has 4"),
        (np.array([True, False]), IndexError, "a mask of 2 objects; the dataset has 4"),
        (1.0, TypeError, "not indexed by 1.0; expected a number, a key, a slice, or a list or array of"),
        (None, TypeError, "not indexed by None"),
        (b"mug", TypeError, "not indexed by b'mug'"),
        ((0, 1), TypeError, r"not indexed by \(0, 1\)"),
        (np.array([0.5]), TypeError, "not indexed by 0.5"),
        (np.eye(4, dtype=int), TypeError, r"not indexed by \[1, 0, 0, 0\]"),
        ("vase", ObjectFolderError, "no object 'vase'; it has ball, brick, cup, mug"),
        (["mug", "vase"], ObjectFolderError, "no object 'vase'"),
    ],
)
def test_what_is_no_object_is_refused_with_the_dataset_named(dataset, which, error, message):
    with pytest.raises(error, match=f"^{dataset.folder}: .*{message}"):
        dataset[which]


def test_objects_are_found_by_key_without_reading_files(dataset, brick, monkeypatch):
    monkeypatch.setattr(ObjectFile, "load", None)
    assert (dataset.index("cup"), dataset.index(brick), dataset.index("mug", 2, 4)) == (2, 1, 3)
    assert (dataset.count(brick), dataset.count("vase"), dataset[["mug", "mug"]].count("mug")) == (1, 0, 2)
    assert brick in dataset
    assert brick not in dataset[2:]
    assert 1 not in dataset
    for absent in (lambda: dataset.index("vase"), lambda: dataset[2:].index(brick), lambda: dataset.index(3)):
        with pytest.raises(ValueError, match=r"no object ('vase'|'brick'|3); it has .*cup, mug"):
            absent()
    with pytest.raises(ValueError, match="no object 'mug'"):
        dataset.index("mug", 0, 3)


@pytest.mark.parametrize("values", [3, [None], lambda entry: True, ["steel", 3]])
def test_a_filter_that_is_no_text_is_refused(dataset, values):
    refused(r"material is .*, expected a text or several; .* a mask", dataset.filter, material=values)
    small = dataset[[entry.size < 0.25 for entry in dataset.entries]]
    assert small.keys == ("ball", "brick")
