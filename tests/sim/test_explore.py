import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim.explore import AZIMUTHS, COST, HEIGHTS, ExploreEnv, Explorer, explore

PLACES = AZIMUTHS * HEIGHTS
MIDDLE = AZIMUTHS * (HEIGHTS // 2)  # of the places, from azimuth 0


@pytest.fixture(scope="module")
def env(brick):
    """A brick of 100 x 60 x 30 mm and a die."""
    return ExploreEnv([brick, "die"])


def test_a_policy_of_stable_baselines_takes_larger_images(brick):
    env = ExploreEnv([brick], reduction=3)
    assert env.observation_space["touch"].shape == (53, 40, 3)
    policy = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, seed=0).learn(8).policy
    action, _ = policy.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action.item())


def test_touches_meet_the_surface_where_the_ray_does(brick):
    """Of a brick: at half its length in front, half its width from the side, turned with its yaw."""
    env, places = ExploreEnv([brick]), np.array([0, 3, 6, 9])
    for turn, expected in ((0, [0.05, 0.03, 0.05, 0.03]), (np.pi / 2, [0.03, 0.05, 0.03, 0.05])):
        felt = env.feel(0, brick.scale, turn, places)
        assert felt.touched.all()
        assert felt.radius == pytest.approx(expected, abs=1e-3)
    twice = env.feel(0, 2 * brick.scale, np.pi / 2, [0])
    assert twice.radius == pytest.approx([0.06], abs=2e-3)
    assert (felt.images[0] != env.reset(seed=0)[0]["touch"]).any()


def test_above_a_low_object_nothing_is_felt(env, brick):
    top = np.arange(PLACES - AZIMUTHS, PLACES)
    felt = env.feel(0, brick.scale, 0.0, top)
    assert not felt.touched.any()
    assert not felt.radius.any()
    assert (felt.images == env.reset(seed=0)[0]["touch"]).all()


def test_the_place_is_that_of_the_contact_but_for_noise_and_depends_on_the_seed_only(env):
    env.reset(seed=3)
    felt, reward, ended, cut, info = env.step(3)
    assert (reward, ended, cut) == (-COST, False, False)
    found = env.feel(info["object"], info["scale"], info["yaw"], [3])
    assert felt["touched"] == 1
    assert felt["contact"][1] == pytest.approx(found.radius[0], abs=5e-3)
    assert abs(felt["contact"][0]) < 5e-3
    assert felt["touch"].tobytes() == found.images[0].tobytes()
    assert env.observation_space.contains(felt)
    env.reset(seed=3)
    assert env.step(3)[0]["contact"].tobytes() == felt["contact"].tobytes()


@pytest.fixture(scope="module")
def explorer(env):
    return Explorer(env, shapes=8, episodes=10)


def test_a_belief_names_objects_from_few_touches(env, explorer):
    played = [explore(env, explorer, 0.95, seed) for seed in range(12)]
    assert np.mean([one["right"] for one in played]) > 0.8
    assert np.mean([one["touches"] for one in played]) < 2.5
    assert all(one["reward"] == pytest.approx(one["right"] - COST * one["touches"]) for one in played)


def test_the_next_touch_is_where_objects_differ(env, explorer):
    """Only the die is as high as the upper places, so a touch there tells all."""
    explorer.restart()
    assert explorer.chances == pytest.approx([0.5, 0.5])
    place = explorer.next_place()
    env.reset(seed=0)
    explorer.learn(place, env.step(place)[0])
    assert explorer.chances.max() > 0.9


def test_a_vector_of_environments_feels_what_each_alone_does(brick):
    """Alike in all but the rounding of images; episodes that end make room for the next."""
    many = gymnasium.make_vec(
        "objectfolder.sim:ObjectFolder/Explore-v0", num_envs=3, vectorization_mode="vector_entry_point",
        objects=[brick, "die"], limit=3,
    )  # fmt: skip
    alone = [ExploreEnv([brick, "die"], limit=3) for _ in range(3)]
    observed, info = many.reset(seed=5)
    single = [env.reset(seed=5 + k) for k, env in enumerate(alone)]
    assert info["yaw"].tolist() == [first[1]["yaw"] for first in single]
    for actions in ([MIDDLE, MIDDLE + 4, 70], [3, PLACES, 17], [5, 6, 7], [8, 9, 10]):
        observed, reward, ended, cut, info = many.step(np.array(actions))
        assert many.observation_space.contains(observed)
        for k, env in enumerate(alone):
            seen, earned, over, truncated, told = env.step(actions[k])
            assert (reward[k], ended[k], cut[k]) == (earned, over, truncated)
            last = (
                info["final_obs"][k] if over or truncated else {name: of[k] for name, of in observed.items()}
            )
            assert last["touched"] == seen["touched"]
            assert last["contact"] == pytest.approx(seen["contact"], abs=1e-6)
            assert np.abs(last["touch"].astype(int) - seen["touch"]).max() <= 2
            if over or truncated:
                assert info["final_info"]["scale"][k] == told["scale"]
                _, told = env._begin(env.np_random)
            assert info["scale"][k] == told["scale"]
    with pytest.raises(ObjectFolderError, match="expected 3 whole numbers from 0 to 73"):
        many.step(np.array([0, 0, 74]))
    with pytest.raises(ObjectFolderError, match="one for each of 3"):
        many.reset(seed=[1, 2])
