import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from objectfolder.envs.drop import DropEnv
from objectfolder.envs.ears import BANDS, Ear, features
from objectfolder.errors import ObjectFolderError


@pytest.fixture(scope="module")
def env(brick):
    return DropEnv([brick], ["plastic", "wood"], seconds=0.05)


def test_the_checker_passes(brick):
    made = gymnasium.make(
        "objectfolder.envs:ObjectFolder/Drop-v0", objects=[brick], materials=["plastic"], seconds=0.03
    )
    check_env(made.unwrapped)


def test_a_fall_is_heard_from_its_first_contact_and_depends_on_the_seed_only(env, brick):
    sound, info = env.reset(seed=3)
    assert sound[0] != 0
    assert env.observation_space.contains(sound)
    assert 0.8 * brick.scale <= info["scale"] <= 1.25 * brick.scale
    assert env.reset(seed=3)[0].tobytes() == sound.tobytes()
    assert env.reset(seed=4)[0].tobytes() != sound.tobytes()


def test_rewards_are_half_for_the_object_and_half_for_the_material(env):
    for wrong, expected in ((0, 1.0), (1, 0.5)):
        _, info = env.reset(seed=5)
        answer = np.array([info["object"], (info["material"] + wrong) % 2])
        _, reward, ended, cut, after = env.step(answer)
        assert (reward, ended, cut, after) == (expected, True, False, info)


def test_environments_side_by_side_and_copies_agree(env, brick):
    def made():
        return DropEnv([brick], ["plastic", "wood"], seconds=0.05)

    many = gymnasium.vector.SyncVectorEnv([made, made])
    together, _ = many.reset(seed=[3, 4])
    assert together[1].tobytes() == env.reset(seed=4)[0].tobytes()
    env.reset(seed=6)
    copied = pickle.loads(pickle.dumps(env))
    assert copied.reset()[0].tobytes() == env.reset()[0].tobytes()


def test_wrong_calls_are_refused(brick):
    env = DropEnv([brick], ["wood"], seconds=0.02)
    with pytest.raises(ObjectFolderError, match="was not reset"):
        env.step(np.array([0, 0]))
    with pytest.raises(ObjectFolderError, match="has options"):
        env.reset(options={"height": 1})
    env.reset(seed=0)
    with pytest.raises(ObjectFolderError, match=r"numbers of an object below 1 and of a material below 1"):
        env.step(np.array([0, 3]))
    with pytest.raises(ObjectFolderError, match="unknown material 'cheese'"):
        DropEnv([brick], ["cheese"])
    with pytest.raises(ObjectFolderError, match="at least one object and one material"):
        DropEnv([])


def test_features_are_powers_in_bands(rng):
    """A tone of 1 Pa has half a Pa² in its own band, and 40 dB less elsewhere but beside it."""
    time = np.arange(8192) / 48000
    bands = features(np.sin(2 * np.pi * 3000 * time), 48000)[0]
    assert bands.shape == (15, BANDS)
    loudest = bands.mean(0).argsort()[::-1]
    assert 10 ** bands[:, loudest[0]] == pytest.approx(0.375 * 1.0, rel=0.6)
    assert bands.mean(0)[loudest[3]] < bands.mean(0)[loudest[0]] - 3
    assert (features(np.zeros(4096), 48000) == np.float32(-7)).all()


def test_an_ear_learns_what_is_to_be_heard(rng):
    answers = np.stack([rng.integers(2, size=200), rng.integers(3, size=200)], 1)
    heard = rng.normal(size=(200, 4, 6)).astype(np.float32)
    heard[:, :, 0] += 3 * answers[:, :1]
    heard[:, :, 1] += 3 * answers[:, 1:]
    ear = Ear(heard[:150], answers[:150], (2, 3), epochs=8)
    assert (ear(heard[150:]) == answers[150:]).mean() > 0.9
