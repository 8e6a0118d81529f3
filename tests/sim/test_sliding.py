import numpy as np
import pytest
from brick import with_images, without
from refusals import refused
from stable_baselines3 import PPO

from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.slide import SlideEnv
from objectfolder.sim.sliding import (
    REFINE,
    SLIDES,
    STEPS,
    TRAVERSE,
    Poses,
    errors,
    follow_policy,
    is_reached,
    limited,
    moved,
    observe,
    offsets,
    random_poses,
    require_sliding,
    strayed,
    transported,
)

X, Y, Z = np.eye(3)[:, None]


def on_top(brick, places):
    """Sensors on the top of the brick, in shares of its size, with up along y."""
    points = np.c_[np.array(places) * brick.scale, np.full(len(places), brick.bounds[1, 2])]
    count = len(points)
    return Poses(brick.nearest(points)[0], np.repeat(Z, count, 0), np.repeat(Y, count, 0))


def test_tangents_go_along_as_normals_turn():
    assert transported(Y, Z, Z) == pytest.approx(Y)
    assert transported(X, Z, X) == pytest.approx(-Z)  # over an edge
    assert transported(Y, Z, X) == pytest.approx(Y)  # along it
    rng = np.random.default_rng(0)
    normals, others, drawn = (rng.normal(size=(50, 3)) for _ in range(3))
    normals, others = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (normals, others))
    tangents = np.cross(normals, drawn)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    there = transported(tangents, normals, others)
    assert (there * others).sum(1) == pytest.approx(0, abs=1e-12)
    assert transported(there, others, normals) == pytest.approx(tangents)


def test_motions_on_a_plane_are_right_up_and_anticlockwise(brick):
    """Seen from above: x is right, y is up."""
    here = on_top(brick, [[0, 0]])
    there = moved(brick, here, np.array([[0.01, 0.005, np.pi / 2]]))
    assert there.points - here.points == pytest.approx(np.array([[0.01, 0.005, 0]]), abs=1e-5)
    assert there.up == pytest.approx(-X, abs=1e-3)
    assert there.right == pytest.approx(Y, abs=1e-3)
    assert there.angles - here.angles == pytest.approx(np.pi / 2, abs=1e-3)


def test_offsets_are_the_motions_that_lead_to_goals(brick):
    rng = np.random.default_rng(0)
    here = on_top(brick, rng.uniform(-0.1, 0.1, (20, 2)))
    motions = np.c_[rng.uniform(-5e-3, 5e-3, (20, 2)), rng.uniform(-3, 3, 20)]
    there = moved(brick, here, motions)
    assert offsets(here, there) == pytest.approx(motions, abs=1e-5)
    away = np.c_[np.hypot(*motions[:, :2].T), abs(motions[:, 2])]
    assert errors(here, there) == pytest.approx(away, abs=1e-5)
    assert moved(brick, there, offsets(there, here)).points == pytest.approx(here.points, abs=1e-5)


def test_a_step_has_a_greatest_length_and_keeps_its_direction():
    motions = np.array([[0.004, -0.002, 1.0], [0.0005, 0, -0.01], [0, 0, 0]])
    expected = [[0.001, -0.0005, REFINE.step_turn], [0.0005, 0, -0.01], [0, 0, 0]]
    assert limited(motions, REFINE) == pytest.approx(np.array(expected))


@pytest.mark.parametrize("slide", SLIDES.values(), ids=SLIDES)
def test_starts_are_away_as_told_and_who_knows_the_goal_gets_there(slide):
    mug, rng = ObjectFile.sample("mug"), np.random.default_rng(0)
    goals = random_poses(mug, 40, rng)
    starts = strayed(mug, slide, goals, rng)
    distance, angle = errors(starts, goals).T
    low, high = slide.distance
    assert distance.max() <= 1.02 * high
    assert np.median(distance) > (low + high) / 3  # straight, or around the mug
    assert slide is TRAVERSE or angle.max() <= 1.02 * slide.turn
    last, reached, way = follow_policy(
        mug, slide, starts, goals, lambda step, rows, poses: offsets(poses, goals.take(rows))
    )
    assert reached.mean() >= 0.95  # not where the way leads over the rim of a wall
    assert (is_reached(slide, last, goals) == reached).all()
    assert len(way) <= STEPS + 1
    still, reached, way = follow_policy(
        mug, slide, starts, goals, lambda step, rows, poses: np.zeros((len(rows), 3))
    )
    assert reached.mean() < 0.1
    assert len(way) == STEPS + 1
    assert still.points == pytest.approx(starts.points, abs=1e-5)


def test_what_is_seen_moves_against_the_sensor(die):
    """Pips on a face, an eighth of a picture to the right."""
    rng = np.random.default_rng(1)
    flat = random_poses(die, 200, rng)
    inside = (abs(flat.points) < 0.06).sum(1) == 2
    flat = flat.take(np.flatnonzero(inside & (abs(flat.normals).max(1) > 0.9999)))
    width = 2 * die.sensor_profile.half_extent[1] * die.sensor_profile.camera_to_gel
    there = moved(die, flat, np.tile([width / 8, 0, 0], (len(flat.points), 1)))
    a, b = (observe(die, poses, ["vision"], (32, 24)).astype(float) for poses in (flat, there))
    against, along = abs(a[:, :, 3:] - b[:, :, :-3]).mean(), abs(a[:, :, :-3] - b[:, :, 3:]).mean()
    assert against < along / 2


@pytest.fixture(scope="module")
def die():
    return ObjectFile.sample("die")


def test_both_senses_are_beside_each_other(brick):
    poses = random_poses(brick, 3, np.random.default_rng(0))
    both, touch, vision = (
        observe(brick, poses, s, (16, 12)) for s in (("touch", "vision"), ("touch",), ("vision",))
    )
    assert both.tobytes() == np.concatenate([touch, vision], 3).tobytes()


def test_files_that_cannot_tell_are_refused(brick):
    refused("brick: its touch net stores a single press", require_sliding, with_images(brick, 0.001, 0.0), ())
    refused("brick: the Object File holds no touch", require_sliding, without(brick, "touch"), ())
    refused("brick: the Object File holds no vision", require_sliding, without(brick, "vision"), ["vision"])


def test_the_reward_tells_how_many_steps_nearer_and_the_goal_ends_the_episode():
    env = SlideEnv("mug", size=(8, 6))
    total, ended = 0.0, False
    _, info = env.reset(seed=2)
    steps = max(info["distance"] / REFINE.step, info["angle"] / REFINE.step_turn)
    while not ended:
        wanted = offsets(env._poses, env._goals) / REFINE.steps
        _, reward, ended, cut, info = env.step(wanted[0].clip(-1, 1))
        assert not cut
        total += reward
    left = max(info["distance"] / REFINE.step, info["angle"] / REFINE.step_turn)
    assert total == pytest.approx(1 + steps - left)
    assert info["distance"] <= REFINE.near


@pytest.mark.slow
def test_stable_baselines_trains_on_it():
    env = SlideEnv("mug", senses=("touch", "vision"))
    policy = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, seed=0).learn(8).policy
    action, _ = policy.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)
