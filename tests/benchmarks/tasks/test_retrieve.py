import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from encoding import encoding
from folders import contents
from made_up import Linear, MadeUp, hum, picture
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.datasets.splits import Split, per_sample
from objectfolder.benchmarks.models import two_stream
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import retrieve_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.naming import repeated_objects, score_within
from objectfolder.benchmarks.tasks.recognize_training import recognize
from objectfolder.benchmarks.tasks.reconstruct_training import reconstruct
from objectfolder.benchmarks.tasks.retrieve import TASK, RetrieveConfig, check_objects
from objectfolder.benchmarks.tasks.retrieve_training import retrieve
from objectfolder.benchmarks.tasks.task import Objects

DIRECTIONS = {"V->A", "A->V", "V->T", "T->V", "A->T", "T->A"}
SIZES = InputSizes(8, (16, 8), (8, 6))
PARAMS = RetrieveConfig(
    seeds=1, epochs=5, batch=16, learning_rate=0.03, weight_decay=0, patience=8, embedding=8
)


class Table(MadeUp):
    """A colour, a pitch and a stripe tell which object it is.

    With ``strangers`` the rows of each modality are those of objects of its own: nothing is shared.
    """

    def __init__(self, objects=6, strangers=False):
        rng, labels = np.random.default_rng(0), np.repeat(np.arange(objects), 20)
        colours = 60 + 150 * np.random.default_rng(1).random((objects, 3))
        seen, heard, felt = (rng.permutation(labels) if strangers else labels for _ in range(3))
        stripe = 100 + 80 * (np.arange(8) == felt[:, None] % 8)[:, :, None, None]
        touch = np.clip(stripe + rng.normal(0, 10, (len(labels), 8, 6, 3)), 0, 255).astype(np.uint8)
        arrays = {"vision": picture(colours[seen], 10, 15, rng), "audio": hum(700 * (1 + heard), rng)}
        super().__init__([f"object_{i}" for i in range(objects)], arrays | {"touch": touch})


def make_job(table, progress, split=None, sizes=SIZES, **changes):
    split = split or per_sample(table.keys, table.count)
    params = replace(PARAMS, **changes)
    return Job(table, split, params, encoding("linear", sizes), seed=3, progress=progress)


def run(*given, **changes):
    return retrieve(make_job(*given, **changes))


def unit(*degrees):
    angles = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    return torch.stack([angles.cos(), angles.sin()], dim=1).requires_grad_()


def by_definition(anchors, positives, labels, margin):
    """Equation 1: the mean over all anchors and rows of other objects in their modality."""

    def distance(a, b):
        return 1 - (a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    costs = [
        max(0, distance(anchor, positive) - distance(anchor, negative) + margin)
        for anchor, positive, label in zip(anchors, positives, labels)
        for negative, other in zip(anchors, labels)
        if other != label
    ]
    assert min(costs) == 0 < max(costs)
    return np.mean(costs)


def test_losses_are_those_of_the_paper():
    """Whatever the lengths; rows of one object are no negatives; both modalities are anchors."""
    rng = np.random.default_rng(0)
    first, second = (rng.normal(size=(6, 3)) * rng.uniform(0.1, 9, (6, 1)) for _ in range(2))
    labels = np.array([4, 9, 4, 2, 9, 4])
    given = *map(torch.from_numpy, (first, second, labels)), 0.4
    one, other = (by_definition(*pair, labels, 0.4) for pair in ((first, second), (second, first)))
    assert two_stream.triplet_loss(*given).item() == pytest.approx(one, rel=1e-6)
    assert two_stream.cross_sensory_loss(*given).item() == pytest.approx(one + other, rel=1e-6)


def test_no_gradient_where_the_margin_is_kept():
    first, second = unit(0, 90, 180), unit(3, 88, 181)
    loss = two_stream.cross_sensory_loss(first, second, torch.tensor([0, 1, 2]), 0.5)
    loss.backward()
    assert loss.item() == 0
    assert not first.grad.any()
    assert not second.grad.any()


def test_sixteen_bits_do_not_reach_the_distances():
    first, second, labels = unit(0, 1), unit(0.5, 1.5), torch.tensor([0, 1])
    with torch.autocast("cpu", torch.bfloat16):
        loss = two_stream.cross_sensory_loss(first, second, labels, 0.0)
    assert loss.item() == two_stream.cross_sensory_loss(first, second, labels, 0.0).item()


@pytest.mark.parametrize(
    ("objects", "rows_each", "batch"), [(2, 3, 3), (2, 5, 3), (7, 4, 9), (5, 8, 64), (3, 7, 4)]
)
def test_batches_pair_rows_of_one_object_and_hold_two_objects(objects, rows_each, batch):
    labels = np.repeat(np.arange(objects) * 10, rows_each)
    rows = 100 + np.arange(len(labels))
    for seed in range(20):
        batches = list(two_stream.paired_batches(rows, labels, batch, np.random.default_rng(seed)))
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
        batches = two_stream.paired_batches(np.arange(32), labels, 8, numpy_generator(0, str(number)))
        return np.concatenate([np.stack(pair, axis=1) for pair in batches])

    np.testing.assert_array_equal(epoch(1), epoch(1))
    assert {tuple(pair) for pair in epoch(1)} != {tuple(pair) for pair in epoch(2)}
    assert np.any(labels[epoch(1)[:, 0]] != labels[epoch(2)[:, 0]])
    assert np.mean(epoch(1)[:, 0] == epoch(1)[:, 1]) < 0.5


@pytest.mark.parametrize(
    ("labels", "batch", "message"),
    [([0] * 4, 4, "1 object"), ([0, 0, 1, 1], 2, "batches of 2"), ([0, 0, 0, 1], 4, "as many of each")],
)
def test_refuses_what_has_no_negatives(labels, batch, message):
    with pytest.raises(ObjectFolderError, match=message):
        list(two_stream.paired_batches(np.arange(4), np.array(labels), batch, np.random.default_rng(0)))


def test_one_object_to_rank_is_refused():
    labels, rows = np.repeat(np.arange(4), 10), np.arange(40)
    split = Split("unseen", rows[:20], rows[20:30], rows[30:])
    message = "split unseen tests on d alone, expected two objects or more"
    refused(message, check_objects, split, Objects([*"abcd"], labels))
    check_objects(Split("unseen", rows[:20], rows[20:30], rows[20:]), Objects([*"abcd"], labels))


def test_streams_share_the_head_and_nothing_else():
    net = two_stream.TwoStream([Linear(3), Linear(1)], 8, 5)
    views, sounds = torch.randn(2, 3, 8, 8), torch.randn(2, 1, 16, 8)
    embeddings = [net.embed(0, views), net.embed(1, sounds)]
    assert [x.shape for x in embeddings] == [(2, 8), (2, 8)]
    assert (embeddings[0] < 0).any()  # before the ReLU
    assert net.classify(embeddings[0]).shape == (2, 5)
    embeddings[0].sum().backward()
    reached = {name.split(".layer")[0] for name, value in net.named_parameters() if value.grad is not None}
    assert reached == {"encoders.0", "embedding.weight", "embedding.bias"}


def test_learns_what_the_senses_share(tmp_path):
    results, curves = run(Table(), tmp_path, seeds=2, epochs=8, embedding=16)
    assert set(results["directions"]) == DIRECTIONS | {"V->V", "A->A", "T->T"}
    for score in results["directions"].values():
        assert score["map"] == pytest.approx(np.mean(score["seeds"]))
        assert len(score["seeds"]) == len(score["named"]["seeds"]) == 2
        assert score["interval_95"] >= 0
        assert min(score["map"], score["cca"]) > 0.8
        assert score["named"]["map"] > 0.7
        assert 1 / 6 < score["chance"] < 0.4
    assert (results["objects"], results["rows"]) == (6, {"train": 96, "val": 12, "test": 12})
    assert results["duplicates"]["audio"] == {"val": 0, "test": 0}
    assert results["seconds"] > 0
    json.dumps(results, allow_nan=False)
    assert len(curves) <= 3 * 2 * 8
    assert {len(row) for row in curves} == {len(TASK.columns)}
    pairs = [("vision", "audio"), ("vision", "touch"), ("audio", "touch")]
    assert {tuple(row[:3]) for row in curves} == {(*pair, seed) for pair in pairs for seed in (0, 1)}


def test_pairs_start_from_encoders_that_name_the_objects(tmp_path, monkeypatch):
    table = Table()
    job = make_job(table, tmp_path, pretrain_epochs=4, schedule="one_cycle", epochs=1)
    _, curves = retrieve(job)
    alone = [row for row in curves if row[1] == ""]
    assert {row[0] for row in alone} == {"vision", "audio", "touch"}
    assert {row[3] for row in alone} == {1, 2, 3, 4}
    assert all(row[5] > 0.9 for row in alone if row[3] == 4)
    assert {path.suffix for path in tmp_path.iterdir()} == {".json"}

    namers = [retrieve_training._namer(job, modality, 0)[0] for modality in ("vision", "touch")]
    monkeypatch.setattr(Job, "train", lambda *_, **__: [])
    monkeypatch.setattr(retrieve_training, "_namer", lambda _, name, __: (namers[name == "touch"], []))
    net, _ = retrieve_training._train(job, ("vision", "touch"), 0, tmp_path / "none.pt")
    for encoder, namer in zip(net.encoders, namers):
        known = namer.state_dict()
        assert all(torch.equal(value, known[name]) for name, value in encoder.state_dict().items())


def test_rows_without_another_of_their_object_are_no_queries_within_a_sense():
    labels = np.array([5, 1, 1, 2, 5])
    rows = np.array([[1.0, 0], [0, 1], [0.1, 1], [1, 1], [-1, 0.2]])
    assert repeated_objects(labels, 4).tolist() == [0, 1, 2]
    # Row 0 finds its like last of four; rows 1 and 2 find each other first.
    assert score_within(rows, labels, 4) == pytest.approx((1 / 4 + 1 + 1) / 3)


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
    for name in ("vision", "audio"):
        from_tests = [np.isin(rows, split.test).any() for rows in table.reads[name]]
        assert sum(from_tests) == from_tests[-1] == 1


def test_unseen_objects_and_one_to_choose_the_epoch_by(tmp_path):
    table = Table(8)
    of = [np.flatnonzero(np.isin(table.labels, objects)) for objects in ([0, 2, 3, 5, 7], [1], [4, 6])]
    results, curves = run(table, tmp_path, Split("unseen", *of), epochs=2)
    assert results["rows"] == {"train": 100, "val": 20, "test": 40}
    assert all(0.5 < score["chance"] < 0.6 for score in results["directions"].values())  # of two objects
    assert all(0 < row[5] < 1 for row in curves)
    assert len({row[5] for row in curves}) > 1


def test_finished_scores_are_taken_from_the_folder_and_correlations_serve_all_seeds(tmp_path, monkeypatch):
    table = Table(3)
    first, curves = run(table, tmp_path, epochs=1)
    kept = contents(tmp_path)
    assert len(kept) == 4  # a net of each pair, and CCA
    assert run(table, tmp_path, epochs=1) == (first, curves)
    monkeypatch.setattr(retrieve_training, "_correlate", lambda *_: pytest.fail("found again"))
    more, _ = run(table, tmp_path, epochs=1, seeds=2)  # one more of each
    assert len(contents(tmp_path)) == 7
    assert contents(tmp_path) | kept == contents(tmp_path)
    assert more["cca"] == first["cca"]
    for direction, score in more["directions"].items():
        assert score["cca"] == first["directions"][direction]["cca"]


@pytest.mark.parametrize(("modality", "size"), [("audio", (300, 8)), ("touch", (16, 16))])
def test_inputs_that_cannot_be_made_are_refused_before_any_training(tmp_path, monkeypatch, modality, size):
    monkeypatch.setattr(Job, "train", lambda *_, **__: pytest.fail("trained"))
    table = Table(3)
    name = {"audio": "spectrogram", "touch": "touch"}[modality]
    job = make_job(table, tmp_path, sizes=replace(SIZES, **{name: size}))
    for task in (retrieve, recognize, reconstruct):
        refused("is smaller than the encoder's", task, job)
    assert max(len(rows) for reads in table.reads.values() for rows in reads) == 1


def test_batches_without_negatives_are_no_settings():
    values = {"seed": 0, "sensor": "digit", "retrieve": asdict(PARAMS), "encode": asdict(encoding())}
    assert TASK.params(values).settings == PARAMS
    values["retrieve"]["batch"] = 2
    refused("retrieve: batch", TASK.params, values)
