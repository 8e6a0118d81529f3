import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from encoding import encoding
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.datasets.splits import Split, per_object, per_sample
from objectfolder.benchmarks.models import encoders
from objectfolder.benchmarks.models.classifier import Classifier, join_classifiers
from objectfolder.benchmarks.models.encoders import register_encoder
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import recognize_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import TASK
from objectfolder.benchmarks.tasks.recognize_training import COMBINATIONS, classify_materials, recognize

SIZES = InputSizes(image=8, spectrogram=(16, 8), touch=(8, 8))
PARAMS = SimpleNamespace(
    seeds=2,
    epochs=3,
    fusion_epochs=1,
    batch=16,
    learning_rate=0.02,
    weight_decay=0.01,
    patience=3,
    schedule="cosine",
    label_smoothing=0.0,
)


class Table:
    """Observations held in memory: each object has a colour, a pitch and a pressure, under noise."""

    keys = ("ball", "cube", "cup", "die")
    pitches = (400, 800, 1600, 3200)  # Hz

    def __init__(self, count, noise=20):
        rng = np.random.default_rng(count)
        self.count = count
        self.labels = np.repeat(np.arange(4), count)
        rows = len(self.labels)
        colours = np.array([[200, 60, 60], [60, 200, 60], [60, 60, 200], [160, 160, 40]])
        time = np.arange(4000) / 16000
        phase = rng.uniform(0, 2 * np.pi, (rows, 1))
        self.arrays = {
            "vision": self._picture(rng, colours[self.labels], 10, noise),
            "audio": np.sin(
                2 * np.pi * np.array(self.pitches)[self.labels, None] * time + phase, dtype=np.float32
            ),
            "touch": self._picture(rng, colours[self.labels] // 2, 8, noise),
        }
        self.reliefs, self.missed = np.full(rows, 1e-3), np.zeros(rows, bool)
        self.records = dict(zip(self.keys, ({"material": m} for m in ("wood", "steel", "wood", "steel"))))
        self.reads = {modality: [] for modality in self.arrays}

    @staticmethod
    def _picture(rng, colours, side, noise):
        pixels = colours[:, None, None] + noise * rng.standard_normal((len(colours), side, side, 3))
        return pixels.clip(0, 255).astype(np.uint8)

    def relief(self, rows):
        return self.reliefs[rows]

    def untouched(self, rows):
        return self.missed[rows]

    def read(self, modality, rows):
        self.reads[modality].append(np.array(rows))
        return self.arrays[modality][rows]


@pytest.fixture(autouse=True)
def _small_encoder_and_no_figure(monkeypatch):
    monkeypatch.setattr(recognize_training, "draw_confusion", lambda title, counts, names, path: path.touch())
    monkeypatch.setattr(encoders, "_FACTORIES", dict(encoders._FACTORIES))

    @register_encoder("small")
    class Small(nn.Sequential):
        features = 8

        def __init__(self, channels):
            super().__init__(
                nn.Conv2d(channels, 8, 3, 2, 1),
                nn.BatchNorm2d(8),
                nn.ReLU(),
                nn.AdaptiveMaxPool2d((4, 1)),
                nn.Flatten(),
                nn.Linear(32, 8),
            )


def _run(table, folder, split=None, **changes):
    params = SimpleNamespace(**{**vars(PARAMS), **changes})
    split = split or per_sample(table.keys, table.count)
    scores, curve = recognize(Job(table, split, params, encoding("small", SIZES), seed=1, progress=folder))
    return {name: value for name, value in scores.items() if name != "seconds"}, curve


def test_objects_that_differ_in_every_sense_are_told_apart(tmp_path):
    table = Table(30)
    scores, curve = _run(table, tmp_path, epochs=5, patience=5)
    for name in COMBINATIONS:
        assert scores[name]["accuracy"] == np.mean(scores[name]["seeds"]) > 0.9, name
        assert len(scores[name]["seeds"]) == 2
    assert scores["chance"] == {"uniform": 0.25, "majority": 0.25}
    assert (scores["objects"], scores["rows"]) == (4, {"train": 96, "val": 12, "test": 12})
    assert scores["duplicates"] == {m: {"val": 0, "test": 0} for m in ("vision", "audio", "touch")}
    confusion = np.array(scores["confusion"])
    assert (confusion.sum(1) == 2 * 3).all()  # two seeds with three test rows of each object
    assert confusion.trace() / 24 == pytest.approx(scores["VAT"]["accuracy"])
    assert len(TASK.columns) == len(curve[0])
    assert [tuple(row[:3]) for row in curve] == [
        (run, name, epoch)
        for run in (0, 1)
        for name in COMBINATIONS
        for epoch in range(1, (5 if len(name) == 1 else 1) + 1)
    ]


def test_a_seeds_spread_gives_the_interval(tmp_path):
    scores, _ = _run(Table(20, noise=200), tmp_path, epochs=1, learning_rate=1e-3)
    for name in COMBINATIONS:
        first, second = scores[name]["seeds"]
        # Student's t of one degree of freedom: 12.7062; standard error of two values: half their distance
        assert scores[name]["interval_95"] == pytest.approx(12.7062 * abs(first - second) / 2, rel=1e-4)


def test_touches_are_told_apart_by_what_differs_from_their_median(tmp_path):
    """Objects differ by one grey level in 40, on a background that varies over the picture."""
    table = Table(30)
    background = np.random.default_rng(0).integers(40, 200, size=(8, 8, 3))
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])[table.labels]
    pictures = np.tile(background, (len(signs), 1, 1, 1))
    pictures[:, :4, :, 0] += signs[:, :1, None]
    pictures[:, 4:, :, 0] += signs[:, 1:, None]
    pictures[..., 2] += np.random.default_rng(1).integers(3, size=(len(signs), 8, 8))  # no two are alike
    table.arrays["touch"] = pictures.astype(np.uint8)
    split = per_sample(table.keys, table.count)
    changes = {"seeds": 1, "schedule": "one_cycle", "label_smoothing": 0.1, "epochs": 6, "patience": 6}
    params = SimpleNamespace(**{**vars(PARAMS), **changes})
    job = Job(table, split, params, encoding("small", SIZES, subtract=True, shift=1), 1, tmp_path)
    scores, curve = recognize(job)
    assert scores["T"]["accuracy"] > 0.7
    # Smoothed targets bound the loss: -0.925 log 0.925 - 3 * 0.025 log 0.025
    assert min(row[3] for row in curve) > 0.348
    other = Table(30)
    other.arrays["touch"] = table.arrays["touch"].copy()
    held = np.concatenate([split.val, split.test])
    other.arrays["touch"][held] = 0
    again = Job(other, split, params, encoding("small", SIZES, subtract=True), 1, tmp_path)
    torch.testing.assert_close(
        again.ground.median, job.ground.median, rtol=0, atol=0
    )  # of training rows only


def test_nothing_is_learnt_of_shuffled_labels(tmp_path):
    """Rows that a net can remember one by one, but that say nothing about others."""
    table = Table(100)
    split = per_sample(table.keys, table.count)
    rng = np.random.default_rng(3)
    for modality, array in table.arrays.items():
        table.arrays[modality] = rng.permutation(array)
    for rows in (split.train, split.val):
        table.labels[rows] = rng.permutation(table.labels[rows])
    scores, _ = _run(table, tmp_path, split, seeds=1, epochs=2)
    # 40 answers at chance 1/4: deviation 0.068
    for name in COMBINATIONS:
        assert abs(scores[name]["accuracy"] - 0.25) < 0.2, name


def test_every_combination_uses_its_modalities_and_no_other(tmp_path):
    """What a modality does not show cannot be told by it: pairs of objects look alike, others sound alike."""
    table = Table(200)
    table.arrays["vision"] = Table._picture(
        np.random.default_rng(0), np.array([[200, 60, 60], [60, 60, 200]])[table.labels // 2], 10, 20
    )
    time = np.arange(4000) / 16000
    pitch = np.array([400, 3200])[table.labels % 2, None]
    phase = np.random.default_rng(1).uniform(0, 6, (len(pitch), 1))
    table.arrays["audio"] = np.sin(2 * np.pi * pitch * time + phase, dtype=np.float32)
    table.arrays["touch"] = np.random.default_rng(2).integers(256, size=(len(pitch), 8, 8, 3), dtype=np.uint8)
    scores, _ = _run(table, tmp_path, seeds=1)
    # 80 answers of which half are a guess: deviation 0.056
    for name, expected in {"V": 0.5, "A": 0.5, "T": 0.25, "VT": 0.5, "AT": 0.5, "VA": 1, "VAT": 1}.items():
        assert scores[name]["accuracy"] == pytest.approx(expected, abs=0.17), name
    assert min(scores["VA"]["accuracy"], scores["VAT"]["accuracy"]) > 0.8


def test_touches_together_and_on_flat_ground(tmp_path):
    """Of the first two objects, half of the test touches are flat or miss: all of these look alike."""
    table = Table(100, noise=5)
    split = per_sample(table.keys, table.count)
    flat = np.zeros(len(table.labels), bool)
    flat[np.flatnonzero(table.labels < 2)[::2]] = True
    flat[split.test] = np.arange(len(split.test)) % 2 * (table.labels[split.test] < 2) > 0
    table.missed[np.flatnonzero(flat)[::2]] = True
    table.reliefs[flat & ~table.missed] = 1e-6
    rng = np.random.default_rng(0)
    table.arrays["touch"][flat] = 200 + rng.integers(50, size=(flat.sum(), 8, 8, 3))
    scores, _ = _run(table, tmp_path, split, seeds=1, epochs=6, patience=6)
    assert scores["flat"] == 0.25
    # All others are answered correctly; of the flat ones, which look alike, half.
    assert scores["flat_accuracy"] == pytest.approx(1 - (1 - scores["T"]["accuracy"]) / 0.25, abs=0.1)
    assert 0.2 <= scores["flat_accuracy"] <= 0.8
    found = {kind: scores[kind] for kind in ("touches", "touches_not_flat")}
    # Of the ten test touches of each object five are flat, of two objects. Pairs: 10 of 45; fours: 5 of 210.
    bounds = {size: score["bound"] for size, score in found["touches"].items()}
    assert bounds == pytest.approx({"1": 0.875, "2": 1 - 10 / 45 / 4, "4": 1 - 5 / 210 / 4, "8": 1.0})
    assert found["touches"]["1"]["accuracy"] == scores["T"]["accuracy"] == pytest.approx(0.875, abs=0.05)
    assert found["touches"]["4"]["accuracy"] > 0.95
    assert {score["bound"] for score in found["touches_not_flat"].values()} == {1.0}
    assert found["touches_not_flat"]["1"]["accuracy"] > 0.95
    assert (tmp_path / "sheet.png").is_file()


def test_materials_are_classes_of_their_own_and_those_never_learnt_are_left_out(tmp_path):
    table = Table(30)
    rows = np.arange(len(table.labels)).reshape(4, 30)
    # The cube, of steel, is only tested; in look, sound and touch it is the die, of steel, too.
    for array in table.arrays.values():
        array[rows[1]] = array[rows[3]][::-1]
        array[rows[1], :1] = 0  # no row twice
    train, val, test = rows[[0, 2, 3], :25].ravel(), rows[[0, 3], 25:27].ravel(), rows[1]
    split = Split("unseen", train, val, test)
    params = SimpleNamespace(**{**vars(PARAMS), "seeds": 1, "epochs": 6, "patience": 6})
    scores, _ = classify_materials(Job(table, split, params, encoding("small", SIZES), 1, tmp_path / "steel"))
    assert (scores["materials"], scores["left_out"], scores["objects"]) == (["steel", "wood"], [], 4)
    assert np.shape(scores["confusion"]) == (2, 2)
    assert np.sum(scores["confusion"], 1).tolist() == [30, 0]
    assert scores["A"]["accuracy"] == scores["VAT"]["accuracy"] == 1
    assert scores["chance"] == {"uniform": 0.5, "majority": 1.0}

    table.records["cube"] = {"material": "gold"}
    half = Split("unseen", train, val, np.concatenate([rows[0, 27:], test]))
    scores, _ = classify_materials(Job(table, half, params, encoding("small", SIZES), 1, tmp_path / "gold"))
    assert (scores["left_out"], scores["rows"]["test"]) == (["gold"], 3)
    assert scores["chance"]["uniform"] == 0.5  # of the two that are learnt
    with pytest.raises(ObjectFolderError, match=r"no test object is of a material of .*\(steel, wood\)"):
        classify_materials(Job(table, split, params, encoding("small", SIZES), 1, tmp_path))
    alike = Split("unseen", rows[[0, 2], :25].ravel(), val, test)
    with pytest.raises(ObjectFolderError, match="all objects for training are of wood; add objects"):
        classify_materials(Job(table, alike, params, encoding("small", SIZES), 1, tmp_path))


def test_rows_that_were_learnt_are_not_tested(tmp_path):
    """But where another sense is new; an object that is silent is only lost to hearing alone."""
    table = Table(50)
    split = per_sample(table.keys, table.count)
    table.arrays["touch"][split.test[:3]] = table.arrays["touch"][split.train[:3]]
    table.arrays["vision"][split.val[4]] = table.arrays["vision"][split.train[35]]
    table.arrays["audio"][table.labels == 3] = 0
    scores, _ = _run(table, tmp_path, split, seeds=1, epochs=1)
    assert scores["rows"] == {"train": 160, "val": 20, "test": 20}
    assert scores["duplicates"] == {
        "vision": {"val": 1, "test": 0},
        "audio": {"val": 5, "test": 5},
        "touch": {"val": 0, "test": 3},
    }
    assert scores["untested"] == {"A": ["die"]}
    answers = {
        name: json.loads((tmp_path / f"0_{name}.json").read_text())["predicted"] for name in COMBINATIONS
    }
    assert {name: len(rows) for name, rows in answers.items()} == {
        **dict.fromkeys(COMBINATIONS, 20),
        **{"A": 15, "T": 17},
    }
    assert np.sum(scores["confusion"]) == 20
    assert scores["chance"] == {"uniform": 0.25, "majority": 0.25}


def test_what_only_objects_of_one_material_share_tells_the_material(tmp_path):
    table = Table(20)
    table.arrays["audio"][np.isin(table.labels, (0, 2))] = 0  # both are of wood
    params = SimpleNamespace(**{**vars(PARAMS), "seeds": 1, "epochs": 1})
    split = per_sample(table.keys, table.count)
    scores, _ = classify_materials(Job(table, split, params, encoding("small", SIZES), 1, tmp_path))
    assert scores["duplicates"]["audio"] == {"val": 4, "test": 4}
    assert len(json.loads((tmp_path / "0_A.json").read_text())["predicted"]) == 4
    assert len(json.loads((tmp_path / "0_V.json").read_text())["predicted"]) == 8


def test_test_rows_are_read_once_with_the_best_epoch(tmp_path):
    table = Table(20)
    split = per_sample(table.keys, table.count)
    _run(table, tmp_path, split, seeds=1)
    for modality, reads in table.reads.items():
        counts = np.bincount(np.concatenate(reads), minlength=len(table.labels))
        # Once in the search for duplicates, and once for each of the four combinations with a modality;
        # spectrograms are kept.
        assert set(counts[split.test]) == {1 + (1 if modality == "audio" else 4)}
        assert max(len(rows) for rows in reads) <= 64


def test_interrupted_recognition_goes_on_to_the_same_numbers(tmp_path):
    table = Table(20)
    split = per_sample(table.keys, table.count)
    whole = _run(table, tmp_path / "whole")
    lines = []

    def stop(at):
        def report(line):
            lines.append(line)
            if len(lines) == at:
                raise KeyboardInterrupt

        return report

    # In the middle of a single modality, after one, in a fusion, and in the second seed.
    for at in (2, 3, 11, 16):
        with pytest.raises(KeyboardInterrupt):
            recognize(
                Job(table, split, PARAMS, encoding("small", SIZES), 1, tmp_path / "parts", report=stop(at))
            )
    assert _run(table, tmp_path / "parts") == whole
    assert len(lines) == 16
    assert len(set(lines)) == 16  # no epoch twice
    assert not list(tmp_path.glob("*/*.pt"))
    # Finished, so nothing is trained or tested again.
    for reads in table.reads.values():
        reads.clear()
    assert _run(table, tmp_path / "whole") == whole
    # But for copies, and one row for its size.
    assert all(len(np.concatenate(reads)) == len(table.labels) + 1 for reads in table.reads.values())


@pytest.mark.slow
def test_another_seed_gives_other_nets(tmp_path):
    table = Table(20, noise=200)
    split = per_sample(table.keys, table.count)
    curves = [
        recognize(Job(table, split, PARAMS, encoding("small", SIZES), seed=seed, progress=tmp_path / str(i)))[
            1
        ]
        for i, seed in enumerate((1, 2))
    ]
    assert all(a[3] != b[3] for a, b in zip(*curves))
    runs = [[row[3] for row in curves[0] if row[0] == run] for run in (0, 1)]
    assert all(a != b for a, b in zip(*runs))


def test_fusion_starts_from_the_sum_of_its_parts_logits():
    torch.manual_seed(0)
    parts = [
        Classifier({letter: encoders.make_encoder("small", modality)}, 5).eval()
        for letter, modality in (("V", "vision"), ("A", "audio"), ("T", "touch"))
    ]
    inputs = {"V": torch.randn(2, 3, 8, 8), "A": torch.randn(2, 1, 16, 8), "T": torch.randn(2, 3, 8, 8)}
    joined = join_classifiers(parts)
    with torch.no_grad():
        torch.testing.assert_close(joined.eval()(inputs), sum(part(inputs) for part in parts))
        for parameter in joined.parameters():
            parameter.zero_()
    assert all(part.head.weight.any() for part in parts)  # theirs are copies


def test_objects_that_are_never_learnt_are_refused(tmp_path):
    table = Table(10)
    split = per_object(table.keys, table.count)
    with pytest.raises(
        ObjectFolderError, match=r"split unseen: test class .* is absent from training; use --split seen"
    ):
        _run(table, tmp_path, split)
