import dataclasses
import json

import numpy as np
import pytest
from encoding import encoding
from made_up import MadeUp

from objectfolder.benchmarks.datasets.splits import per_sample
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import vision_to_touch_training as task
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.touch_to_vision import TouchToVisionConfig
from objectfolder.benchmarks.tasks.touch_to_vision_training import touch_to_vision
from objectfolder.benchmarks.tasks.vision_to_touch import TASK, VisionToTouchConfig
from objectfolder.benchmarks.tasks.vision_to_touch_training import score_answers, vision_to_touch

SIZE = (16, 12)


def pairs(count=60, seed=0):
    """Views of a bright bar on dark ground; touches show the same bar in red on grey."""
    rng = np.random.default_rng(seed)
    bar = np.zeros((2 * count, *SIZE, 1), bool)
    for row, start in zip(bar, rng.integers(0, SIZE[0] - 3, 2 * count), strict=True):
        row[start : start + 3] = True
    view = np.where(bar, 220, 40) + rng.integers(-9, 10, (2 * count, *SIZE, 3))
    touch = np.where(bar, (200, 100, 100), (100, 100, 100))
    return MadeUp("ab", {"view": view.astype(np.uint8), "touch": touch.astype(np.uint8)})


def job(progress, samples=None, **changed):
    values = {"seeds": 1, "contacts": 60, "width": 4, "epochs": 15, "batch": 16}
    values |= {"learning_rate": 0.02, "weight_decay": 0.0, "patience": 15}
    samples = pairs() if samples is None else samples
    split, sizes = per_sample(samples.keys, samples.count), InputSizes(8, (8, 8), SIZE)
    settings = VisionToTouchConfig(**(values | changed))
    return Job(samples, split, settings, encoding("resnet18", sizes), seed=1, progress=progress)


def test_the_net_draws_what_the_view_shows(tmp_path):
    scores, curve = vision_to_touch(job(tmp_path))
    blank = scores["mean"]["psnr"]
    assert scores["net"]["psnr"] > blank + 8
    assert scores["net"]["ssim"] > scores["mean"]["ssim"]
    # The bar of the nearest view lies where that of the test view does, or one row beside it.
    assert scores["nearest"]["psnr_pooled"] > blank + 3
    assert scores["rows"] == {"train": 96, "val": 12, "test": 12}
    assert {len(row) for row in curve} == {len(TASK.columns)}
    drawn = (tmp_path / "sheet.png").read_bytes()
    (tmp_path / "sheet.png").unlink()  # moved to the results
    assert vision_to_touch(job(tmp_path))[0] == scores
    assert (tmp_path / "sheet.png").read_bytes() == drawn
    json.dumps(scores, allow_nan=False)


def back(progress, samples, **changed):
    there = job(progress, samples, **changed)
    kept = {name: value for name, value in vars(there.params).items() if name != "contacts"}
    return dataclasses.replace(there, params=TouchToVisionConfig(**kept))


def test_the_net_draws_the_view_of_what_is_felt(tmp_path):
    scores, curve = touch_to_vision(back(tmp_path, pairs()))
    assert scores["net"]["psnr_pooled"] > scores["mean"]["psnr_pooled"] + 8
    assert scores["net"]["ssim"] > scores["mean"]["ssim"]
    assert scores["nearest"]["psnr_pooled"] > scores["mean"]["psnr_pooled"] + 3
    assert {len(row) for row in curve} == {len(TASK.columns)}
    assert (tmp_path / "sheet.png").is_file()


def test_spots_that_feel_alike_are_tested_if_they_look_different(tmp_path):
    """The bar has fourteen places, so that most touches repeat; its noise makes each view new."""
    scores, _ = touch_to_vision(back(tmp_path / "new", pairs(), epochs=1))
    assert scores["rows"] == {"train": 96, "val": 12, "test": 12}
    same = pairs()
    for array in same.arrays.values():
        array[:60] = 0  # the first object looks and feels the same everywhere, and like no other
    scores, _ = touch_to_vision(back(tmp_path / "same", same, epochs=1))
    assert scores["rows"] == {"train": 96, "val": 6, "test": 6}
    assert scores["untested"] == {"all": ["a"]}


def test_views_that_say_nothing_give_the_mean_touch(tmp_path):
    blind = pairs()
    blind.arrays["view"] = np.random.default_rng(1).integers(0, 255, (120, *SIZE, 3), np.uint8)
    scores, _ = vision_to_touch(job(tmp_path, blind, epochs=4, patience=4))
    assert scores["net"]["psnr"] == pytest.approx(scores["mean"]["psnr"], abs=1.0)
    assert scores["nearest"]["psnr"] < scores["mean"]["psnr"]


def test_the_pooled_error_chooses_the_epoch(tmp_path, monkeypatch):
    """One touch that is wrong counts as much as it is wrong, however many others are exact."""

    def answers(job, way, net, blank, rows):
        found = job.observations.read("touch", rows)
        found[0] = found[0] - 51  # a fifth of the range: 14 dB
        return found

    monkeypatch.setattr(task, "_answers", answers)
    scores, curve = vision_to_touch(job(tmp_path, epochs=1))
    assert scores["rows"]["val"] == 12
    assert curve[0][TASK.columns.index("val_psnr")] == pytest.approx(13.979 + 10 * np.log10(12), abs=0.01)


def test_scores_of_images():
    truth = np.full((2, 16, 12, 3), 100, np.uint8)
    off = truth.copy()
    off[0] += 51  # a fifth of the range: 14 dB
    scores = score_answers(off, truth)
    assert scores["psnr"] == pytest.approx((13.979 + 58.92) / 2, abs=0.01)
    assert scores["psnr_pooled"] == pytest.approx(13.979 + 3.010, abs=0.01)
    assert score_answers(truth, truth)["ssim"] == pytest.approx(1)
