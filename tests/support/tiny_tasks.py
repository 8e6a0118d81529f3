"""Tasks for trainings of policies that take seconds."""

import gymnasium
import numpy as np
from gymnasium import spaces

from objectfolder.sim.grasp_task import STEPS

NEAR = 0.3  #: of the target, at which an episode of `Follow` succeeds


class Line(gymnasium.Env):
    """A point on a line: the reward of a step is minus its distance from zero."""

    observation_space = spaces.Box(-5, 5, (1,), np.float64)
    action_space = spaces.Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.uniform(-1, 1, 1), 0
        return self.place.copy(), {}

    def step(self, action):
        self.place, self.steps = np.clip(self.place + 0.3 * action, -5, 5), self.steps + 1
        return self.place.copy(), -float(abs(self.place[0])), False, self.steps == 10, {}


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
