import hashlib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from ruamel.yaml import YAML

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.splits import (
    Companions,
    Split,
    label_order,
    named_split,
    object_split,
    per_object,
    per_sample,
    repeated_rows,
    without_rows,
)

DATA = files("objectfolder.benchmarks") / "data"
CATALOGS = Path(__file__).parents[3] / "catalogs"
FROZEN = "labels and splits are part of every published score: append objects, never change what is there"
TRAIN, VAL, TEST = ["espresso_mug", "tall_mug", "soup_mug"], ["ramekin"], ["tea_beaker"]


def lines(name):
    return (DATA / name).read_text().splitlines()


def test_the_first_211_lines_of_the_object_list_never_change():
    shipped = "".join(f"{line}\n" for line in lines("objects.csv")[:211])
    digest = "0c68b066801449d293f8c0a5a8cc702fd6e14f0c164144c7d0c678606e1b4c0e"
    assert hashlib.sha256(shipped.encode()).hexdigest() == digest, FROZEN


def test_the_sample_split_never_changes():
    digest = "7bc2067fe987a7e9d0fffff50bd7e1169c211a8d8b481311f71ac90d0f30e19c"
    assert hashlib.sha256((DATA / "samples.txt").read_bytes()).hexdigest() == digest, FROZEN


def test_object_list_numbers_each_object_once():
    labels, keys, _ = zip(*(line.split(",") for line in lines("objects.csv")[1:]))
    assert [int(label) for label in labels] == list(range(len(keys)))
    assert len(set(keys)) == len(keys)


def test_of_ten_consecutive_objects_seven_train_one_validates_two_test():
    splits = [line.split(",")[2] for line in lines("objects.csv")[1:]]
    whole = len(splits) // 10 * 10
    for ten in np.reshape(splits[:whole], (-1, 10)):
        assert sorted(ten) == ["test"] * 2 + ["train"] * 7 + ["val"]
    rest = splits[whole:]  # the next objects complete these ten
    assert all(rest.count(name) <= most for name, most in (("train", 7), ("val", 1), ("test", 2)))


def test_every_object_that_the_catalogues_name_has_a_label():
    keys = [line.split(",")[1] for line in lines("objects.csv")[1:]]
    for name in ("procedural", "starter", "objectfolder1", "real"):
        section = "procedural" if name == "procedural" else "objects"
        catalogue = YAML(typ="safe").load(CATALOGS / f"{name}.yaml")
        assert catalogue[section].keys() <= set(keys)


def test_the_hundred_procedural_objects_keep_the_shares_of_the_splits():
    catalogue = YAML(typ="safe").load(CATALOGS / "procedural.yaml")
    splits = [object_split(key) for key in catalogue["procedural"]]
    assert [splits.count(name) for name in ("train", "val", "test")] == [70, 10, 20]


def test_label_order_is_that_of_the_list_then_by_key():
    expected = ("espresso_mug", "tall_mug", "mug", "ant", "zebra")
    assert label_order(["zebra", "tall_mug", "ant", "mug", "espresso_mug"]) == expected


def test_own_objects_are_split_by_their_key_alone_in_about_the_shares_of_the_list():
    splits = [object_split(f"own_{i}") for i in range(2000)]
    for name, share in (("train", 0.7), ("val", 0.1), ("test", 0.2)):
        # Four standard deviations of a binomial share.
        assert abs(splits.count(name) / 2000 - share) < 4 * np.sqrt(share * (1 - share) / 2000)


@pytest.mark.parametrize("count", [10, 80, 500, 1010])
def test_seen_has_eighty_ten_ten_of_every_object(count):
    keys = ["a", "b", "c"]
    split = per_sample(keys, count)
    for rows, share in ((split.train, 8), (split.val, 1), (split.test, 1)):
        assert rows.dtype == np.int64
        assert (np.bincount(rows // count, minlength=3) == share * count // 10).all()
    assert sorted(np.concatenate([split.train, split.val, split.test])) == list(range(3 * count))


def test_seen_splits_the_first_observations_the_same_way_whatever_their_number():
    few, many = per_sample(["a", "b"], 30), per_sample(["a", "b"], 520)
    for name in ("train", "val", "test"):
        first = getattr(many, name)[getattr(many, name) < 30]
        assert first.tolist() == getattr(few, name)[getattr(few, name) < 30].tolist()


def test_seen_repeats_after_five_hundred_observations():
    first, second, *_ = np.split(np.isin(np.arange(2000), per_sample(["a", "b"], 1000).test), 4)
    assert np.array_equal(first, second)


def test_unseen_keeps_test_and_validation_objects_out_of_training():
    keys = label_order([*TRAIN, *VAL, *TEST])
    split = per_object(keys, 20)
    objects = [{keys[i] for i in rows // 20} for rows in (split.train, split.val, split.test)]
    assert objects == [set(TRAIN), set(VAL), set(TEST)]
    assert len(split.train) + len(split.val) + len(split.test) == 100


def test_unseen_without_a_validation_object_validates_with_what_seen_keeps_back():
    keys = label_order([*TRAIN, *TEST])
    unseen, seen = per_object(keys, 20), per_sample(keys, 20)
    training = [keys.index(key) for key in TRAIN]
    assert unseen.val.tolist() == [row for row in seen.val if row // 20 in training]
    assert len(unseen.val) == 3 * 2
    assert not set(unseen.val) & set(unseen.train)
    assert set(unseen.test // 20) == {keys.index("tea_beaker")}
    assert len(unseen.train) == 3 * 18


@pytest.mark.parametrize(("keys", "lacking"), [(TRAIN, "test"), (TEST + VAL, "train")])
def test_unseen_says_which_objects_are_lacking(keys, lacking):
    refused(f"of {', '.join(keys)} none is a {lacking} object; add one", per_object, keys, 20)


@pytest.mark.parametrize(
    ("name", "keys", "count", "message"),
    [
        *((name, [], 10, "objects: none; .* needs two") for name in ("seen", "unseen")),
        *((name, ["mug"], 10, "objects: mug; .* needs two") for name in ("seen", "unseen")),
        *(("seen", "ab", n, f"{n} observations per object, expected a multiple of 10") for n in (0, -10, 15)),
        ("sen", "ab", 10, "'sen' is unknown, expected one of seen, unseen"),
    ],
)
def test_splits_that_cannot_be_made_are_refused(name, keys, count, message):
    refused(message, named_split, name, keys, count)


class Table:
    """Rows of one number, and their objects."""

    def __init__(self, values, labels):
        self.values, self.labels = np.array(values, np.float32), np.array(labels)

    def read(self, modality, rows):
        assert modality == "touch"
        return self.values[rows][:, None]


def rows(*values):
    return np.array(values, np.int64)


def test_planted_copies_within_an_object_are_found():
    split = Split("seen", rows(0, 1, 2, 3), rows(4, 5, 6), rows(7, 8, 9, 10))
    # 5 repeats 1, 7 repeats 0, 9 repeats 4, which validates; 2 and 3, 8 and 10 repeat within a split.
    table = Table([10, 11, 12, 12, 13, 11, 14, 10, 15, 13, 15], [0] * 11)
    repeated = repeated_rows(split, table, "touch")
    assert np.flatnonzero(repeated).tolist() == [5, 7, 9]
    kept = without_rows(split, repeated)
    assert (kept.train.tolist(), kept.val.tolist()) == ([0, 1, 2, 3], [4, 6])
    assert kept.test.tolist() == [8, 10]


def test_pictures_that_several_objects_share_are_no_copies():
    """Such as those of presses that miss: to drop them would raise scores."""
    split = Split("seen", rows(0, 1, 4, 5), rows(2, 6), rows(3, 7, 8))
    table = Table([9, 1, 2, 9, 9, 3, 4, 9, 3], [0, 0, 0, 0, 1, 1, 1, 1, 1])
    assert np.flatnonzero(repeated_rows(split, table, "touch")).tolist() == [8]
    # A picture of another object alone is none either.
    table = Table([9, 1, 2, 3, 5, 6, 4, 9, 7], table.labels)
    assert not repeated_rows(split, table, "touch").any()


def test_copies_are_told_by_bytes():
    split = Split("seen", rows(0), rows(1), rows(2))
    assert not repeated_rows(split, Table([0.0, -0.0, 1e-30], [0, 0, 0]), "touch").any()


def test_something_is_left_to_test():
    split = Split("seen", rows(0, 1), rows(2), rows(3))
    with pytest.raises(ObjectFolderError, match="split seen: every test row repeats an input of its object"):
        without_rows(split, np.array([False, False, False, True]))


LABELS, TESTED = np.repeat([0, 1], 10), np.array([9, 18, 19])
SMALL = Split("seen", np.array([0, 1, 2, 3, 10, 11, 12, 13]), np.array([4, 14]), TESTED)


def test_companions_are_of_the_same_object_and_part():
    companions, rng = Companions(SMALL, LABELS), np.random.default_rng(0)
    rows = np.concatenate([SMALL.train, SMALL.val, TESTED])
    drawn = companions.draw(rows, 50, rng)
    assert np.array_equal(drawn[:, 0], rows)
    for row, group in zip(rows, drawn):
        part = next(part for part in (SMALL.train, SMALL.val, TESTED) if row in part)
        others = {other for other in part if LABELS[other] == LABELS[row]} - {row}
        assert set(group[1:]) == (others or {row})


def test_no_companion_is_drawn_twice_while_there_are_others():
    labels = np.zeros(40, int)
    companions = Companions(Split("seen", np.arange(20), np.arange(20, 24), np.arange(24, 40)), labels)
    drawn = companions.draw(np.arange(24, 40), 16, np.random.default_rng(0))
    assert np.array_equal(np.sort(drawn, 1), np.tile(np.arange(24, 40), (16, 1)))
    assert len(np.unique(drawn[:, 1])) > 5, "in random order"
    drawn = companions.draw([20, 23], 10, np.random.default_rng(0))
    counts = [np.bincount(row, minlength=24)[20:].tolist() for row in drawn]
    assert counts == [[1, 3, 3, 3], [3, 3, 3, 1]]


def test_one_row_is_itself():
    assert Companions(SMALL, LABELS).draw(TESTED, 1, np.random.default_rng(0)).tolist() == [[9], [18], [19]]
