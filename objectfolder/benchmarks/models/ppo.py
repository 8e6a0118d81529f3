"""Proximal policy optimisation (Schulman et al. 2017) by Stable-Baselines3."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from objectfolder.benchmarks.models import policy_training
from objectfolder.benchmarks.models.actor import CLIP, Actor
from objectfolder.benchmarks.models.settings import ReachConfig

ROUNDS = 10  #: rollouts and updates of a part, after which the policy is validated and kept
SOLVED = 2  #: parts in a row without a failure in validation, after which training stops
#: Added to the variance of observations: what hardly moves in training, such as an object that nothing hits,
#: must not become huge when it does. 1 cm, or 1 degree.
VARIANCE_FLOOR = 1e-4


class _Moments:
    """Running means and variances of observations and returns, as part of a checkpoint."""

    def __init__(self, envs: VecNormalize):
        self._all = [cast(RunningMeanStd, envs.obs_rms), envs.ret_rms]

    def state_dict(self) -> list[list[torch.Tensor]]:
        return [[torch.tensor(np.asarray(x)) for x in (of.mean, of.var, of.count)] for of in self._all]

    def load_state_dict(self, stored: list[list[torch.Tensor]]) -> None:
        for of, (mean, variance, count) in zip(self._all, stored):
            of.mean, of.var, of.count = mean.numpy(), variance.numpy(), count.item()


def train_ppo(
    make: Callable[[], gymnasium.Env[np.ndarray, np.ndarray]],
    params: ReachConfig,
    seed: int,
    purpose: tuple[str, ...],
    validate: Callable[[Actor], policy_training.Figures],
    checkpoint: Path,
    report: Callable[[policy_training.PolicyPoint], None] = lambda point: None,
) -> tuple[Actor, list[list[Any]], float]:
    """Train a policy until it makes no mistake in validation, `SOLVED` times in a row.

    ``make`` gives a new environment; ``purpose`` names what is trained, for `objectfolder.base.seeding`.
    ``validate`` returns figures of a policy: the first is its success, 1 without a failure; a larger tuple is
    better. Of equally good parts the last one is kept. ``report`` is called after each part. For the
    rest, and the result, see `objectfolder.benchmarks.models.policy_training.train_policy`; its rows hold
    control steps and figures.
    """
    scaling: dict[str, Any] = {"clip_obs": CLIP, "gamma": params.discount, "epsilon": VARIANCE_FLOOR}
    envs = VecNormalize(DummyVecEnv([make] * params.environments), **scaling)
    settings = policy_training.model_settings(params, seed, purpose)
    model = PPO(env=envs, n_epochs=params.epochs, learning_rate=params.learning_rate, **settings)

    def actor() -> Actor:
        seen = cast(RunningMeanStd, envs.obs_rms)
        deviation = np.sqrt(seen.var + VARIANCE_FLOOR)
        return Actor(seen.mean.copy(), deviation, policy_training.extract_layers(model.policy))

    def is_finished(curve: list[policy_training.PolicyPoint]) -> bool:
        last = [point.figures[0] == 1 for point in curve[-SOLVED:]]
        return (len(last) == SOLVED and all(last)) or curve[-1].done >= params.steps

    steps = ROUNDS * params.rollout * params.environments
    training = policy_training.PolicyTraining(
        *(model, steps, steps),
        learning_rate=lambda done: params.learning_rate * (1 - done / params.steps),
        actor=actor,
        measure=validate,
        is_better=lambda new, best: new >= best,
        is_finished=is_finished,
        parts={"moments": _Moments(envs)},
    )
    try:
        return policy_training.train_policy(training, params, seed, purpose, checkpoint, report)
    finally:
        envs.close()
