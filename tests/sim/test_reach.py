import sys
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import trimesh
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.benchmarks.tasks.reach_training import controller, run_episodes
from objectfolder.sim import reach
from objectfolder.sim.reach import HAND_START, TIP, ReachEnv, reward


def _play(env, steps, *action):
    """Take the same action some times; return the last observation."""
    for _ in range(steps):
        observation, *_ = env.step(np.array(action, np.float32))
    return observation


def _trajectory(env, seed, steps=60):
    rng = np.random.default_rng(3)
    observation, _ = env.reset(seed=seed)
    seen = [observation]
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        seen += [observation, np.array([reward])]
    return np.concatenate(seen).tobytes()


def test_the_environment_takes_a_file_and_its_hulls(brick, brick_path):
    hulls = [brick.to_mesh().convex_hull]
    given = [ReachEnv(file, hulls) for file in (brick, brick_path, str(brick_path))]
    first, *others = [_trajectory(env, 5, 5) for env in given]
    assert others == [first, first]


def test_same_seed_same_bytes_and_another_seed_others(body):
    env = ReachEnv(body)
    first = _trajectory(env, 0)
    assert _trajectory(env, 1) != first
    assert _trajectory(env, 0) == first == _trajectory(ReachEnv(body), 0)


def test_an_observation_is_state_previous_state_and_goal(body):
    env = ReachEnv(body)
    first, info = env.reset(seed=2)
    assert info == {}
    assert first[:18].tobytes() == first[18:36].tobytes()
    np.testing.assert_array_equal(first[:3], HAND_START)
    assert first[3] == 1  # 0.1 m open
    np.testing.assert_allclose(first[6], 0.015, atol=2e-4)  # half the brick's height: it stands on the table
    np.testing.assert_array_equal(first[7:18], [0, 0, 0, 1, *np.zeros(7)])
    np.testing.assert_array_equal(first[36:], env.goal)
    second = _play(env, 1, 0, 0, 1, 0)
    assert second[18:36].tobytes() == first[:18].tobytes()
    assert second[2] > first[2]
    np.testing.assert_array_equal(second[36:], first[36:])


def test_the_quaternion_ends_with_its_real_part(body):
    env = ReachEnv(body)
    env.reset(seed=0)
    start = env.model.joint("object").qposadr[0]
    env.data.qpos[start + 3 : start + 7] = [np.cos(0.3), 0, 0, np.sin(0.3)]  # w first, as MuJoCo has it
    observation = _play(env, 1, 0, 0, 0, 0)
    np.testing.assert_allclose(observation[7:11], [0, 0, np.sin(0.3), np.cos(0.3)], atol=5e-3)


def test_the_hand_follows_its_target_and_stops_there(body):
    """1 cm for each step at full action; and the way that Meta-World's hand is behind: about 4 cm."""
    env = ReachEnv(body)
    env.reset(seed=0)
    assert 0.02 < 0.7 - _play(env, 10, 0, 1, 0, 0)[1] < 0.04  # Meta-World 3.1.1: 0.037
    np.testing.assert_allclose(_play(env, 40, 0, 0, 0, 0)[:3], [0, 0.7, 0.2], atol=1e-4)
    edge = _play(env, 60, 1, 1, -1, 0)[:3]  # of its space
    np.testing.assert_allclose(edge, [0.5, 1.0, 0.05], atol=1e-3)


def test_the_gripper_closes_at_positive_action_only(body):
    env = ReachEnv(body)
    env.reset(seed=0)
    closed, opened = _play(env, 60, 0, 0, 0, 1)[3], _play(env, 60, 0, 0, 0, -1)[3]
    assert closed == pytest.approx(0.3, abs=0.01)  # Meta-World's fingers move 40 and 30 mm
    assert opened == pytest.approx(1, abs=0.01)


def test_reward_by_hand():
    assert reward(0.05, 0.3) == reward(0.0, 0.3) == 10
    assert reward(0.05 + 0.3, 0.3) == pytest.approx(1)  # a tenth at the margin
    assert reward(0.05 + 0.1, 0.3) == pytest.approx(10 / (1 + 9 / 9))  # a third of it: 9 d^2 = 1
    assert reward(0.05 + 0.2, 0.1) == pytest.approx(10 / (1 + 9 * 4))


def test_a_step_is_rewarded_for_the_fingertips_and_reports_success(body):
    env = ReachEnv(body, horizon=60)
    observation, _ = env.reset(seed=4)
    margin = np.linalg.norm(HAND_START - env.goal)
    successes = []
    for step in range(60):
        way = env.goal - TIP - observation[:3]
        action = np.append(np.clip(30 * way, -1, 1), 0)
        observation, got, terminated, truncated, info = env.step(action.astype(np.float32))
        distance = np.linalg.norm(observation[:3] + TIP - env.goal)
        assert info["distance"] == pytest.approx(distance, abs=1e-12)
        assert info["success"] == (distance <= 0.05)
        assert got == reward(info["distance"], margin)
        assert not terminated
        assert truncated == (step == 59)
        successes.append(info["success"])
    assert successes[0] == 0
    assert successes[-1] == 1


def test_objects_and_goals_fill_their_ranges_and_keep_apart():
    rng = np.random.default_rng(0)
    places, goals = map(np.array, zip(*(reach.draw_placement(rng) for _ in range(2000))))
    for values, name in ((places, "OBJECT"), (goals, "GOAL")):
        low, high = getattr(reach, f"{name}_LOW"), getattr(reach, f"{name}_HIGH")
        assert ((low <= values) & (values <= high)).all()
        np.testing.assert_allclose([values.min(0), values.max(0)], [low, high], atol=0.005)
    assert np.linalg.norm(places - goals[:, :2], axis=1).min() >= reach.MIN_DISTANCE


def test_the_object_rests_until_it_is_hit(body):
    env = ReachEnv(body)
    first, _ = env.reset(seed=1)
    hit = _play(env, 40, 0, 0, 0, 0)
    np.testing.assert_allclose(hit[4:11], first[4:11], atol=1e-3)
    above, beside, beyond = (first[4:7] + way for way in ([0, -0.1, 0.2], [0, -0.1, 0.05], [0, 0.05, 0.05]))
    for goal in [above] * 40 + [beside] * 50 + [beyond] * 50:
        hit = _play(env, 1, *np.clip(30 * (goal - hit[:3]), -1, 1), 1)
    assert np.linalg.norm(hit[4:6] - first[4:6]) > 0.01


def test_frames_show_the_scene(body):
    env = ReachEnv(body, render_mode="rgb_array", resolution=(60, 80))
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (60, 80, 3)
    assert frame.dtype == np.uint8
    goal = (frame[..., 0] > 2 * frame[..., 1].astype(int)) & (frame[..., 0] > 60)
    assert 1 <= goal.sum() < 100  # a small red ball
    _play(env, 15, 0, 1, 0, 0)
    assert (env.render() != frame).any()
    assert ReachEnv(body).render() is None


@pytest.mark.parametrize(("scale", "axis"), [(2.5, 0), (6.0, 2)])
def test_too_large_an_object_is_refused(body, scale, axis):
    stretch = np.ones(3)
    stretch[axis] = scale
    hulls = tuple(trimesh.Trimesh(hull.vertices * stretch, hull.faces) for hull in body.hulls)
    refused(r"brick is .* m tall .* smaller scale", ReachEnv, replace(body, hulls=hulls))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 0}, "horizon is 0"),
        ({"horizon": 2.5}, "horizon is 2.5, expected a whole number"),
        ({"horizon": "5"}, "horizon is '5', expected a whole number"),
        ({"render_mode": "human"}, "render_mode 'human' is not one of rgb_array"),
        ({"resolution": 5}, "resolution is 5, expected height and width"),
        ({"resolution": (5, 5, 3)}, r"resolution is \(5, 5, 3\), expected height and width"),
        ({"resolution": (0, 5)}, "resolution is 0, expected a whole number"),
        ({"resolution": (10.5, 3)}, "resolution is 10.5, expected a whole number"),
    ],
)
def test_wrong_arguments_are_named(body, arguments, message):
    refused(message, ReachEnv, body, **arguments)


def test_an_older_mujoco_is_named(body, monkeypatch):
    monkeypatch.setattr("mujoco.__version__", "3.3.0")
    refused(r"MuJoCo 3\.3\.0 is installed, expected 4", ReachEnv, body)


def test_without_metaworld_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "metaworld", None)
    monkeypatch.delitem(sys.modules, "metaworld.envs.sawyer_reach_v3", raising=False)
    monkeypatch.delitem(sys.modules, "objectfolder.sim.metaworld", raising=False)
    with pytest.raises(
        ObjectFolderError, match=r"metaworld.* is not installed; this needs metaworld 3\.1\.1"
    ):
        import_module("objectfolder.sim.metaworld")


def test_metaworld_with_an_object_file(body):
    pytest.importorskip("metaworld", reason="metaworld has an environment of its own (docs/benchmarks.md)")
    from objectfolder.sim.metaworld import MetaWorldReach

    env = MetaWorldReach(body, horizon=80)
    assert env.observation_space.shape == (39,)
    assert _trajectory(env, 0, 10) == _trajectory(env, 0, 10) != _trajectory(env, 1, 10)
    played = run_episodes(env, controller, [0, 1])
    assert played.last.all()
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation[6], 0.015, atol=1e-3)  # it stands on the table
