"""An agent may call an environment in any way, copy it, and run it in other processes."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest

import objectfolder.envs  # noqa: F401, registers
from objectfolder.envs.calls import distinct_materials, object_file, opened
from objectfolder.envs.grasp import GraspEnv, GraspVectorEnv
from objectfolder.envs.hulls import cached_hulls
from objectfolder.envs.reach import ReachEnv
from objectfolder.errors import ObjectFolderError


@pytest.fixture(scope="module")
def hulls(brick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("hulls")
    cached_hulls(brick, folder)
    return folder


@pytest.fixture(scope="module")
def make(brick_path, brick, hulls):
    """Makes each environment by its name."""
    parts = cached_hulls(brick, hulls)
    made = {
        "grasp": lambda: GraspEnv(brick_path, "width", hulls),
        "reach": lambda: ReachEnv(brick_path, parts),
        "grasps": lambda: GraspVectorEnv(2, brick_path, "blind", hulls),
    }
    return lambda name: made[name]()


SINGLE = ("grasp", "reach")
WRONG = {
    "NaN": lambda good: good * np.nan,
    "infinite": lambda good: good + np.inf,
    "short": lambda good: good[..., :3],
    "scalar": lambda good: 0.0,
    "more rows": lambda good: np.stack([good, good]),
    "text": lambda good: "up",
    "nothing": lambda good: None,
    "ragged": lambda good: [[1, 2], [3]],
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("name", [*SINGLE, "grasps"])
def test_a_wrong_action_is_refused_and_changes_nothing(make, name, wrong):
    env, twin = make(name), make(name)
    env.reset(seed=0)
    twin.reset(seed=0)
    good = np.full(env.action_space.shape, 0.25)
    with pytest.raises(ObjectFolderError, match=r"action is .* 4 finite numbers in \[-1, 1\]"):
        env.step(wrong(good))
    assert observed(env.step(good)) == observed(twin.step(good))


def observed(step):
    """Observation, reward and ends as bytes."""
    return [np.asarray(part).tobytes() for part in step[:4]]


@pytest.mark.parametrize("name", [*SINGLE, "grasps"])
def test_a_step_before_a_reset_is_refused(make, name):
    env = make(name)
    with pytest.raises(ObjectFolderError, match=r"call reset\(\) first"):
        env.step(np.zeros(env.action_space.shape))


@pytest.mark.parametrize("name", SINGLE)
def test_a_picture_before_a_reset_is_refused(make, name):
    env = make(name)
    env.render_mode = "rgb_array"
    with pytest.raises(ObjectFolderError, match=r"call reset\(\) first"):
        env.render()


@pytest.mark.parametrize("name", [*SINGLE, "grasps"])
def test_options_of_a_reset_are_refused(make, name):
    env = make(name)
    env.reset(seed=0, options={})
    with pytest.raises(ObjectFolderError, match=r"options \{'goal': \[0, 0, 0\]\}, but"):
        env.reset(options={"goal": [0, 0, 0]})


def test_a_step_after_the_end_is_refused(make):
    env = make("grasp")
    env.reset(seed=0)
    done = False
    while not done:
        *_, done, _, _ = env.step(np.zeros(4))
    with pytest.raises(ObjectFolderError, match=r"has ended after 2 steps; call reset\(\)"):
        env.step(np.zeros(4))


COPIES = {"pickle": lambda env: pickle.loads(pickle.dumps(env)), "deepcopy": copy.deepcopy}


@pytest.mark.parametrize("how", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("name", SINGLE)
def test_a_copy_goes_on_as_the_original(make, name, how):
    env = make(name)
    fresh = how(env)
    with pytest.raises(ObjectFolderError, match="call reset"):
        fresh.step(np.zeros(4))
    env.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 4))
    env.step(actions[0])
    twin = how(env)
    assert twin.np_random is not env.np_random
    for action in actions[1:]:
        step = env.step(action)
        assert observed(twin.step(action)) == observed(step)
        if step[2]:
            break
    assert env.reset()[0].tobytes() == twin.reset()[0].tobytes()  # of the same random generator
    assert fresh.reset(seed=3)[0].tobytes() == env.reset(seed=3)[0].tobytes()


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
    assert opened(brick) == [brick]
    assert [file.key for file in opened(str(brick_path))] == ["brick"]
    assert [file.key for file in opened(["mug", brick_path])] == ["mug", "brick"]
    with pytest.raises(ObjectFolderError, match=r"one object, and none twice, got \['brick', 'brick'\]"):
        opened([brick_path, brick])
    assert object_file("bell").key == "bell"
    with pytest.raises(ObjectFolderError, match="expected at least one object"):
        opened([])
    with pytest.raises(ObjectFolderError, match=r"nothing\.safetensors does not exist"):
        opened("nothing.safetensors")


def test_a_single_material_stands_for_itself():
    assert distinct_materials("Steel") == ["steel"]
    assert distinct_materials(("wood", "glass"), 2) == ["wood", "glass"]
    for given, least, message in (
        ([], 1, r"at least one material, and none twice, got \[\]"),
        ("steel", 2, r"at least two different materials, and none twice, got \['steel'\]"),
        (["wood", "steel", "Wood"], 1, "none twice, got"),
        (["brass"], 1, "unknown material 'brass'"),
    ):
        with pytest.raises(ObjectFolderError, match=message):
            distinct_materials(given, least)
