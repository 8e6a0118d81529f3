import copy
import pickle

import gymnasium
import numpy as np
import pytest
from brick import felt_by, with_images, without
from refusals import refused

import objectfolder.sim  # noqa: F401, registers
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import hulls as module
from objectfolder.sim.body import as_rigid_body, rigid_body
from objectfolder.sim.features import TouchBank, TouchFeatures
from objectfolder.sim.fingers import Presses
from objectfolder.sim.grasp import Episodes, GraspEnv, GraspVectorEnv
from objectfolder.sim.grasp_scene import lowest_hand
from objectfolder.sim.grasp_task import ACTION_SCALE, STEPS, GraspTask
from objectfolder.sim.hulls import cached_hulls, convex_hulls

NAMES = ("file", "observation")


@pytest.fixture(scope="module")
def task(brick, hulls):
    return GraspTask(brick, rigid_body(brick, cached_hulls(brick, hulls)))


def made(path, hulls, observation):
    given = {"file": path, "hulls": hulls, "observation": observation, "render_mode": "rgb_array"}
    return gymnasium.make("ObjectFolder/Grasp-v0", **given).unwrapped


@pytest.mark.parametrize("observation", ["images", "tactile", "blind"])
def test_observations_are_in_their_space(brick_path, hulls, observation):
    env = made(brick_path, hulls, observation)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])


def test_made_by_name(brick_path, hulls):
    env = gymnasium.make("ObjectFolder/Grasp-v0", file=brick_path, hulls=hulls, observation="blind")
    _, info = env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    assert info == {}
    _, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert terminated
    assert not truncated
    assert info == {"success": reward == 1}


def test_same_seed_same_trajectory(task):
    def play(seed):
        env = GraspVectorEnv(3, task=task, observation="width")
        seen, rng = [env.reset(seed=seed)[0]], np.random.default_rng(5)
        for _ in range(2 * STEPS):
            seen += env.step(rng.uniform(-1, 1, (3, 4)))[:2]
        return [of.tobytes() for of in seen]

    once = play(3)
    assert play(3) == once
    assert play(4)[0] != once[0]


def test_one_environment_is_a_row_of_many(task, brick, hulls):
    """Observations and rewards of an episode do not depend on the others."""
    episodes = Episodes(task, "features")
    seen = episodes.begin(2, np.random.default_rng(0))
    places, hands = episodes.objects.copy(), episodes.hands.copy()
    actions = np.random.default_rng(1).uniform(-1, 1, (STEPS, 2, 4))
    for action in actions:
        rewards = episodes.act(action)
    for row in range(2):
        one = Episodes(task, "features")
        one.begin(1, np.random.default_rng(0))
        one.objects, one.hands = places[[row]], hands[[row]]
        assert np.array_equal(one.observe()[0], seen[row])
        for action in actions:
            reward = one.act(action[[row]])
        assert reward[0] == rewards[row]


def test_a_centred_grasp_succeeds_and_one_beside_the_object_fails(task):
    objects = np.zeros((3, 3))
    hands = np.array([[0, 0, lowest_hand(), 0], [0, 0.08, lowest_hand(), 0], [0.06, 0, lowest_hand(), 0]])
    assert task.grasp(objects, hands).tolist() == [True, False, False]
    assert task.free(objects, hands).tolist() == [True, True, False]


def test_first_contacts_of_a_brick(task):
    """The short side of the brick, 6 cm, lies along x; turned by 0.1 rad it is wider."""
    touch = task.touch(np.array([[0, 0, 0], [0, 0, 0.1], [0.01, 0, 0]]), np.tile([0, 0, 0.02, 0.0], (3, 1)))
    assert touch.touched.all()
    assert touch.width[0] == pytest.approx(0.06, abs=0.001)
    assert touch.width[1] > touch.width[0] + 0.0005
    assert touch.width[2] == pytest.approx(touch.width[0], abs=1e-6)
    away = task.touch(np.zeros((1, 3)), np.array([[0, 0.2, 0.02, 0]]))
    assert not away.touched.any()
    assert away.width[0] == 0


def test_touches_agree_with_the_simulation(task):
    """Rays find the opening at which simulated jaws come to rest."""
    hands = np.array([[0.004, 0.01, 0.02, 0.05], [0.0, -0.02, 0.022, -0.1]])
    touch = task.touch(np.zeros((2, 3)), hands)
    closed = task.scene.close(np.tile(task.rest, (2, 1)), hands, np.full(2, 4.0))
    assert touch.width == pytest.approx(closed.width, abs=0.003)


def test_actions_move_the_hand(task):
    hands = task.move(np.array([[0.0, 0.0, 0.05, 0.0]]), np.array([[1.0, -1.0, 0.5, 5.0]]))
    assert hands[0] == pytest.approx(np.array([0, 0, 0.05, 0]) + ACTION_SCALE * [1, -1, 0.5, 1])
    assert task.move(hands, np.array([[0, 0, -100, 0]]))[0, 2] >= lowest_hand()


def test_features_are_zero_without_a_touch_and_distinguish_a_face_from_an_edge(task):
    episodes = Episodes(task, "features")
    episodes.objects, episodes.hands = np.zeros((3, 3)), np.tile([0, 0, 0.02, 0.0], (3, 1))
    episodes.hands[1, 3], episodes.hands[2, 1] = 0.4, 0.3
    felt = episodes.observe()[:, : 2 * TouchFeatures.size]
    assert not felt[2].any()
    assert np.abs(felt[0] - felt[1]).max() > 0.3
    assert felt[0].any()


def test_the_untouched_gel_is_the_photographed_one(brick):
    photographed = felt_by(brick, "digit_real")
    assert np.array_equal(TouchFeatures(photographed).untouched, photographed.touch([[0, 0.03, 0]], 0.0)[0])


def test_a_net_of_images_is_felt_at_its_own_depth(brick):
    images = with_images(brick, 0.001, 0.0)
    presses = Presses(np.array([[0.0, 0.0, 0.015]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
    felt = TouchFeatures(images).images(presses)
    np.testing.assert_array_equal(felt, images.touch(images.nearest(presses.points)[0]))
    assert np.isfinite(TouchFeatures(images)(presses)).all()


def test_a_bank_gives_the_nearest_touch(task, tmp_path):
    bank = task.bank(5, 0)
    assert np.array_equal(bank(bank.pressed), bank.features)
    assert task.bank(5, 0).features.tobytes() == bank.features.tobytes()
    bank.save(tmp_path / "bank.npz", "brick")
    again = TouchBank.load(tmp_path / "bank.npz", "brick")
    assert np.array_equal(again(bank.pressed), bank.features)
    assert TouchBank.load(tmp_path / "bank.npz", "another") is None
    exact = TouchFeatures(task.file)
    assert np.array_equal(exact(bank.pressed), bank.features)


def test_pictures_show_the_episode(brick, hulls):
    env = GraspEnv(brick, "blind", hulls, render_mode="rgb_array")
    env.reset(seed=1)
    before = env.render()
    env.step(np.array([0, 1.0, 1.0, 1.0]))
    after = env.render()
    assert before.shape == (256, 256, 3)
    assert 0.005 < (before != after).any(2).mean() < 0.5
    assert GraspEnv(brick, "blind", hulls).render() is None


def test_vector_environments_show_each_episode(task):
    env = GraspVectorEnv(2, task=task, observation="blind", render_mode="rgb_array")
    refused("was not reset", env.render)
    env.reset(seed=1)
    first, second = env.render()
    assert first.shape == second.shape == (256, 256, 3)
    assert first.dtype == np.uint8
    assert (first != second).any()
    assert GraspVectorEnv(2, task=task, observation="blind").render() is None
    refused("render_mode 'human' is not one of rgb_array", GraspVectorEnv, 2, task=task, render_mode="human")


def test_a_vector_environment_that_draws_is_made_by_name(brick_path, hulls):
    given = {"file": brick_path, "hulls": hulls, "observation": "blind", "render_mode": "rgb_array"}
    env = gymnasium.make_vec("ObjectFolder/Grasp-v0", 2, "vector_entry_point", **given)
    env.reset(seed=0)
    assert len(env.render()) == 2


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("seed", [3, [3, 4]])
def test_a_copy_of_a_vector_environment_goes_on_as_the_original_does(task, how, seed):
    env = GraspVectorEnv(2, task=task, observation="width")
    env.reset(seed=seed)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 2, 4))
    env.step(actions[0])
    twin = how(env)
    for action in actions[1:]:  # to the end of the episode, and into the next one
        for own, other in zip(env.step(action)[:4], twin.step(action)[:4]):
            assert own.tobytes() == other.tobytes()
    assert env.reset()[0].tobytes() == twin.reset()[0].tobytes()


def test_each_of_a_list_of_seeds_counts(task, brick, hulls):
    env, alone = GraspVectorEnv(2, task=task, observation="width"), GraspEnv(brick, "width", hulls)
    places = {}
    for seeds in ([1, 2], (1, 3), np.array([2, 1])):
        seen = [env.reset(seed=seeds)[0]]
        seen += [env.step(np.zeros((2, 4)))[0] for _ in range(STEPS)]
        for row, seed in enumerate(seeds):
            one = [alone.reset(seed=int(seed))[0], alone.step(np.zeros(4))[0]]
            alone.step(np.zeros(4))
            one.append(alone.reset()[0])  # the vector environment begins anew by itself
            assert [all_[row].tobytes() for all_ in seen] == [of.tobytes() for of in one]
            assert places.setdefault(int(seed), one[0].tobytes()) == one[0].tobytes()
    assert len({*places.values()}) == 3
    kept = env.reset(seed=[5, None])[0]
    assert kept[0].tobytes() == env.reset(seed=[5, 6])[0][0].tobytes() != kept[1].tobytes()
    shared = env.reset(seed=7)[0]
    assert shared.tobytes() == GraspVectorEnv(2, task=task, observation="width").reset(seed=7)[0].tobytes()
    for wrong in ([1], [1, 2, 3], []):
        refused(r"expected one, or one for each of 2 environments", env.reset, seed=wrong)
    for wrong in ("one", 1.5, [1, -2], ["1", 2]):
        refused("expected a whole number of at least 0", env.reset, seed=wrong)


def test_what_cannot_be_grasped_is_refused_before_its_hulls_are_computed(brick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "convex_hulls", lambda *given: pytest.fail("hulls were computed"))
    wrong = {
        "die is too large for the gripper: at its narrowest 160 mm .* 110 mm": (ObjectFile.sample("die"),),
        "holds no touch": (without(brick, "touch"),),
        "observation 'smell' is not one of features, tactile, ": (brick, "smell"),
    }
    refused("needs an Object File", GraspVectorEnv, 2)
    for message, arguments in wrong.items():
        for hulls in (None, tmp_path / "new" / "hulls"):
            options = {} if hulls is None else {"hulls": hulls}
            with pytest.raises(ObjectFolderError, match=message):
                gymnasium.make("ObjectFolder/Grasp-v0", **dict(zip(NAMES, arguments)), **options)
            refused(message, GraspVectorEnv, 2, *arguments, **options)
    assert list(tmp_path.iterdir()) == []


def test_hulls_are_cached_for_the_user_and_not_in_the_current_folder(brick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made, computed = [], convex_hulls(brick.to_mesh())
    monkeypatch.setattr(module, "convex_hulls", lambda *given: made.append(given) or computed)
    first, _ = GraspEnv(brick, "blind").reset(seed=0)
    written = [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()]
    assert written == ["cache/objectfolder/hulls/brick.npz"]
    again, _ = GraspEnv(brick, "blind").reset(seed=0)
    assert len(made) == 1
    np.testing.assert_array_equal(again, first)


def test_hulls_may_be_given_as_meshes_or_as_a_folder(brick, hulls):
    meshes = cached_hulls(brick, hulls)
    first, second = (GraspEnv(brick, "blind", given).reset(seed=0)[0] for given in (hulls, meshes))
    np.testing.assert_array_equal(first, second)
    assert as_rigid_body(brick, str(hulls)).mass == as_rigid_body(brick, meshes).mass
    for wrong in (5, meshes[0], [meshes[0], "mug"]):
        refused("expected a folder to cache them in, or a list of mesh", as_rigid_body, brick, wrong)


@pytest.mark.parametrize("observation", ["width", "images"])
def test_what_ends_is_told_as_gymnasiums_own_vector_environments_do(task, brick_path, hulls, observation):
    ours = GraspVectorEnv(2, task=task, observation=observation)
    makers, same = (
        [lambda: made(brick_path, hulls, observation)] * 2,
        gymnasium.vector.AutoresetMode.SAME_STEP,
    )
    theirs = gymnasium.vector.SyncVectorEnv(makers, autoreset_mode=same)
    found = []
    for env in (ours, theirs):
        env.reset(seed=0)
        env.step(np.zeros((2, 4), np.float32))
        found.append(env.step(np.zeros((2, 4), np.float32))[4])
    own, expected = found
    assert {*own} - {"success", "_success"} == {*expected}
    assert {*own["final_info"]} == {*expected["final_info"]}
    for name in ("_final_obs", "_final_info"):
        np.testing.assert_array_equal(own[name], expected[name])
    for one, other in zip(own["final_obs"], expected["final_obs"]):
        assert ours.single_observation_space.contains(one)
        assert ours.single_observation_space.contains(other)
    refused("num_envs is 0", GraspVectorEnv, 0, task=task)
