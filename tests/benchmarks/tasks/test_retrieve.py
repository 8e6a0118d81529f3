import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from encoding import encoding
from torch import nn

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.splits import Split, per_sample
from objectfolder.benchmarks.models.encoders import register_encoder
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.models.two_stream import (
    TwoStream,
    cross_sensory_loss,
    paired_batches,
    triplet_loss,
)
from objectfolder.benchmarks.tasks import retrieve_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.naming import repeated_objects, score_within
from objectfolder.benchmarks.tasks.recognize_training import recognize
from objectfolder.benchmarks.tasks.reconstruct_training import reconstruct
from objectfolder.benchmarks.tasks.retrieve import TASK, check_objects
from objectfolder.benchmarks.tasks.retrieve_training import retrieve
from objectfolder.benchmarks.tasks.task import Objects

DIRECTIONS = {"V->A", "A->V", "V->T", "T->V", "A->T", "T->A"}
SIZES = InputSizes(8, (16, 8), (8, 6))
ENCODE = {
    **{"encoder": "test_linear", "image": 8, "spectrogram": [16, 8], "touch": [8, 6]},
    **{"subtract": False, "shift": 0, "flip": False, "precision": "float32"},
}


@register_encoder("test_linear")
class Linear(nn.Module):
    """One layer on an input of 8 x 4 pixels: trained in a moment."""

    features = 16

    def __init__(self, channels):
        super().__init__()
        self.layer = nn.Sequential(nn.Linear(32 * channels, 16), nn.BatchNorm1d(16))

    def forward(self, x):
        return self.layer(nn.functional.adaptive_avg_pool2d(x, (8, 4)).flatten(1))


class Table:
    """Observations of made-up objects: a colour, a pitch and a stripe tell which one it is.

    With ``strangers`` the rows of each modality are those of objects of its own: nothing is shared.
    """

    count = 20

    def __init__(self, objects=6, strangers=False, salt=0):
        self.keys = tuple(f"object_{i}" for i in range(objects))
        self.labels = np.repeat(np.arange(objects), self.count)
        self.digest = f"{objects} {strangers} {salt}"
        self.reads = []
        rng = np.random.default_rng(salt)
        rows = len(self.labels)

        def nature():
            return rng.permutation(self.labels) if strangers else self.labels

        colours = 60 + 150 * np.random.default_rng(1).random((objects, 3))
        vision = colours[nature()][:, None, None] + rng.normal(0, 15, (rows, 10, 10, 3))
        time = np.arange(1600) / 16000
        pitch = 700 * (1 + nature())
        sounds = np.sin(2 * np.pi * pitch[:, None] * time) * np.exp(-20 * time)
        stripe = np.arange(8) == nature()[:, None] % 8
        touch = 100 + 80 * stripe[:, :, None, None] + rng.normal(0, 10, (rows, 8, 6, 3))
        self.arrays = {
            "vision": np.clip(vision, 0, 255).astype(np.uint8),
            "audio": (sounds + 0.01 * rng.normal(size=sounds.shape)).astype(np.float32),
            "touch": np.clip(touch, 0, 255).astype(np.uint8),
        }

    def __len__(self):
        return len(self.labels)

    def read(self, modality, rows):
        self.reads.append((modality, np.asarray(rows)))
        return self.arrays[modality][rows]


def params(**changed):
    values = {
        "seeds": 1,
        "epochs": 5,
        "batch": 16,
        "learning_rate": 0.03,
        "weight_decay": 0.0,
        "patience": 8,
        "margin": 0.5,
        "embedding": 8,
        "pretrain_epochs": 0,
        "schedule": "cosine",
    }
    return SimpleNamespace(**(values | changed))


def run(table, progress, split=None, **changed):
    split = per_sample(table.keys, table.count) if split is None else split
    return retrieve(
        Job(table, split, params(**changed), encoding("test_linear", SIZES), seed=3, progress=progress)
    )


def unit(*degrees):
    angles = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    return torch.stack([angles.cos(), angles.sin()], dim=1).requires_grad_()


def cos(degrees):
    return np.cos(np.radians(degrees))


def test_triplet_loss_by_hand():
    # Two objects, one row each. Anchor 0 degrees: positive at 60, negative (the other anchor) at 90.
    # D(anchor, positive) - D(anchor, negative) + m = (1 - 1/2) - (1 - 0) + 0.7 = 0.2.
    # Anchor 90: positive at 180, negative at 0: 1 - 1 + 0.7 = 0.7.
    loss = triplet_loss(unit(0, 90), unit(60, 180), torch.tensor([4, 9]), 0.7)
    assert loss.item() == pytest.approx((0.2 + 0.7) / 2, rel=1e-6)
    # The margin is kept by the first anchor, which then adds nothing.
    loss = triplet_loss(unit(0, 90), unit(60, 180), torch.tensor([4, 9]), 0.4)
    assert loss.item() == pytest.approx((0 + 0.4) / 2, rel=1e-6)


def test_lengths_of_embeddings_do_not_matter():
    labels = torch.tensor([0, 1])
    plain = triplet_loss(unit(0, 90), unit(60, 180), labels, 0.7)
    assert triplet_loss(5 * unit(0, 90), 0.1 * unit(60, 180), labels, 0.7).item() == pytest.approx(
        plain.item()
    )


def test_negatives_are_all_rows_of_other_objects_and_no_others():
    # Rows 0 and 2 are one object, whose anchors nearly agree: as each other's negatives they would cost most.
    anchors, positives = (0, 100, 5), (30, 170, 20)
    loss = triplet_loss(unit(*anchors), unit(*positives), torch.tensor([1, 0, 1]), 0.9)
    triplets = [(0, 1), (1, 0), (1, 2), (2, 1)]
    costs = [max(0, cos(anchors[i] - anchors[j]) - cos(anchors[i] - positives[i]) + 0.9) for i, j in triplets]
    assert loss.item() == pytest.approx(np.mean(costs), rel=1e-6)
    assert min(costs) == 0 < max(costs)


def test_both_modalities_are_anchors():
    first, second, labels = unit(0, 100, 40), unit(30, 170, 80), torch.tensor([0, 1, 2])
    both = cross_sensory_loss(first, second, labels, 0.9)
    expected = triplet_loss(first, second, labels, 0.9) + triplet_loss(second, first, labels, 0.9)
    assert both.item() == pytest.approx(expected.item())
    assert both.item() == pytest.approx(cross_sensory_loss(second, first, labels, 0.9).item())
    assert triplet_loss(first, second, labels, 0.9) != triplet_loss(second, first, labels, 0.9)


def test_descent_pulls_positives_closer_and_pushes_negatives_apart():
    first, second, labels = unit(0, 40), unit(60, 100), torch.tensor([0, 1])
    cross_sensory_loss(first, second, labels, 1.0).backward()
    with torch.no_grad():
        moved_1, moved_2 = first - 0.05 * first.grad, second - 0.05 * second.grad

    def cosines(a, b):
        return nn.functional.cosine_similarity(a, b)

    assert torch.all(cosines(moved_1, moved_2) > cosines(first, second))
    assert cosines(moved_1[:1], moved_1[1:]) < cosines(first[:1], first[1:])
    assert cosines(moved_2[:1], moved_2[1:]) < cosines(second[:1], second[1:])


def test_no_gradient_where_the_margin_is_kept():
    first, second = unit(0, 90, 180), unit(3, 88, 181)
    loss = cross_sensory_loss(first, second, torch.tensor([0, 1, 2]), 0.5)
    loss.backward()
    assert loss.item() == 0
    assert not first.grad.any()
    assert not second.grad.any()


def test_sixteen_bits_do_not_reach_the_distances():
    first, second, labels = unit(0, 1), unit(0.5, 1.5), torch.tensor([0, 1])
    with torch.autocast("cpu", torch.bfloat16):
        loss = cross_sensory_loss(first, second, labels, 0.0)
    assert loss.item() == cross_sensory_loss(first, second, labels, 0.0).item()


@pytest.mark.parametrize(
    ("objects", "rows_each", "batch"), [(2, 3, 3), (2, 5, 3), (7, 4, 9), (5, 8, 64), (3, 7, 4)]
)
def test_batches_pair_rows_of_one_object_and_hold_two_objects(objects, rows_each, batch):
    labels = np.repeat(np.arange(objects) * 10, rows_each)
    rows = 100 + np.arange(len(labels))
    for seed in range(20):
        batches = list(paired_batches(rows, labels, batch, np.random.default_rng(seed)))
        assert all(len(np.unique(labels[first - 100])) > 1 for first, _ in batches)
        assert all(len(first) == batch for first, _ in batches[:-1])
        assert len(batches[-1][0]) <= batch + 1
        first, second = (np.concatenate(side) for side in zip(*batches))
        np.testing.assert_array_equal(labels[first - 100], labels[second - 100])
        np.testing.assert_array_equal(np.sort(first), rows)
        np.testing.assert_array_equal(np.sort(second), rows)


def test_pairs_and_order_change_with_the_epoch():
    labels = np.repeat(np.arange(4), 8)

    def epoch(number):
        batches = paired_batches(np.arange(32), labels, 8, numpy_generator(0, str(number)))
        return np.concatenate([np.stack(pair, axis=1) for pair in batches])

    np.testing.assert_array_equal(epoch(1), epoch(1))
    assert {tuple(pair) for pair in epoch(1)} != {tuple(pair) for pair in epoch(2)}
    assert np.any(labels[epoch(1)[:, 0]] != labels[epoch(2)[:, 0]])
    assert np.mean(epoch(1)[:, 0] == epoch(1)[:, 1]) < 0.5


def test_refuses_what_has_no_negatives():
    rng = np.random.default_rng(0)
    with pytest.raises(ObjectFolderError, match="1 object"):
        list(paired_batches(np.arange(4), np.zeros(4, int), 4, rng))
    with pytest.raises(ObjectFolderError, match="batches of 2"):
        list(paired_batches(np.arange(4), np.array([0, 0, 1, 1]), 2, rng))
    with pytest.raises(ObjectFolderError, match="as many of each"):
        list(paired_batches(np.arange(4), np.array([0, 0, 0, 1]), 4, rng))


def test_one_object_to_rank_is_refused():
    labels, rows = np.repeat(np.arange(4), 10), np.arange(40)
    split = Split("unseen", rows[:20], rows[20:30], rows[30:])
    with pytest.raises(
        ObjectFolderError, match="split unseen tests on d alone, expected two objects or more"
    ):
        check_objects(split, Objects([*"abcd"], labels))
    check_objects(Split("unseen", rows[:20], rows[20:30], rows[20:]), Objects([*"abcd"], labels))


def test_streams_share_the_head_and_nothing_else():
    net = TwoStream([Linear(3), Linear(1)], 8, 5)
    views, sounds = torch.randn(2, 3, 8, 8), torch.randn(2, 1, 16, 8)
    embeddings = [net.embed(0, views), net.embed(1, sounds)]
    assert [x.shape for x in embeddings] == [(2, 8), (2, 8)]
    assert (embeddings[0] < 0).any()  # before the ReLU
    assert net.classify(embeddings[0]).shape == (2, 5)
    embeddings[0].sum().backward()
    reached = {name.split(".layer")[0] for name, value in net.named_parameters() if value.grad is not None}
    assert reached == {"encoders.0", "embedding.weight", "embedding.bias"}


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    table = Table()
    return table, *run(table, tmp_path_factory.mktemp("progress"), seeds=2)


def test_learns_what_the_senses_share(learnt):
    _, results, _ = learnt
    assert set(results["directions"]) == DIRECTIONS | {"V->V", "A->A", "T->T"}
    for score in results["directions"].values():
        assert score["map"] == pytest.approx(np.mean(score["seeds"]))
        assert len(score["seeds"]) == 2
        assert score["interval_95"] >= 0
        assert score["map"] > 0.8
        assert len(score["named"]["seeds"]) == 2
        assert score["named"]["map"] > 0.7
        assert score["cca"] > 0.8
        assert 1 / 6 < score["chance"] < 0.4


def test_pairs_start_from_encoders_that_name_the_objects(tmp_path, monkeypatch):
    table = Table()
    settings = params(pretrain_epochs=4, schedule="one_cycle", epochs=1)
    split = per_sample(table.keys, table.count)
    job = Job(table, split, settings, encoding("test_linear", SIZES), seed=3, progress=tmp_path)
    _, curves = retrieve(job)
    alone = [row for row in curves if row[1] == ""]
    assert {row[0] for row in alone} == {"vision", "audio", "touch"}
    assert {row[3] for row in alone} == {1, 2, 3, 4}
    assert all(row[5] > 0.9 for row in alone if row[3] == 4)
    assert {path.suffix for path in tmp_path.iterdir()} == {".json"}

    namers = [retrieve_training._namer(job, modality, 0)[0] for modality in ("vision", "touch")]
    monkeypatch.setattr(Job, "train", lambda *_, **__: [])
    monkeypatch.setattr(
        retrieve_training, "_namer", lambda _, modality, __: (namers[modality == "touch"], [])
    )
    net, _ = retrieve_training._train(job, ("vision", "touch"), 0, tmp_path / "none.pt")
    for encoder, namer in zip(net.encoders, namers):
        assert all(
            torch.equal(value, namer.state_dict()[name]) for name, value in encoder.state_dict().items()
        )


def test_rows_without_another_of_their_object_are_no_queries_within_a_sense():
    labels = np.array([5, 1, 1, 2, 5])
    rows = np.array([[1.0, 0], [0, 1], [0.1, 1], [1, 1], [-1, 0.2]])
    assert repeated_objects(labels, 4).tolist() == [0, 1, 2]
    # Row 0 finds its like last of four; rows 1 and 2 find each other first.
    assert score_within(rows, labels, 4) == pytest.approx((1 / 4 + 1 + 1) / 3)


def test_says_what_it_is_of(learnt):
    _, results, curves = learnt
    assert results["objects"] == 6
    assert results["rows"] == {"train": 96, "val": 12, "test": 12}
    assert results["duplicates"]["audio"] == {"val": 0, "test": 0}
    assert results["seconds"] > 0
    json.dumps(results, allow_nan=False)
    assert len(curves) <= 3 * 2 * 5
    assert {len(row) for row in curves} == {len(TASK.columns)}
    assert {tuple(row[:3]) for row in curves} == {
        (a, b, s) for a, b in [("vision", "audio"), ("vision", "touch"), ("audio", "touch")] for s in (0, 1)
    }


def test_nothing_is_found_where_the_senses_share_nothing(tmp_path):
    # Ten objects, and for each modality other labels: memorising the training rows must not help.
    results, curves = run(Table(10, strangers=True), tmp_path, epochs=10, patience=10)
    assert min(row[4] for row in curves) < 0.95 * max(row[4] for row in curves)  # learns rows by heart
    scores = results["directions"].values()
    chance = next(iter(scores))["chance"]
    assert np.mean([score["map"] for score in scores]) == pytest.approx(chance, abs=0.05)
    assert np.mean([score["cca"] for score in scores]) == pytest.approx(chance, abs=0.05)


def test_a_row_is_dropped_for_all_pairs_if_one_of_them_repeats_it(tmp_path):
    table = Table(3)
    split = per_sample(table.keys, table.count)
    table.arrays["audio"][table.labels == 1] = 0  # its views and touches are new, but for one touch
    table.arrays["touch"][split.test[3]] = table.arrays["touch"][split.train[20]]
    results, _ = run(table, tmp_path, split, epochs=1)
    assert results["rows"] == {"train": 48, "val": 6, "test": 5}
    assert results["duplicates"]["audio"] == {"val": 2, "test": 2}
    assert results["untested"] == {}


def test_test_rows_are_read_after_the_training_only(tmp_path, monkeypatch):
    table = Table()
    split = per_sample(table.keys, table.count)
    monkeypatch.setattr(Job, "without_duplicates", lambda job, *_: (job, {}))
    monkeypatch.setattr(retrieve_training, "_features", lambda *_: {})
    monkeypatch.setattr(retrieve_training, "_correlate", lambda *_: ({"V->A": 0.0}, {}))
    monkeypatch.setattr(retrieve_training, "PAIRS", (("vision", "audio"),))
    run(table, tmp_path, split)
    from_tests = [np.isin(rows, split.test).any() for _, rows in table.reads]
    assert sum(from_tests) == 2
    assert from_tests[-2:] == [True, True]


def test_unseen_objects_and_one_to_choose_the_epoch_by(tmp_path):
    table = Table(8)
    of = [np.flatnonzero(np.isin(table.labels, objects)) for objects in ([0, 2, 3, 5, 7], [1], [4, 6])]
    results, curves = run(table, tmp_path, Split("unseen", *of), epochs=2)
    assert results["rows"] == {"train": 100, "val": 20, "test": 40}
    assert all(0.5 < score["chance"] < 0.6 for score in results["directions"].values())  # of two objects
    assert all(0 < row[5] < 1 for row in curves)
    assert len({row[5] for row in curves}) > 1


def test_same_numbers_again_and_after_an_interruption(tmp_path, monkeypatch):
    table = Table()
    whole = run(table, tmp_path / "whole", epochs=3)

    class Interrupted(Exception):
        pass

    lines = []

    def stop_in_the_second_training(line):
        lines.append(line)
        if "vision and touch" in line and "epoch 2" in line:
            raise Interrupted

    split = per_sample(table.keys, table.count)
    job = Job(
        table, split, params(epochs=3), encoding("test_linear", SIZES), seed=3, progress=tmp_path / "cut"
    )
    with pytest.raises(Interrupted):
        retrieve(replace(job, report=stop_in_the_second_training))
    assert sorted(path.suffix for path in (tmp_path / "cut").iterdir()) == [".json", ".json", ".pt"]
    resumed = retrieve(replace(job, report=lines.append))
    assert len(lines) == len(set(lines)) == 9  # no epoch twice
    for results, _ in (whole, resumed):
        results.pop("seconds")
    assert resumed == whole
    assert {path.suffix for path in (tmp_path / "cut").iterdir()} == {".json"}


def test_correlations_are_found_once_for_all_seeds(tmp_path, monkeypatch):
    table = Table(3)
    first, _ = run(table, tmp_path, epochs=1)
    monkeypatch.setattr(retrieve_training, "_correlate", lambda *_: pytest.fail("found again"))
    more, _ = run(table, tmp_path, epochs=1, seeds=2)
    assert more["cca"] == first["cca"]
    for direction, score in more["directions"].items():
        assert score["cca"] == first["directions"][direction]["cca"]


@pytest.mark.parametrize(("modality", "size"), [("audio", (300, 8)), ("touch", (16, 16))])
def test_inputs_that_cannot_be_made_are_refused_before_any_training(tmp_path, monkeypatch, modality, size):
    monkeypatch.setattr(Job, "train", lambda *_, **__: pytest.fail("trained"))
    table = Table(3)
    sizes = replace(SIZES, **{{"audio": "spectrogram", "touch": "touch"}[modality]: size})
    job = Job(
        table, per_sample(table.keys, table.count), params(), encoding("test_linear", sizes), 3, tmp_path
    )
    for task in (retrieve, recognize, reconstruct):
        with pytest.raises(ObjectFolderError, match="is smaller than the encoder's"):
            task(job)
    assert max(len(rows) for _, rows in table.reads) == 1


def test_batches_without_negatives_are_no_settings():
    values = {"seed": 0, "sensor": "digit", "retrieve": vars(params(batch=2)), "encode": ENCODE}
    with pytest.raises(ObjectFolderError, match="retrieve: batch"):
        TASK.params(values)
    assert TASK.params(values | {"retrieve": vars(params(batch=3))}).settings.batch == 3


def test_finished_scores_are_taken_from_the_folder(tmp_path):
    table = Table(3)
    first = run(table, tmp_path, epochs=1)
    trained = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(trained) == 4  # a net of each pair, and CCA
    assert run(table, tmp_path, epochs=1) == first
    run(table, tmp_path, epochs=1, seeds=2)  # one more of each
    assert len(list(tmp_path.iterdir())) == 7
    assert all(path.read_bytes() == content for path, content in trained.items())
