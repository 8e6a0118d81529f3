"""An agent may call an environment in any way, copy it, and run it in other processes."""

import copy
import pickle
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from refusals import refused
from stable_baselines3.common.env_checker import check_env as check_for_stable_baselines

import objectfolder.sim  # noqa: F401, registers
from objectfolder.sim.calls import distinct_materials, object_file, open_files
from objectfolder.sim.drop import DropEnv
from objectfolder.sim.explore import AZIMUTHS, HEIGHTS, ExploreEnv
from objectfolder.sim.grasp import GraspEnv, GraspVectorEnv
from objectfolder.sim.hulls import cached_hulls
from objectfolder.sim.reach import ReachEnv
from objectfolder.sim.slide import SlideEnv
from objectfolder.sim.tap import TapEnv


@pytest.fixture(scope="module")
def make(brick_path, brick, hulls):
    """Makes each environment by its name."""
    parts = cached_hulls(brick, hulls)
    made = {
        "grasp": lambda: GraspEnv(brick_path, "width", hulls),
        "reach": lambda: ReachEnv(brick_path, parts),
        "grasps": lambda: GraspVectorEnv(2, brick_path, "blind", hulls),
        "drop": partial(DropEnv, objects=[brick], materials=["plastic"], seconds=0.03),
        "tap": partial(TapEnv, objects=[brick], seconds=0.03, count=3, limit=6),
        "explore": partial(ExploreEnv, objects=[brick]),
        "slide": partial(SlideEnv, brick, size=(16, 12)),
    }
    return lambda name, **given: made[name](**given)


PLACES = AZIMUTHS * HEIGHTS
SINGLE, GAMES = ("grasp", "reach"), ("drop", "tap", "explore", "slide")
EVERY = pytest.mark.parametrize("name", [*SINGLE, "grasps", *GAMES])
WRONG = {
    "NaN": lambda good: good * np.nan,
    "infinite": lambda good: good + np.inf,
    "short": lambda good: good[..., :2],
    "scalar": lambda good: 0.0,
    "more rows": lambda good: np.stack([good, good]),
    "text": lambda good: "up",
    "nothing": lambda good: None,
    "ragged": lambda good: [[1, 2], [3]],
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("name", [*SINGLE, "grasps", "slide"])
def test_a_wrong_action_is_refused_and_changes_nothing(make, name, wrong):
    env, twin = make(name), make(name)
    env.reset(seed=0)
    twin.reset(seed=0)
    good = np.full(env.action_space.shape, 0.25)
    refused(r"action is .* [34] finite numbers in \[-1, 1\]", env.step, wrong(good))
    assert observed(env.step(good)) == observed(twin.step(good))


def content(observation):
    """An observation as bytes."""
    parts = (
        [observation[of] for of in sorted(observation)] if isinstance(observation, dict) else [observation]
    )
    return [np.asarray(part).tobytes() for part in parts]


def observed(step):
    """Observation, reward and ends as bytes."""
    return [content(part) for part in step[:4]]


@EVERY
def test_a_step_before_a_reset_is_refused(make, name):
    env = make(name)
    refused(r"call reset\(\) first", env.step, np.zeros(env.action_space.shape))


@pytest.mark.parametrize("name", SINGLE)
def test_a_picture_before_a_reset_is_refused(make, name):
    env = make(name)
    env.render_mode = "rgb_array"
    refused(r"call reset\(\) first", env.render)


@EVERY
def test_options_of_a_reset_are_refused(make, name):
    env = make(name)
    env.reset(seed=0, options={})
    refused(r"options \{'goal': \[0, 0, 0\]\}, but", env.reset, options={"goal": [0, 0, 0]})


def test_a_step_after_the_end_is_refused(make):
    env = make("grasp")
    env.reset(seed=0)
    done = False
    while not done:
        *_, done, _, _ = env.step(np.zeros(4))
    refused(r"has ended after 2 steps; call reset\(\)", env.step, np.zeros(4))


COPIES = {"pickle": lambda env: pickle.loads(pickle.dumps(env)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("how", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("name", [*SINGLE, *GAMES])
def test_a_copy_goes_on_as_the_original(make, name, how):
    env = make(name)
    env.action_space.seed(0)
    first, actions = np.zeros_like(env.action_space.sample()), [env.action_space.sample() for _ in range(30)]
    fresh = how(env)
    refused("call reset", fresh.step, first)
    env.reset(seed=3)
    if name != "drop":  # whose episodes have one step
        env.step(first)
    twin = how(env)
    assert twin.np_random is not env.np_random
    assert twin.np_random_seed == 3
    for action in actions:
        step = env.step(action)
        assert observed(twin.step(action)) == observed(step)
        if step[2] or step[3]:
            break
    assert content(env.reset()[0]) == content(twin.reset()[0])  # of the same random generator
    assert content(fresh.reset(seed=3)[0]) == content(env.reset(seed=3)[0])


@pytest.mark.parametrize(
    ("name", "given", "answer", "worth"),
    [
        ("drop", {"materials": ["wood", "steel"]}, lambda told, off: [0, told["material"] ^ off], 0.5),
        ("tap", {}, lambda told, off: 3 + (told["odd"] + off) % 3, 0.0),
        ("explore", {"objects": ["mug", "die"]}, lambda told, off: PLACES + (told["object"] ^ off), 0.0),
    ],
)
def test_the_right_answer_is_rewarded_and_ends_the_episode(make, name, given, answer, worth):
    """Half a reward for the right object of the wrong material."""
    env = make(name, **given)
    for off, expected in ((0, 1.0), (1, worth)):
        _, info = env.reset(seed=5)
        _, reward, ended, cut, after = env.step(np.array(answer(info, off)))
        assert (reward, ended, cut) == (expected, True, False)
        assert repr(after) == repr(info)
    refused("was not reset", env.step, np.array(answer(info, 0)))


@pytest.mark.parametrize("name", ["tap", "explore", "slide"])
def test_the_last_try_truncates_the_episode(make, name):
    env = make(name, limit=3)
    env.reset(seed=0)
    actions = np.zeros((3, 3)) if name == "slide" else range(3)
    assert [env.step(action)[3] for action in actions] == [False, False, True]
    refused("was not reset", env.step, actions[0])


@pytest.mark.parametrize("name", GAMES)
def test_environments_side_by_side_do_what_each_does_alone(make, name):
    many, alone = gymnasium.vector.SyncVectorEnv([lambda: make(name)] * 2), make(name)
    together, _ = many.reset(seed=[3, 4])
    expected, _ = alone.reset(seed=4)
    action = np.zeros_like(alone.action_space.sample())
    for k in range(2):
        rows = {of: row[1] for of, row in together.items()} if isinstance(together, dict) else together[1]
        assert content(rows) == content(expected)
        if k == 0:
            together, expected = many.step(np.stack([action, action]))[0], alone.step(action)[0]


DRAWN = {"render_mode": "rgb_array"}


@pytest.mark.parametrize(
    ("name", "given", "checks"),
    [
        ("Grasp", DRAWN | {"observation": "features"}, [check_env]),
        ("Grasp", DRAWN | {"observation": "width"}, [check_for_stable_baselines]),
        ("Reach", DRAWN | {"horizon": 20, "resolution": (24, 32)}, [check_env, check_for_stable_baselines]),
        ("Drop", {"seconds": 0.03}, [check_env]),
        ("Tap", {"seconds": 0.03}, [check_env]),
        ("Explore", {}, [check_env]),
        ("Slide", {"senses": ("touch", "vision"), "size": (16, 12)}, [check_env]),
    ],
)
def test_the_checkers_pass_with_what_is_made_by_name(brick, hulls, name, given, checks):
    thing = {"objects": [brick]} if name.lower() in GAMES else {"file": brick, "hulls": hulls}
    thing = {"file": brick} if name == "Slide" else thing
    env = gymnasium.make(f"ObjectFolder/{name}-v0", **thing, **given).unwrapped
    for check in checks:
        check(env)


@pytest.mark.parametrize(
    ("name", "actions", "message"),
    [
        ("drop", [[0, 3]], r"numbers of an object below 1 and of a material below 1"),
        ("tap", [6, -1, 0.5, [0]], "expected a whole number from 0 to 5"),
        ("explore", [PLACES + 1, -1, 0.5], f"expected a whole number from 0 to {PLACES}"),
    ],
)
def test_wrong_actions_of_games_are_refused(make, name, actions, message):
    env = make(name)
    env.reset(seed=0)
    for action in actions:
        refused(message, env.step, np.array(action))


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("drop", {"materials": ["cheese"]}, "unknown material 'cheese'"),
        ("drop", {"objects": []}, "at least one object"),
        ("drop", {"seconds": 0}, "give no samples"),
        ("drop", {"seconds": float("nan")}, "duration is nan, expected a finite number"),
        ("drop", {"sample_rate": "x"}, "sample rate is 'x', expected a finite number"),
        ("tap", {"count": 2}, "at least 3 objects"),
        ("tap", {"limit": 0}, "at least 1 tap"),
        ("tap", {"seconds": 0.0}, "give no samples"),
        ("tap", {"objects": []}, "at least one object"),
        ("tap", {"materials": ["wood"]}, "two different materials"),
        ("tap", {"materials": ["wood", "wood"]}, "two different materials"),
        ("explore", {"objects": []}, "at least one object"),
        ("explore", {"noise": -1e-3}, "expected a number of at least 0"),
        ("explore", {"limit": 0}, "limit is 0, expected a whole number of at least 1"),
        ("explore", {"reduction": 0}, "reduction is 0, expected a whole number of at least 1"),
        ("explore", {"reduction": 200}, "reduction is 200, expected 120 at most for digit"),
        ("slide", {"task": "roll"}, "task 'roll' is not one of refine, traverse"),
        ("slide", {"senses": ["smell"]}, "senses 'smell' is not one of touch, vision"),
        ("slide", {"senses": []}, "senses is empty, expected touch, vision or both"),
        ("slide", {"limit": 0}, "limit is 0, expected a whole number of at least 1"),
    ],
)
def test_wrong_arguments_of_games_are_refused(make, name, given, message):
    refused(message, make, name, **given)


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGLE)
def test_environments_run_in_spawned_processes(make, name):
    env = make(name)
    many = gymnasium.vector.AsyncVectorEnv([lambda: copy.deepcopy(env)] * 2, context="spawn")
    try:
        seen, _ = many.reset(seed=[0, 1])
        assert seen[0].tobytes() == env.reset(seed=0)[0].tobytes()
        actions = np.zeros((2, 4), np.float32)
        assert many.step(actions)[0][0].tobytes() == env.step(actions[0])[0].tobytes()
    finally:
        many.close()


def test_objects_are_given_as_files_paths_or_names_of_samples(brick, brick_path):
    assert open_files(brick) == [brick]
    assert [file.key for file in open_files(str(brick_path))] == ["brick"]
    assert [file.key for file in open_files(["mug", brick_path])] == ["mug", "brick"]
    refused(r"one object, and none twice, got \['brick', 'brick'\]", open_files, [brick_path, brick])
    assert object_file("bell").key == "bell"
    refused("expected at least one object", open_files, [])
    refused(r"nothing\.safetensors does not exist", open_files, "nothing.safetensors")


def test_a_single_material_stands_for_itself():
    assert distinct_materials("Steel") == ["steel"]
    assert distinct_materials(("wood", "glass"), 2) == ["wood", "glass"]
    for given, least, message in (
        ([], 1, r"at least one material, and none twice, got \[\]"),
        ("steel", 2, r"at least two different materials, and none twice, got \['steel'\]"),
        (["wood", "steel", "Wood"], 1, "none twice, got"),
        (["brass"], 1, "unknown material 'brass'"),
    ):
        refused(message, distinct_materials, given, least)
