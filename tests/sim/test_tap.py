import numpy as np
import pytest

from objectfolder.sim.ears import OddEar, find_odd
from objectfolder.sim.tap import COST, TapEnv


@pytest.fixture(scope="module")
def env(brick):
    return TapEnv([brick], ["plastic", "wood", "steel"], seconds=0.05, count=3, limit=6)


def test_a_tap_is_heard_and_depends_on_the_seed_and_the_taps_before_only(env):
    first, _ = env.reset(seed=3)
    assert not first["sound"].any()
    assert (first["tapped"], first["taps"].tolist()) == (3, [0, 0, 0])
    heard, reward, ended, cut, _ = env.step(1)
    assert (reward, ended, cut) == (-COST, False, False)
    assert (heard["tapped"], heard["taps"].tolist()) == (1, [0, 1, 0])
    assert heard["sound"].any()
    again = env.step(1)[0]["sound"]
    assert again.tobytes() != heard["sound"].tobytes()  # another place
    env.reset(seed=3)
    assert env.step(1)[0]["sound"].tobytes() == heard["sound"].tobytes()
    assert env.step(1)[0]["sound"].tobytes() == again.tobytes()


def test_the_odd_one_is_of_another_material_and_all_are_of_nearly_one_size(env):
    for seed in range(8):
        _, info = env.reset(seed=seed)
        for k in range(3):
            env.step(k)
        voices = [env._voices[k] for k in range(3)]
        names = [voice.material.name for voice in voices]
        assert info["material"] != info["other"]
        odd = [k for k in range(3) if names[k] == env.materials[info["other"]]]
        assert odd == [info["odd"]]
        sizes = [voice.scale for voice in voices]
        assert sizes == info["scales"].tolist()
        assert max(sizes) / min(sizes) < 1.03 / 0.97


def test_an_ear_learns_to_tell_the_odd_one(rng):
    """Taps of the odd one are higher in one band; more taps make it surer."""
    stuff = np.zeros((140, 3), int)
    odd = rng.integers(3, size=140)
    stuff[np.arange(140), odd] = 1
    heard = rng.normal(size=(140, 3, 4, 5)).astype(np.float32)
    heard[..., 2] += 3 * stuff[:, :, None]
    ear = OddEar(heard[:100], odd[:100], stuff[:100], epochs=10)
    right, chances = [], []
    for taps in (1, 4):
        found = np.stack([ear([of[:taps] for of in row]) for row in heard[100:]])
        right.append((found.argmax(1) == odd[100:]).mean())
        chances.append(found.max(1).mean())
    assert found.sum(1) == pytest.approx(1)
    assert right[1] > 0.9
    assert chances[1] > chances[0]


def test_episodes_are_played_until_the_ear_is_sure(env):
    class Deaf:
        def __call__(self, heard):
            assert [len(of) for of in heard] in self.expected
            return np.array([0.3, 0.4, 0.3])

    deaf = Deaf()
    deaf.expected = [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 2, 1], [2, 2, 1]]
    _, info = env.reset(seed=1)
    found = find_odd(env, deaf, 0.5, seed=1)
    assert found["taps"] == 5  # the sixth would be the last
    assert found["right"] == (info["odd"] == 1)
    assert found["reward"] == pytest.approx(found["right"] - 5 * COST)
    assert find_odd(env, deaf, 0.4, seed=1)["taps"] == 1
