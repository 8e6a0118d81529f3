from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.benchmarks.tasks import grasp_policy_training as grasp_policy_module
from objectfolder.benchmarks.tasks.grasp_policy import TASK
from objectfolder.benchmarks.tasks.grasp_policy_training import grasp_policy, rollout_successes
from objectfolder.benchmarks.tasks.job import ObjectJob
from objectfolder.sim.body import rigid_body
from objectfolder.sim.features import TouchFeatures
from objectfolder.sim.grasp import Episodes
from objectfolder.sim.grasp_task import ACTION_SCALE, GraspTask
from objectfolder.sim.hulls import convex_hulls

PARAMS = GraspPolicyConfig(
    **{"seeds": 1, "episodes": 16, "environments": 4, "rollout": 4, "updates": 1, "batch": 8, "width": 8},
    **{"rollouts": 6, "presses": 4},
)


@cache
def brick_body(brick):
    return rigid_body(brick, convex_hulls(brick.to_mesh()))


@pytest.fixture(scope="module")
def task(brick):
    return GraspTask(brick, brick_body(brick))


def job(brick, progress, report=lambda line: None):
    return ObjectJob("grasp_policy", brick, brick_body(brick), PARAMS, 0, progress, report)


@pytest.fixture(scope="module")
def whole(brick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    return folder, *grasp_policy(job(brick, folder))


def test_scores_curves_and_what_is_kept(whole):
    folder, scores, curve = whole
    assert len(scores["touch"]["seeds"]) == 1
    for name in ("touch", "touch_exact", "tactile", "width", "blind", "random", "nothing"):
        low, high = scores[name]["interval_95"]
        assert 0 <= low <= scores[name]["rate"] <= high <= 1
    assert [row[2] for row in curve if row[0] == "touch"] == [8, 16]
    assert all(len(row) == len(TASK.columns) for row in curve)
    assert Actor.load(folder / "model.safetensors").mean.shape == (2 * TouchFeatures.size + 3,)
    with Image.open(folder / "episodes.gif") as film:
        assert film.n_frames > 20
    (shown,) = TASK.tables({"brick": scores})
    assert [row[1] for row in shown.rows][-1] == "none"
    assert [row[1] for row in shown.rows if "75.5" in row] == ["tactile images alone"]


@pytest.mark.slow
def test_an_interrupted_training_goes_on_to_the_same(brick, whole, tmp_path):
    def stop(line):
        if "8 of 16 episodes" in line and "by width" in line:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        grasp_policy(job(brick, tmp_path, stop))
    folder, scores, curve = whole
    again, lines = grasp_policy(job(brick, tmp_path))
    assert again | {"seconds": 0} == scores | {"seconds": 0}
    assert lines == curve
    kept = (path / "model.safetensors" for path in (folder, tmp_path))
    assert len({path.read_bytes() for path in kept}) == 1


def test_rollouts_count_what_is_held(task):
    """A policy that centres the hand on the object always succeeds; one that leaves never does."""
    episodes = Episodes(task, "blind", None)

    def centre(seen):
        turn = np.zeros((len(seen), 4))
        turn[:, [0, 1, 3]] = episodes.objects - episodes.hands[:, [0, 1, 3]]
        return turn / ACTION_SCALE

    def leave(seen):
        return np.insert(-np.sign(episodes.objects - episodes.hands[:, [0, 1, 3]]), 2, 1.0, 1)

    held, lost = (rollout_successes(episodes, p, 12, np.random.default_rng(0)) for p in (centre, leave))
    assert held.all()
    assert not lost.any()


def test_nothing_is_filmed_where_every_rollout_starts_in_collision(brick, monkeypatch):
    nothing = SimpleNamespace(objects=None, hands=None)
    monkeypatch.setattr(grasp_policy_module, "Episodes", lambda *given: nothing)
    monkeypatch.setattr(grasp_policy_module, "rollout_successes", lambda *given: np.zeros(3, bool))
    task = SimpleNamespace(file=brick, free=lambda objects, hands: np.zeros(3, bool))
    assert grasp_policy_module.grasp_frames(task, None, None, 3, 0) == []
