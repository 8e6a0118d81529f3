"""TRPO learns what can be learnt in a task whose answer is in the observation."""

import pytest
import torch
from tiny_tasks import Follow

from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.benchmarks.models.trpo import train_trpo
from objectfolder.sim.grasp_task import STEPS

PARAMS = GraspPolicyConfig(
    **{"seeds": 1, "episodes": 4000, "environments": 50, "rollout": 8, "patience": 20, "batch": 100},
    **{"learning_rate": 3e-3, "width": 16, "rollouts": 100, "presses": 1},
)


def success(actor, shown):
    """Share of 1,000 new episodes in which an actor succeeds."""
    env = Follow(1000, shown)
    seen, _ = env.reset(seed=99)
    for _ in range(STEPS):
        seen, rewards, *_ = env.step(actor(seen))
    return rewards.mean()


@pytest.fixture
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.slow
@pytest.mark.parametrize(("shown", "low", "high"), [(True, 0.9, 1.0), (False, 0.2, 0.4)])
def test_trpo_learns_to_go_where_it_sees_the_goal(one_thread, tmp_path, shown, low, high):
    """Blind policies cannot beat one that stays, which succeeds in 30 % of the episodes."""
    env, score = Follow(PARAMS.environments, shown), lambda actor: float(success(actor, shown))
    actor, curve, _ = train_trpo(env, PARAMS, 0, ("follow",), score, tmp_path / "trpo.pt")
    assert low <= success(actor, shown) <= high
    if shown:
        assert curve[-1][1] > curve[0][1] + 0.2  # success in training rises
