import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from brick import with_images
from encoding import encoding
from made_up import MadeUp, hum
from refusals import refused

from objectfolder.base.arrays import write_npz
from objectfolder.benchmarks.datasets.contacts import contact_split, sample_contacts
from objectfolder.benchmarks.models.localizer import SOFTNESS, add_beliefs, choose_likeliest
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import localize_training
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.localize import TASK, LocalizeConfig
from objectfolder.benchmarks.tasks.localize_training import localize
from objectfolder.objectfile.file import ObjectFile

SIZES = InputSizes(8, (16, 8), (8, 6))
COUNT = 400


def square(seed=0, sounds=True):
    """Return contacts on a unit square: touches and views show x as a brightness, sounds tell y by pitch."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (COUNT, 2)), np.zeros(COUNT)])
    level = 128 + 200 * points[:, 0, None, None, None]
    touch = np.clip(level + rng.normal(0, 3, (COUNT, 8, 6, 3)), 0, 255).astype(np.uint8)
    audio = hum(2500 + 4000 * points[:, 1], rng) * np.float32(sounds)
    vision = np.broadcast_to(255 - touch.mean((1, 2, 3), keepdims=True), (COUNT, 8, 8, 3)).astype(np.uint8)
    return MadeUp(["square"], {"touch": touch, "audio": audio, "vision": vision, "point": points})


def job(progress, samples=None, **changed):
    values = {"seeds": 1, "contacts": COUNT, "epochs": 25, "batch": 32, "learning_rate": 0.01}
    settings = LocalizeConfig(**(values | {"weight_decay": 0.0, "patience": 25} | changed))
    samples = square() if samples is None else samples
    return Job(samples, contact_split(COUNT), settings, encoding("linear", SIZES), seed=1, progress=progress)


def test_the_answer_has_the_least_expected_distance():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    distances = np.linalg.norm(line[:, None] - line, axis=2)
    shares = np.array([[0.3, 0.3, 0.4], [0.1, 0.2, 0.7], [1, 0, 0]])
    beliefs = np.log(np.maximum(shares, 1e-300)) + np.array([[5.0], [-900.0], [0]])  # constants do not matter
    # The first row's median is the middle place, although the third is the likeliest.
    np.testing.assert_array_equal(choose_likeliest(beliefs, distances), [1, 2, 0])
    np.testing.assert_array_equal(np.argmin(shares @ distances, 1), [1, 2, 0])


def test_moves_between_contacts_resolve_what_each_leaves_open():
    # Places on a line. The last contact was at 0.3 or 0.7, the one before at 0.5 or 0.9, and 0.2 beyond it:
    # 0.3 -> 0.5 and 0.7 -> 0.9 agree with both. A third at 0.9, 0.6 beyond the last, leaves 0.3 alone.
    places = np.column_stack([np.arange(11) / 10, np.zeros((11, 2))])

    def belief(*at):
        found = np.full(11, -20.0)
        found[np.round(np.array(at) * 10).astype(int)] = 0
        return found

    two = add_beliefs(
        np.stack([belief(0.5, 0.9), belief(0.3, 0.7)]), np.array([[0.2, 0, 0], [0, 0, 0]]), places
    )
    assert set(np.flatnonzero(two > two.max() - 1)) == {3, 7}
    three = add_beliefs(
        np.stack([belief(0.9), belief(0.5, 0.9), belief(0.3, 0.7)]),
        np.array([[0.6, 0, 0], [0.2, 0, 0], [0, 0, 0]]),
        places,
    )
    assert np.argmax(three) == 3
    # From 0.7 the first contact would have been 0.3 beyond the last place.
    assert three[7] == pytest.approx(belief(0.9)[10] - 0.3**2 / (2 * SOFTNESS**2))


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    return localize(job(tmp_path_factory.mktemp("progress")))


def test_two_senses_find_what_one_leaves_open(learnt):
    scores, curve = learnt
    # One coordinate known, the other uniform: the best answer is a quarter off. Both unknown: 0.38.
    assert scores["constant"] == pytest.approx(0.38, abs=0.04)
    assert scores["random"] == pytest.approx(0.52, abs=0.04)
    for one in ("T", "A", "V"):
        assert 0.2 < scores[one]["net"]["mean"] < 0.3
        assert 0.2 < scores[one]["nearest"]["mean"] < 0.4
    assert scores["TA"]["net"]["mean"] < 0.08
    assert scores["TA"]["net"]["median"] < 0.06
    assert scores["TVA"]["net"]["mean"] < 0.08
    assert scores["TV"]["net"]["mean"] > 0.2  # both show x
    # 320 contacts on the square: the nearest one is 0.5 / sqrt(320) = 0.028 away on average.
    assert 0.025 < scores["TA"]["nearest"]["mean"] < 0.045
    # Eight contacts on a line of equal x still leave y open but for the square's ends.
    assert scores["T"]["net"]["together"] < 0.7 * scores["T"]["net"]["mean"]
    assert {len(row) for row in curve} == {len(TASK.columns)}
    assert scores["contacts"] == {"train": 320, "val": 40, "test": 40}
    json.dumps(scores, allow_nan=False)


def test_the_normalized_error_is_of_the_diameter(learnt):
    scores = learnt[0] | {
        "diameter": localize_training._diameter(np.random.default_rng(0).normal(size=(4, 3)))
    }
    [table] = TASK.tables({"square": scores})
    rows = {row[0]: dict(zip(table.columns, row)) for row in table.rows}
    expected = 100 * scores["VA"]["net"]["mean"] / scores["diameter"]
    assert rows["close view + sound"]["normalized"] == f"{expected:.1f}"
    assert "close view + sound 1.76, touch + close view + sound 1.84, not comparable" in table.note
    corners = np.array(np.meshgrid([0, 1], [0, 2], [0, 2], indexing="ij")).reshape(3, 8).T
    assert localize_training._diameter(corners) == pytest.approx(3)


def test_silence_tells_nothing(tmp_path):
    scores, _ = localize(job(tmp_path, square(sounds=False), epochs=4))
    assert scores["A"]["net"]["mean"] == pytest.approx(scores["constant"], rel=0.1)
    assert scores["A"]["nearest"]["mean"] > 0.9 * scores["constant"]


def test_contacts_are_touched_and_struck_at_the_same_points():
    file = ObjectFile.sample("bell")
    contacts = sample_contacts(file, 20, seed=2, side=12)
    points = contacts.read("point", np.arange(20))
    assert np.abs(file.surface.grid.distance(torch.from_numpy(points).float()).numpy()).max() < 2e-3
    again = sample_contacts(file, 20, seed=2, side=12)
    assert contacts.shape("vision") == (12, 12, 3)
    for name in ("touch", "audio", "vision"):
        np.testing.assert_array_equal(contacts.read(name, np.arange(20)), again.read(name, np.arange(20)))
    sound = contacts.read("audio", np.array([3]))[0]
    direction = -file.surface.grid.normals(torch.from_numpy(points[3:4]).float()).numpy()[0]
    expected = file.impact(
        points[3:4] * file.scale, direction[None], 16000, 2.0, "displacement", contact_time=0
    )
    assert np.linalg.norm(sound - expected[0]) < 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("count", [70, 85, 0])
def test_too_few_contacts_for_a_sequence(count):
    refused(f"localize.contacts is {count}", contact_split, count)


def test_every_contact_is_in_one_part():
    split = contact_split(200)
    rows = np.concatenate([split.train, split.val, split.test])
    np.testing.assert_array_equal(np.sort(rows), np.arange(200))
    assert [len(split.train), len(split.val), len(split.test)] == [160, 20, 20]


def test_a_net_of_one_press_is_asked_for_that(brick):
    file = with_images(brick, 0.0012, 0.3)
    contacts, rows = sample_contacts(file, 20, seed=2, side=12), np.arange(20)
    expected = file.touch(contacts.read("point", rows) * file.scale, 0.0012, 0.3)
    np.testing.assert_array_equal(contacts.read("touch", rows), expected)


def test_the_weight_of_touch_is_chosen_on_the_validation_contacts(tmp_path, monkeypatch):
    made = job(tmp_path, epochs=2)
    right = np.array([[0.0, -9], [0, -9]])  # logarithms: sound, and touch that contradicts it
    wrong = right[:, ::-1] * 3
    write_npz(tmp_path / "0_A.npz", val=right, test=wrong)
    write_npz(tmp_path / "0_T.npz", val=wrong, test=right)
    truth = np.zeros((len(made.split.val), 3))
    places = np.array([[0.0, 0, 0], [1, 0, 0]])
    setting = SimpleNamespace(
        errors=lambda belief, truth: np.linalg.norm(places[belief.argmax(1)], axis=1) + 0 * truth[:2, 0]
    )
    monkeypatch.setattr(made.observations, "read", lambda name, rows: truth)
    weights = localize_training._choose_weights(made, setting, 0, "TA")
    assert weights == [0.25, 1]  # the others follow the wrong sense
    np.testing.assert_allclose(localize_training._joint(made, 0, "TA", "test", weights), wrong + 0.25 * right)
