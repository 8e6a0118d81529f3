"""Frozen training, validation and test splits, by sample and by object.

``data/objects.csv`` lists the objects of the shipped catalogues. It is only ever appended to; of every ten
consecutive objects 7 are for training, 1 for validation and 2 for the test. ``data/samples.txt`` has a
letter (t, v, e) for every observation of an object: of every ten 8, 1 and 1, the paper's shares
(supplementary I.1). Both were drawn once, at random, and never change, so that scores stay comparable.
An object that replaces another in a catalogue takes its split, and a label of its own.
"""

import csv
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.samples import Samples
from objectfolder.workspace.layout import SPLITS

TEN = 10  #: observations of an object come in tens, each with 8 for training, 1 for validation, 1 for tests
_LETTERS = dict(zip("tve", SPLITS))
_CHUNK = 64  # rows read at once


@dataclass(frozen=True)
class Split:
    """Rows for training, validation and tests; each (n,) int64, ascending, no row twice.

    With N observations per object, row r is observation ``r % N`` of object ``r // N``.
    """

    name: str
    train: np.ndarray
    val: np.ndarray
    test: np.ndarray

    @property
    def digest(self) -> str:
        """SHA-256 of the rows; hexadecimal."""
        parts = [getattr(self, part).tolist() for part in SPLITS]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def label_order(keys: Iterable[str]) -> tuple[str, ...]:
    """Return objects in label order: those of the frozen list first, then others by key."""
    given, listed = set(keys), _listed()
    return *(key for key in listed if key in given), *sorted(given - listed.keys())


def object_split(key: str) -> str:
    """Return the split of an object, ``train``, ``val`` or ``test``, independent of other objects.

    Objects that are not in the frozen list are assigned by a hash of their key, in the same proportions.
    """
    listed = _listed()
    if key in listed:
        return listed[key]
    digit = int.from_bytes(hashlib.sha256(key.encode()).digest()) % TEN
    return "train" if digit < 7 else "val" if digit == 7 else "test"


def check_count(count: int) -> None:
    """Raise ObjectFolderError unless a number of observations comes in tens."""
    if count < TEN or count % TEN:
        raise ObjectFolderError(
            f"{count} observations per object, expected a multiple of {TEN}: each ten has 8 for training, "
            "1 for validation, 1 for tests"
        )


def per_sample(keys: Sequence[str], count: int) -> Split:
    """Split ``seen``: 80 % of the observations of every object for training, 10 % validation, 10 % test.

    Keys are in the order of their rows. The split of the first n observations does not depend on their count.
    Raises ObjectFolderError if there are fewer than two objects, or the count is not a multiple of ten.
    """
    letters = _sample_splits(keys, count)
    return Split("seen", *(_rows(letters == name, [True] * len(keys)) for name in SPLITS))


def per_object(keys: Sequence[str], count: int) -> Split:
    """Split ``unseen``: test objects are absent from training and validation.

    Validation uses separate objects if the frozen list provides any. Otherwise it uses the observations of
    training objects that ``seen`` validates on, and training omits them. Raises ObjectFolderError as
    `per_sample`, or if no object is for training or none for tests.
    """
    letters = _sample_splits(keys, count)
    of_objects = np.array([object_split(key) for key in keys])
    for name in ("train", "test"):
        if name not in of_objects:
            listed = [key for key, split in _listed().items() if split == name]
            raise ObjectFolderError(
                f"split unseen: of {_named(keys)} none is a {name} object; add one of those that the list of "
                f"objects gives to {name} ({_named(listed)}), or take the split seen (--split seen)"
            )
    train, val, test = (of_objects == name for name in SPLITS)
    if val.any():
        every = np.ones(count, bool)
        return Split("unseen", _rows(every, train), _rows(every, val), _rows(every, test))
    kept = letters == "val"
    return Split("unseen", _rows(~kept, train), _rows(kept, train), _rows(np.ones(count, bool), test))


#: Splits by name: test on training objects, and on new objects.
NAMED: dict[str, Callable[[Sequence[str], int], Split]] = {"seen": per_sample, "unseen": per_object}


def named_split(name: str, keys: Sequence[str], count: int) -> Split:
    """Make a split by its name, ``seen`` or ``unseen``; see `per_sample` and `per_object`.

    Raises ObjectFolderError if there is no split of that name, or it cannot be made of these objects.
    """
    if name not in NAMED:
        raise ObjectFolderError(f"split {name!r} is unknown, expected one of {', '.join(NAMED)}")
    return NAMED[name](keys, count)


def repeated_rows(
    split: Split, observations: Samples, modality: str, answers: np.ndarray | None = None
) -> np.ndarray:
    """Find validation and test rows whose input repeats earlier ones with the same answer, byte by byte.

    A net may know the answer to such an input by heart. What occurs with several answers gives none away: it
    tells nothing, as the picture of a press that misses. Answers, one for each observation, are the objects
    by default. Returns (rows,) bool of all observations. Rows for training come before those for validation,
    and these before the tests.
    """
    labels = observations.labels if answers is None else answers
    repeated = np.zeros(len(labels), bool)
    owners: dict[bytes, set[int]] = {}  # answers to an input in the earlier rows
    for part in (split.train, split.val, split.test):
        found = list(zip(_digests(observations, modality, part), labels[part].tolist()))
        repeated[part] = [owners.get(digest) == {label} for digest, label in found]
        for digest, label in found:
            owners.setdefault(digest, set()).add(label)
    repeated[split.train] = False
    return repeated


def without_rows(split: Split, dropped: np.ndarray) -> Split:
    """Drop validation and test rows, given which of all rows to drop; (rows,) bool.

    Raises ObjectFolderError if no validation or no test row is left.
    """
    val, test = (rows[~dropped[rows]] for rows in (split.val, split.test))
    for name, rows in (("validation", val), ("test", test)):
        if not len(rows):
            raise ObjectFolderError(
                f"split {split.name}: every {name} row repeats an input of its object among the rows before "
                "it; are the objects silent, or all views and touches of an object alike? Leave out such "
                "objects"
            )
    return replace(split, val=val, test=test)


def _digests(observations: Samples, modality: str, rows: np.ndarray) -> Iterable[bytes]:
    for start in range(0, len(rows), _CHUNK):
        for row in observations.read(modality, rows[start : start + _CHUNK]):
            yield hashlib.blake2b(row.tobytes(), digest_size=16).digest()


def _rows(of_count: np.ndarray, of_objects: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Return the rows of the selected observations of the selected objects."""
    return np.flatnonzero(np.outer(of_objects, of_count)).astype(np.int64)


def _sample_splits(keys: Sequence[str], count: int) -> np.ndarray:
    """Return the split of each observation of an object; (count,) str."""
    if len(keys) < 2:
        raise ObjectFolderError(
            f"objects: {_named(keys) or 'none'}; a benchmark tells objects apart, and needs two at least"
        )
    check_count(count)
    return np.resize(_frozen_samples(), count)


def _named(keys: Sequence[str], most: int = 8) -> str:
    return ", ".join(keys[:most]) + (f" and {len(keys) - most} more" if len(keys) > most else "")


@cache
def _listed() -> dict[str, str]:
    """Split of each object of the frozen list, in the order of labels."""
    rows = csv.DictReader(_data("objects.csv").splitlines())
    return {row["key"]: row["split"] for row in rows}


@cache
def _frozen_samples() -> np.ndarray:
    return np.array([_LETTERS[letter] for letter in _data("samples.txt") if letter in _LETTERS])


def _data(name: str) -> str:
    return (files("objectfolder.benchmarks") / "data" / name).read_text()


class Companions:
    """The rows of a split by object and part, to draw from, given the objects (N,) of all observations."""

    def __init__(self, split: Split, labels: np.ndarray):
        self._group = np.full(len(labels), -1)  #: one for each object and part
        for number, rows in enumerate((split.train, split.val, split.test)):
            self._group[rows] = 3 * labels[rows] + number
        self._order = np.argsort(self._group, kind="stable")
        self._sorted = self._group[self._order]

    def draw(self, rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return each of the rows (n,) with others of its object and part at random; (n, count) int64.

        The rows themselves are the first column. All are different as far as there are ``count`` of them; the
        others are repeated in turn if not.
        """
        rows = np.asarray(rows)
        groups = self._group[rows]
        first, end = (np.searchsorted(self._sorted, groups, side) for side in ("left", "right"))
        size = (end - first)[:, None]
        place = np.arange(size.max(initial=1))
        members = self._order[np.minimum(first[:, None] + place, end[:, None] - 1)]
        key = rng.random(members.shape)
        key[members == rows[:, None]] = 2  # itself after all others
        key[place >= size] = 3
        shuffled = np.take_along_axis(members, key.argsort(1), 1)
        others = np.arange(count - 1) % np.maximum(size - 1, 1)
        return np.concatenate([rows[:, None], np.take_along_axis(shuffled, others, 1)], 1)
