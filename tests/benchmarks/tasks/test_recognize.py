from dataclasses import replace

import numpy as np
import pytest
import torch
from encoding import encoding
from made_up import MadeUp, hum, picture
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.benchmarks.datasets.splits import Split, per_object, per_sample
from objectfolder.benchmarks.models import encoders
from objectfolder.benchmarks.models.classifier import Classifier, join_classifiers
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.scoring.scores import interval_95
from objectfolder.benchmarks.tasks import recognize_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import TASK, RecognizeConfig
from objectfolder.benchmarks.tasks.recognize_training import COMBINATIONS, classify_materials, recognize

SIZES = InputSizes(image=8, spectrogram=(16, 8), touch=(8, 8))
PARAMS = RecognizeConfig(seeds=2, epochs=3, batch=16, learning_rate=0.02, patience=3)
COLOURS = np.array([[200, 60, 60], [60, 200, 60], [60, 60, 200], [160, 160, 40]])


class Table(MadeUp):
    """Each object has a colour, a pitch and a pressure, under noise."""

    def __init__(self, count, noise=20):
        rng, labels = np.random.default_rng(count), np.repeat(np.arange(4), count)
        arrays = {
            "vision": picture(COLOURS[labels], 10, noise, rng),
            "audio": hum(np.array([400, 800, 1600, 3200])[labels], rng),
            "touch": picture(COLOURS[labels] // 2, 8, noise, rng),
        }
        super().__init__(("ball", "cube", "cup", "die"), arrays, material=["wood", "steel"] * 2)
        self.reliefs, self.missed = np.full(len(labels), 1e-3), np.zeros(len(labels), bool)

    def relief(self, rows):
        return self.reliefs[rows]

    def untouched(self, rows):
        return self.missed[rows]


@pytest.fixture(autouse=True)
def _no_figure(monkeypatch):
    monkeypatch.setattr(recognize_training, "draw_confusion", lambda title, counts, names, path: path.touch())


def make_job(table, folder, split=None, encode=None, **changes):
    split = split or per_sample(table.keys, table.count)
    encode = encode or encoding("linear", SIZES)
    return Job(table, split, replace(PARAMS, **changes), encode, seed=1, progress=folder)


def _run(table, folder, split=None, **changes):
    scores, curve = recognize(make_job(table, folder, split, **changes))
    return {name: value for name, value in scores.items() if name != "seconds"}, curve


def test_objects_that_differ_in_every_sense_are_told_apart(tmp_path):
    table = Table(30)
    scores, curve = _run(table, tmp_path, epochs=5, patience=5)
    for name in COMBINATIONS:
        assert scores[name]["accuracy"] == np.mean(scores[name]["seeds"]) > 0.9, name
        assert scores[name]["interval_95"] == interval_95(scores[name]["seeds"])
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
    job = make_job(table, tmp_path, split, encoding("linear", SIZES, subtract=True, shift=1), **changes)
    scores, curve = recognize(job)
    assert scores["T"]["accuracy"] > 0.7
    # Smoothed targets bound the loss: -0.925 log 0.925 - 3 * 0.025 log 0.025
    assert min(row[3] for row in curve) > 0.348
    other = Table(30)
    other.arrays["touch"] = table.arrays["touch"].copy()
    other.arrays["touch"][np.concatenate([split.val, split.test])] = 0
    again = make_job(other, tmp_path, split, job.encode)
    assert torch.equal(again.ground.median, job.ground.median)  # of training rows only


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
    rng = np.random.default_rng(0)
    table.arrays["vision"] = picture(COLOURS[2 * (table.labels // 2)], 10, 20, rng)
    table.arrays["audio"] = hum(np.array([400, 3200])[table.labels % 2], rng)
    table.arrays["touch"] = np.random.default_rng(2).integers(256, size=(len(table), 8, 8, 3), dtype=np.uint8)
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
    changes = {"seeds": 1, "epochs": 6, "patience": 6}
    scores, _ = classify_materials(make_job(table, tmp_path / "steel", split, **changes))
    assert (scores["materials"], scores["left_out"], scores["objects"]) == (["steel", "wood"], [], 4)
    assert np.shape(scores["confusion"]) == (2, 2)
    assert np.sum(scores["confusion"], 1).tolist() == [30, 0]
    assert scores["A"]["accuracy"] == scores["VAT"]["accuracy"] == 1
    assert scores["chance"] == {"uniform": 0.5, "majority": 1.0}

    table.records["cube"]["material"] = "gold"
    half = Split("unseen", train, val, np.concatenate([rows[0, 27:], test]))
    scores, _ = classify_materials(make_job(table, tmp_path / "gold", half, **changes))
    assert (scores["left_out"], scores["rows"]["test"]) == (["gold"], 3)
    assert scores["chance"]["uniform"] == 0.5  # of the two that are learnt
    with pytest.raises(ObjectFolderError, match=r"no test object is of a material of .*\(steel, wood\)"):
        classify_materials(make_job(table, tmp_path, split))
    alike = Split("unseen", rows[[0, 2], :25].ravel(), val, test)
    with pytest.raises(ObjectFolderError, match="all objects for training are of wood; add objects"):
        classify_materials(make_job(table, tmp_path, alike))


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
    answers = {name: len(read_json(tmp_path / f"0_{name}.json")["predicted"]) for name in COMBINATIONS}
    assert answers == dict.fromkeys(COMBINATIONS, 20) | {"A": 15, "T": 17}
    assert np.sum(scores["confusion"]) == 20
    assert scores["chance"] == {"uniform": 0.25, "majority": 0.25}


def test_what_only_objects_of_one_material_share_tells_the_material(tmp_path):
    table = Table(20)
    table.arrays["audio"][np.isin(table.labels, (0, 2))] = 0  # both are of wood
    scores, _ = classify_materials(make_job(table, tmp_path, seeds=1, epochs=1))
    assert scores["duplicates"]["audio"] == {"val": 4, "test": 4}
    assert [len(read_json(tmp_path / f"0_{name}.json")["predicted"]) for name in "AV"] == [4, 8]


def test_test_rows_are_read_once_with_the_best_epoch(tmp_path):
    table = Table(20)
    split = per_sample(table.keys, table.count)
    _run(table, tmp_path, split, seeds=1)
    for modality, reads in table.reads.items():
        # Once in the search for duplicates, and once for each of the four combinations with a modality;
        # spectrograms are kept.
        assert set(table.counts(modality)[split.test]) == {1 + (1 if modality == "audio" else 4)}
        assert max(len(rows) for rows in reads) <= 64


@pytest.mark.slow
def test_another_seed_gives_other_nets(tmp_path):
    table = Table(20, noise=200)
    jobs = [make_job(table, tmp_path / str(seed)) for seed in (1, 2)]
    curves = [recognize(replace(job, seed=seed))[1] for seed, job in enumerate(jobs)]
    assert all(a[3] != b[3] for a, b in zip(*curves))
    runs = [[row[3] for row in curves[0] if row[0] == run] for run in (0, 1)]
    assert all(a != b for a, b in zip(*runs))


def test_fusion_starts_from_the_sum_of_its_parts_logits():
    torch.manual_seed(0)
    parts = [
        Classifier({letter: encoders.make_encoder("linear", modality)}, 5).eval()
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
    message = r"split unseen: test class .* is absent from training; use --split seen"
    refused(message, _run, table, tmp_path, split)
