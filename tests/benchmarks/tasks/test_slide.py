import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from brick import without
from encoding import encoding

from objectfolder.benchmarks.models.displacement import SHIFT, compared, matches
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import slide_training
from objectfolder.benchmarks.tasks.job import ObjectJob
from objectfolder.benchmarks.tasks.slide import SENSES, TASK, SlideConfig
from objectfolder.benchmarks.tasks.slide_training import CLUSTER, slide_object
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import sliding

SIZES = InputSizes(8, (16, 8), (20, 15))


def job(file, progress, **changed):
    values = {"contacts": 80, "episodes": 4, "epochs": 1, "batch": 32, "patience": 9}
    settings = SlideConfig(**(values | changed))
    return ObjectJob("slide", file, None, settings, 0, progress, encode=encoding("linear", SIZES))


@pytest.fixture(scope="module")
def played(brick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("progress")
    return slide_object(job(brick, folder, seeds=2)), folder


def test_scores_are_of_all_policies_and_senses(played):
    (scores, curve), folder = played
    json.dumps(scores)
    for way in sliding.SLIDES:
        found = scores[way]
        assert list(found["net"]) == list(found["descent"]) == list(SENSES)
        assert found["oracle"]["success"] == 1
        assert found["still"]["success"] <= 0.25
        assert found["oracle"]["distance"] < sliding.SLIDES[way].near
        assert len(found["net"]["TV"]["seeds"]) == 2
    assert [row[:4] for row in curve[:3]] == [
        [0, "refine", "T", 1],
        [0, "refine", "V", 1],
        [0, "refine", "TV", 1],
    ]
    assert (folder / "sheet.png").is_file()
    [table] = TASK.tables({"brick": scores})
    assert [row[0] for row in table.rows] == 9 * ["refinement"] + 9 * ["traversal"]


def test_a_second_call_trains_nothing_and_answers_the_same(played, brick, monkeypatch):
    scores, folder = played
    monkeypatch.setattr(slide_training, "_train", None)
    again = slide_object(job(brick, folder, seeds=2))
    assert again == scores


def test_an_object_that_is_not_seen_is_felt_alone(brick, tmp_path):
    scores, _ = slide_object(job(without(brick, "vision"), tmp_path))
    assert list(scores["refine"]["net"]) == ["T"]


def test_pairs_are_of_neighbours_and_motions_lead_from_one_to_the_other(brick, tmp_path):
    way = slide_training._Way.of(job(brick, tmp_path), sliding.REFINE, ("touch",))
    assert len(way.pairs) == 80 * (CLUSTER - 1)
    assert (way.pairs[:, 0] // CLUSTER == way.pairs[:, 1] // CLUSTER).all()
    back = {(first, second): motion for (first, second), motion in zip(way.pairs.tolist(), way.motions)}
    lengths = np.array([[np.hypot(*back[a, b][:2]), np.hypot(*back[b, a][:2])] for a, b in back])
    flat = abs(lengths[:, 0] - lengths[:, 1]) < 0.05
    assert flat.mean() > 0.7  # elsewhere the surface bends between them
    assert lengths.max() <= 2.02 * sliding.REFINE.distance[1] / sliding.REFINE.step


def scene(shift=(0, 0), turn=0.0):
    """40 x 30 pixels of a pattern that is shifted, right and down, and turned about the middle."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:40, :30] + 0.5 - np.array([20, 15])[:, None, None]
    cos, sin = np.cos(turn), np.sin(turn)
    u, v = cos * x - sin * y - shift[0], sin * x + cos * y - shift[1]
    waves = rng.normal(size=(200, 2)) / 2
    picture = sum(np.sin(a * u + b * v + k) for k, (a, b) in enumerate(waves))
    return torch.from_numpy(np.repeat(picture[None, None], 3, 1)).float()


def test_pictures_match_best_where_they_are_alike():
    here = scene()
    [[found]] = matches(here, here).numpy()
    assert np.unravel_index(found.argmax(), found.shape) == (3, SHIFT, SHIFT)
    [[found]] = matches(
        scene(), scene((-4, 6))
    ).numpy()  # pixels; of halved pictures 2 to the left and 3 down
    assert np.unravel_index(found.argmax(), found.shape) == (3, SHIFT - 3, SHIFT + 2)
    turns = [matches(here, scene(turn=angle))[0, 0].amax((1, 2)).argmax() for angle in (-0.35, 0.35)]
    assert sorted(int(turn) for turn in turns) == [1, 5]  # of 20 degrees either way
    assert compared(torch.cat([here, here], 1), torch.cat([here, here], 1)).isfinite().all()


@pytest.mark.slow
def test_more_goals_are_reached_than_without_learning(tmp_path):
    settings = {"contacts": 1200, "episodes": 40, "epochs": 20, "batch": 64}
    wide = encoding("linear", InputSizes(8, (16, 8), (80, 60)))
    asked = job(ObjectFile.sample("mug"), tmp_path, **settings)
    scores, _ = slide_object(replace(asked, encode=wide))
    for way, more in (("refine", 0.2), ("traverse", 0.05)):
        learned = scores[way]["net"]["TV"]["success"]
        assert learned > scores[way]["random"]["success"] + more
        assert learned > scores[way]["still"]["success"] + more
