"""TRPO learns what can be learnt in a task whose answer is in the observation."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from objectfolder.benchmarks.models.trpo import train_trpo
from objectfolder.benchmarks.models.trpo_config import GraspPolicyConfig
from objectfolder.envs.grasp_task import STEPS

PARAMS = GraspPolicyConfig(
    seeds=1,
    episodes=4000,
    environments=50,
    rollout=8,
    updates=2,
    patience=20,
    batch=100,
    learning_rate=3e-3,
    discount=0.95,
    gae=0.97,
    damping=0.01,
    divergence=0.01,
    width=16,
    log_deviation=-0.7,
    rollouts=100,
    presses=1,
)
NEAR = 0.3  #: of the target, at which an episode succeeds


class Follow(gymnasium.vector.VectorEnv):
    """Succeed by moving to a shown place within `STEPS`; rewards are as sparse as those of Grasp-v0."""

    def __init__(self, count, shown=True):
        self.num_envs, self.shown = count, shown
        self.single_observation_space = spaces.Box(-2, 2, (2,), np.float32)
        self.single_action_space = spaces.Box(-1, 1, (1,), np.float32)

    def _seen(self):
        return np.stack(
            [(self.target - self.place) * self.shown, np.full(self.num_envs, self.step_)], 1
        ).astype(np.float32)

    def _begin(self):
        self.target, self.place = self.rng.uniform(-1, 1, self.num_envs), np.zeros(self.num_envs)
        self.step_ = 0

    def reset(self, *, seed=None, options=None):
        self.rng = np.random.default_rng(seed)
        self._begin()
        return self._seen(), {}

    def step(self, actions):
        self.place = self.place + 0.6 * np.clip(actions[:, 0], -1, 1)
        self.step_ += 1
        ended = np.full(self.num_envs, self.step_ == STEPS)
        rewards = (ended & (np.abs(self.target - self.place) < NEAR)).astype(float)
        info = {"final_obs": self._seen()}
        if ended.all():
            self._begin()
        return self._seen(), rewards, ended, np.zeros(self.num_envs, bool), info


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
    actor, curve, _ = train_trpo(
        Follow(PARAMS.environments, shown),
        PARAMS,
        0,
        ("follow",),
        lambda actor: float(success(actor, shown)),
        tmp_path / "trpo.pt",
    )
    assert low <= success(actor, shown) <= high
    if shown:
        assert curve[-1][1] > curve[0][1] + 0.2  # success in training rises
