import numpy as np
import pytest
from brick import without
from refusals import refused

from objectfolder.base.materials import friction_of
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import drop
from objectfolder.sim.drop import DropEnv
from objectfolder.sim.ears import BANDS, BINS, HEARING_THRESHOLD, Ear, features
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.tap import TapEnv


@pytest.fixture(scope="module")
def env(brick):
    return DropEnv([brick], ["plastic", "wood"], seconds=0.05)


def test_a_fall_is_heard_from_its_first_contact_and_depends_on_the_seed_only(env, brick):
    sound, info = env.reset(seed=3)
    assert sound[0] != 0
    assert env.observation_space.contains(sound)
    assert 0.8 * brick.scale <= info["scale"] <= 1.25 * brick.scale
    assert env.reset(seed=3)[0].tobytes() == sound.tobytes()
    assert env.reset(seed=4)[0].tobytes() != sound.tobytes()


def test_hearing_begins_before_any_contact(env, monkeypatch):
    """Even where the object's spin turns another point down than the one that was lowest."""
    begun = []

    def reset(self, data=None):
        begun.extend([] if data is None else [data.ncon])
        return Hearing.reset(self, data)

    monkeypatch.setattr("objectfolder.sim.drop.Hearing", type("Watched", (Hearing,), {"reset": reset}))
    env.reset(seed=0)
    for speed in (3.0, 6.0, 12.0):
        env._simulate(1.0, 0.2, np.array([1.0, 0, 0, 0]), np.array([speed, speed, 0]))
    assert begun == [0] * 4


def test_features_are_levels_and_loss_factors_of_bands():
    """A tone of 1 Pa that decays with a loss factor of 0.004 is loudest, and fades so, in its own band."""
    time, hertz = np.arange(8192) / 48000, 3000
    tone = np.sin(2 * np.pi * hertz * time) * np.exp(-np.pi * hertz * 0.004 * time)
    found = features(np.stack([tone, 0 * tone]), 48000)
    loudest, centre, known = (found[:, k * BANDS : (k + 1) * BANDS] for k in (1, 2, 3))
    quartiles = found[:, 4 * BANDS : 7 * BANDS].reshape(2, BANDS, 3)
    band = int(np.log(hertz / 200) / np.log(24000 / 200) * BANDS)
    assert loudest[0].argmax() == band
    assert 10 ** loudest[0, band] == pytest.approx(0.25, rel=0.5)
    assert known[0, band] == 1
    assert centre[0, band] == pytest.approx(1, abs=0.05)
    assert 10 ** quartiles[0, band] == pytest.approx(0.004, rel=0.02)
    histogram = found[:, 7 * BANDS :].reshape(2, -1, BINS)[:, -1]
    assert histogram[0].argmax() == int((np.log10(0.004) + 4.5) / 4.5 * BINS)
    assert not known[1].any()
    assert not histogram[1].any()
    assert loudest[1] == pytest.approx(np.log10(HEARING_THRESHOLD))
    refused("have 100 samples, expected at least 2048", features, np.zeros(100), 48000)


def test_an_ear_learns_what_is_to_be_heard(rng):
    answers = np.stack([rng.integers(2, size=200), rng.integers(3, size=200)], 1)
    heard = rng.normal(size=(200, 6)).astype(np.float32)
    heard[:, 0] += 4 * answers[:, 0]
    heard[:, 1] += 4 * answers[:, 1]
    ear = Ear(heard[:150], answers[:150], (2, 3), epochs=20)
    assert (ear(heard[150:]) == answers[150:]).mean() > 0.9


def test_the_friction_of_a_fall_is_that_of_the_drawn_material(brick, monkeypatch):
    found, add = set(), drop.add_body

    def record(spec, body, name):
        found.add(body.friction)
        return add(spec, body, name)

    monkeypatch.setattr(drop, "add_body", record)
    DropEnv([brick], ["steel"], seconds=0.02).reset(seed=0)
    assert found == {friction_of("steel")}
    assert friction_of(brick.material) != friction_of("steel")


@pytest.mark.parametrize("make", [DropEnv, TapEnv])
def test_objects_that_would_only_click_are_refused_at_once(make):
    refused(r"die of ceramic and 0\.1\d* m has its lowest mode at 12", make, sample_rate=16000)
    refused("bell: the file holds no audio", make, [without(ObjectFile.sample("bell"), "audio")])
    make(["bell"], ["steel", "wood"])
