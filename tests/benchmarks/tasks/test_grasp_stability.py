from dataclasses import replace

import numpy as np
import pytest
import torch
from encoding import encoding
from made_up import MadeUp
from refusals import refused

from objectfolder.benchmarks.datasets.splits import object_split, per_object, per_sample
from objectfolder.benchmarks.models import encoders
from objectfolder.benchmarks.models.baselines import BASELINES, predict_outcomes
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks.grasp_stability import TASK, GraspStabilityConfig
from objectfolder.benchmarks.tasks.grasp_stability_training import (
    COMPARED,
    TRANSFERRED,
    VARIANTS,
    StabilityNet,
    grasp_stability,
    join_streams,
    nested_order,
)
from objectfolder.benchmarks.tasks.job import Job

SIZES = InputSizes(image=8, spectrogram=(16, 8), touch=(99, 99))
PARAMS = GraspStabilityConfig(
    **{"sizes": (40, 1000), "epochs": 3, "epoch_grasps": 120, "hidden": 8, "touch": (4, 3)},
    **{"batch": 16, "learning_rate": 0.02, "patience": 3},
)
KEYS = ("tall_mug", "espresso_mug", "dotted_cube", "pocket_duck")  # the last is one of those for tests
RED, BLUE = (200, 60, 60), (60, 60, 200)


class FakeGrasps(MadeUp):
    """What tells the outcome is a colour under noise, where it is told at all.

    Pictures show ``seen`` and both fingers ``felt``, one each; default: the outcome.
    """

    has_explicit = True

    def __init__(self, count, seen=None, felt=None, explicit=None):
        rng = np.random.default_rng(count)
        rows = len(KEYS) * count
        self.success = rng.random(rows) < 0.5
        seen, felt = (self.success if shown is None else shown for shown in (seen, felt))
        colours = np.array([BLUE, RED])
        noise = 20 * rng.standard_normal((rows, 1, 10, 10, 3))
        touch = (colours[felt.astype(int)][:, None, None, None] + noise[..., :8, :6, :]).repeat(2, 1)
        image = colours[seen.astype(int)][:, None, None] + noise[:, 0]
        pictures = {"image": image, "touch": touch, "explicit": touch if explicit is None else explicit}
        arrays = {name: array.clip(0, 255).astype(np.uint8) for name, array in pictures.items()}
        numbers = {"width": rng.random(rows, np.float32), "offset": rng.standard_normal((rows, 3))}
        super().__init__(KEYS, arrays | numbers | {"force": rng.random(rows, np.float32)})


def _job(grasps, folder, split=None, **changes):
    split = split or per_sample(grasps.keys, grasps.count)
    return Job(grasps, split, replace(PARAMS, **changes), encoding("linear", SIZES), 1, folder)


def _run(grasps, folder, split=None, **changes):
    scores, curve = grasp_stability(_job(grasps, folder, split, **changes))
    return {name: value for name, value in scores.items() if name != "seconds"}, curve


def _random(count):
    return np.random.default_rng(5).random(len(KEYS) * count) < 0.5


def test_touch_decides_and_vision_does_not(tmp_path):
    scores, curve = _run(FakeGrasps(100, seen=_random(100)), tmp_path, sizes=[40, 160])
    assert list(scores["sizes"]) == ["40", "160"]
    found = scores["sizes"]["160"]
    assert set(found) == {"asked", "compared", *VARIANTS, *TRANSFERRED, *BASELINES}
    for name in ("T", "VT", "T_explicit", "VT_explicit", *TRANSFERRED):
        assert found[name]["accuracy"] > 0.9, name
        assert found[name]["auc"] > 0.95
        low, high = found[name]["wilson_95"]
        assert low < found[name]["accuracy"] <= high <= 1
    for name in ("V", *BASELINES):  # 40 answers at chance: deviation 0.08
        assert found[name]["accuracy"] == pytest.approx(0.5, abs=0.24), name
    assert found["VT"]["accuracy"] > found["V"]["accuracy"] + 0.2
    assert found["compared"]["VT - V"]["difference"] == pytest.approx(
        found["VT"]["accuracy"] - found["V"]["accuracy"]
    )
    assert len(TASK.columns) == len(curve[0])
    assert [tuple(row[:4]) for row in curve] == [
        (size, 0, name, epoch)
        for size in (40, 160)
        for name, arrays in VARIANTS.items()
        for epoch in range(1, (3 if len(arrays) == 1 else 1) + 1)
    ]
    assert (scores["objects"], scores["rows"]) == (4, {"train": 320, "val": 40, "test": 40})


def test_vision_decides_and_touch_does_not(tmp_path):
    found = _run(FakeGrasps(200, felt=_random(200)), tmp_path, sizes=[160])[0]["sizes"]["160"]
    assert found["asked"] == 160
    assert min(found["V"]["accuracy"], found["VT"]["accuracy"]) > 0.9
    assert found["T"]["accuracy"] == pytest.approx(0.5, abs=0.17)  # 80 answers: deviation 0.056


def test_the_same_touches_from_either_source_score_the_same(tmp_path):
    sizes = _run(FakeGrasps(20, seen=_random(20)), tmp_path, sizes=(40, 1000), epochs=1)[0]["sizes"]
    assert {size: found["asked"] for size, found in sizes.items()} == {"40": 40, "64": 1000}  # all there are
    for found in sizes.values():
        for explicit, implicit in COMPARED[2:]:
            assert found[explicit] == found[implicit]
            assert found["compared"][f"{explicit} - {implicit}"] == {"difference": 0, "interval_95": 0}


def test_other_touches_of_the_ground_truth_are_another_variant(tmp_path):
    """Nets of implicit touches take explicit ones for what they show: here the opposite."""
    told = FakeGrasps(50, seen=_random(50))
    opposite = 255 - told.arrays["touch"]
    found = _run(FakeGrasps(50, _random(50), explicit=opposite), tmp_path, sizes=[160])[0]["sizes"]["160"]
    assert min(found["T"]["accuracy"], found["T_explicit"]["accuracy"]) > 0.9
    assert found["T_on_explicit"]["accuracy"] < 0.1
    assert found["compared"]["T_on_explicit - T"]["difference"] == pytest.approx(
        found["T_on_explicit"]["accuracy"] - found["T"]["accuracy"]
    )


def test_without_ground_truth_the_rest_is_scored(tmp_path):
    grasps = FakeGrasps(20)
    whole = _run(grasps, tmp_path / "whole", sizes=[64], epochs=1)[0]["sizes"]["64"]
    del grasps.arrays["explicit"]
    grasps.has_explicit = False
    found = _run(grasps, tmp_path / "part", sizes=[64], epochs=1)[0]["sizes"]["64"]
    assert set(found) == {"asked", "compared", "V", "T", "VT", *BASELINES}
    assert set(found["compared"]) == {"T - V", "VT - V"}
    assert all(found[name] == whole[name] for name in ("V", "T", "VT", *BASELINES))


def test_nothing_is_learnt_of_shuffled_outcomes(tmp_path):
    """Rows that a net can remember one by one, but that say nothing about others."""
    grasps = FakeGrasps(100)
    split = per_sample(grasps.keys, grasps.count)
    rng = np.random.default_rng(3)
    for name, array in grasps.arrays.items():
        grasps.arrays[name] = rng.permutation(array)
    for rows in (split.train, split.val):
        grasps.success[rows] = rng.permutation(grasps.success[rows])
    for found in _run(grasps, tmp_path, split, epochs=1)[0]["sizes"].values():
        for name in (*VARIANTS, *BASELINES):  # 40 answers: deviation 0.08
            assert abs(found[name]["accuracy"] - 0.5) < 0.3, name


def test_unseen_objects_are_in_no_training_row(tmp_path):
    assert [object_split(key) for key in KEYS] == ["train", "train", "train", "test"]
    grasps = FakeGrasps(20)
    split = per_object(grasps.keys, grasps.count)
    scores, _ = _run(grasps, tmp_path, split, seeds=2, sizes=[100])
    assert scores["rows"] == {"train": 54, "val": 6, "test": 20}
    assert scores["sizes"]["54"]["T"]["accuracy"] > 0.9
    # Whatever was read for training and validation, the duck was read for tests alone: in the search for
    # duplicates, and once with each net.
    assert set(grasps.counts("touch")[60:]) == {2 * 2}  # T and VT with both seeds
    # V, VT, VT_explicit, and VT with explicit touches
    assert set(grasps.counts("image")[60:]) == {1 + 2 * 4}
    found = scores["sizes"]["54"]
    assert len(found["V"]["seeds"]) == 2
    assert found["object_majority"] == found["majority"]


def test_baselines_by_hand():
    """Object 0 mostly succeeds, object 1 mostly fails, object 2 is never learnt; wide grasps fail."""
    grasps = FakeGrasps(10)
    grasps.labels = np.repeat(np.arange(4), 10)
    grasps.labels[[22, 23]] = 0, 1
    train, test = np.arange(20), np.arange(20, 24)
    grasps.success[:20] = [True] * 8 + [False] * 2 + [True] * 4 + [False] * 6
    grasps.arrays["width"][:20] = np.where(grasps.success[:20], 0.1, 0.9)
    grasps.arrays["width"][test] = [0.1, 0.9, 0.9, 0.1]
    answers = predict_outcomes(grasps, train, test)
    assert answers["majority"].tolist() == pytest.approx([0.1] * 4)  # 12 of 20
    assert answers["object_majority"].tolist() == pytest.approx([0.1, 0.1, 0.3, -0.1])
    for name in ("geometry", "geometry_force"):
        assert (answers[name] > 0).tolist() == [True, False, False, True]
    # What trees of geometry alone say does not depend on the force.
    grasps.arrays["force"] = grasps.arrays["force"][::-1]
    assert (predict_outcomes(grasps, train, test)["geometry"] == answers["geometry"]).all()


def test_force_is_used_where_it_is_given():
    grasps = FakeGrasps(100)
    train, test = np.arange(200), np.arange(200, 400)
    grasps.arrays["force"] = np.where(grasps.success, 20, 10).astype(np.float32)
    answers = predict_outcomes(grasps, train, test)
    assert ((answers["geometry_force"] > 0) == grasps.success[test]).all()
    assert ((answers["geometry"] > 0) == grasps.success[test]).mean() < 0.65


def test_grasps_that_all_end_alike_are_refused(tmp_path):
    grasps = FakeGrasps(20)
    grasps.success[:] = True
    refused(r"seen: the first 64 training grasps all succeed.*both outcomes", _run, grasps, tmp_path)


def test_test_grasps_that_all_end_alike_have_no_curve(tmp_path):
    grasps = FakeGrasps(20)
    split = per_object(grasps.keys, grasps.count)
    grasps.success[split.test] = False
    found = _run(grasps, tmp_path, split, epochs=1, sizes=[30])[0]["sizes"]["30"]
    assert found["T"]["auc"] is found["majority"]["balanced_accuracy"] is None
    assert 0 <= found["T"]["accuracy"] <= 1


def test_smaller_numbers_are_part_of_larger_ones_and_even_over_objects():
    rows = np.flatnonzero(np.arange(400) % 10 < 8)
    labels = rows // 100
    order = nested_order(rows, labels, np.random.default_rng(0))
    assert sorted(order) == rows.tolist()
    for size in (1, 7, 100, 319):
        counts = np.bincount(order[:size] // 100, minlength=4)
        assert counts.max() - counts.min() <= 1
    assert (np.diff(order[labels[np.searchsorted(rows, order)] == 0]) < 0).any()  # not as they were
    assert (order != nested_order(rows, labels, np.random.default_rng(1))).any()


def test_fusion_starts_from_both_logits_with_the_prior_counted_once():
    torch.manual_seed(0)
    parts = [
        StabilityNet({stream: encoders.make_encoder("linear", modality)}, 5).eval()
        for stream, modality in (("V", "vision"), ("T", "touch"))
    ]
    inputs = {"V": torch.randn(3, 1, 3, 8, 8), "T": torch.randn(3, 2, 3, 8, 6)}
    joined = join_streams(parts, prior=0.75).eval()
    with torch.no_grad():
        torch.testing.assert_close(joined(inputs), sum(part(inputs) for part in parts) - 0.75)
        swapped = inputs | {"T": inputs["T"].flip(1)}
        assert (parts[1](swapped) != parts[1](inputs)).all()  # left and right are told apart
        for parameter in joined.parameters():
            parameter.zero_()
    assert all(part.first.weight.any() for part in parts)  # theirs are copies
