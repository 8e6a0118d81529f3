"""Proximal policy optimisation (Schulman et al. 2017) by Stable-Baselines3, in parts that can be resumed."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from objectfolder.benchmarks.models.actor import CLIP, Actor
from objectfolder.benchmarks.models.ppo_config import ReachConfig
from objectfolder.benchmarks.models.training import read_checkpoint
from objectfolder.io import atomic
from objectfolder.seeding import draw_seed

ROUNDS = 10  #: rollouts and updates of a part, after which the policy is validated and kept
SOLVED = 2  #: parts in a row without a failure in validation, after which training stops
#: Added to the variance of observations: what hardly moves in training, such as an object that nothing hits,
#: must not become huge when it does. 1 cm, or 1 degree.
VARIANCE_FLOOR = 1e-4
FORMAT = "objectfolder PPO 1"  #: of a checkpoint

Figures = tuple[float, ...]


def train_ppo(
    make: Callable[[], gymnasium.Env[np.ndarray, np.ndarray]],
    params: ReachConfig,
    seed: int,
    purpose: tuple[str, ...],
    validate: Callable[[Actor], Figures],
    checkpoint: Path,
    report: Callable[[int, Figures, float], None] = lambda steps, figures, seconds: None,
) -> tuple[Actor, list[list[float]], float]:
    """Train a policy until it makes no mistake in validation, `SOLVED` times in a row.

    Every part starts with fresh episodes and generators that follow from its number. So the same arguments
    give the same policy, whether or not the call was interrupted in between. One thread is assumed; the
    global generators of torch, numpy and random are reseeded, since Stable-Baselines3 draws from them.

    Parameters
    ----------
    make : callable
        Gives a new environment.
    params : ReachConfig
    seed : int
    purpose : tuple of str
        What is trained, for `objectfolder.seeding`.
    validate : callable
        Figures of a policy: the first is its success, 1 without a failure; a larger tuple is better.
    checkpoint : Path
        Keeps the state after each part, from which the same call goes on; remove it afterwards.
    report : callable
        Called after each part with the steps so far, the figures, and seconds since the start.

    Returns
    -------
    Actor
        Best of all parts in validation, the last of equals.
    list
        A row per part: control steps so far, and the figures.
    float
        Seconds of training and validation, those of interrupted calls included.

    Raises
    ------
    ObjectFolderError
        If the checkpoint is damaged, or of another training.
    """
    settings = {"params": asdict(replace(params, seeds=1)), "seed": seed, "purpose": "/".join(purpose)}
    envs = VecNormalize(
        DummyVecEnv([make] * params.environments),
        clip_obs=CLIP,
        gamma=params.discount,
        epsilon=VARIANCE_FLOOR,
    )
    curve: list[list[float]] = []

    def learning_rate(_: float) -> float:
        """Linear to 0: Stable-Baselines3 tells the progress of a part, which is not that of the training."""
        return params.learning_rate * (1 - (curve[-1][0] if curve else 0) / params.steps)

    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=params.rollout,
        batch_size=params.batch,
        n_epochs=params.epochs,
        learning_rate=learning_rate,
        gamma=params.discount,
        policy_kwargs={"net_arch": [params.width] * 2, "log_std_init": params.log_deviation},
        seed=draw_seed(seed, *purpose, "0"),
        device="cpu",  # two small layers: a GPU is slower
    )
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own leaves a folder in /tmp per training
    best, before = _actor(model, envs), 0.0
    if checkpoint.is_file():
        stored = read_checkpoint(checkpoint, FORMAT, settings)
        curve, before = stored["curve"], stored["seconds"]
        best = Actor.of({name: value.numpy() for name, value in stored["best"].items()})
        model.policy.load_state_dict(stored["policy"])
        model.policy.optimizer.load_state_dict(stored["optimizer"])
        envs.obs_rms = _statistics(stored["observations"])  # type: ignore[assignment]
        envs.ret_rms = _statistics(stored["returns"])
    start = time.perf_counter()
    while not _finished(curve, params.steps):
        model.set_env(envs, force_reset=True)
        model.set_random_seed(draw_seed(seed, *purpose, str(len(curve) + 1)))
        model.num_timesteps = int(curve[-1][0]) if curve else 0
        model.learn(ROUNDS * params.rollout * params.environments, reset_num_timesteps=False)
        actor = _actor(model, envs)
        figures = validate(actor)
        if not curve or figures >= max(tuple(row[1:]) for row in curve):
            best = actor
        curve.append([model.num_timesteps, *figures])
        seconds = before + time.perf_counter() - start
        state = {
            "format": FORMAT,
            "settings": settings,
            "curve": curve,
            "seconds": seconds,
            "best": {name: torch.from_numpy(value) for name, value in best.tensors().items()},
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "observations": _moments(cast(RunningMeanStd, envs.obs_rms)),
            "returns": _moments(envs.ret_rms),
        }
        with atomic(checkpoint) as temporary:
            torch.save(state, temporary)
        report(model.num_timesteps, figures, seconds)
    envs.close()
    return best, curve, before + time.perf_counter() - start


def _finished(curve: list[list[float]], steps: int) -> bool:
    solved = len(curve) >= SOLVED and all(row[1] == 1 for row in curve[-SOLVED:])
    return solved or bool(curve and curve[-1][0] >= steps)


def _actor(model: PPO, envs: VecNormalize) -> Actor:
    """Mean action of the policy as it is now."""
    policy, statistics = model.policy, cast(RunningMeanStd, envs.obs_rms)
    inner = (*policy.mlp_extractor.policy_net, policy.action_net)
    layers = [
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in inner
        if isinstance(layer, torch.nn.Linear)
    ]
    return Actor(statistics.mean.copy(), np.sqrt(statistics.var + VARIANCE_FLOOR), layers)


def _moments(statistics: RunningMeanStd) -> list[torch.Tensor]:
    return [torch.tensor(np.asarray(value)) for value in (statistics.mean, statistics.var, statistics.count)]


def _statistics(moments: list[torch.Tensor]) -> RunningMeanStd:
    statistics = RunningMeanStd(shape=tuple(moments[0].shape))
    statistics.mean, statistics.var = moments[0].numpy(), moments[1].numpy()
    statistics.count = moments[2].item()
    return statistics
