"""Trust region policy optimisation (Schulman et al. 2015) by sb3-contrib, in parts that can be resumed."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_contrib import TRPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.training import read_checkpoint
from objectfolder.benchmarks.models.trpo_config import GraspPolicyConfig
from objectfolder.envs.grasp_task import STEPS
from objectfolder.io import atomic
from objectfolder.seeding import draw_seed

FORMAT = "objectfolder TRPO 1"  #: of a checkpoint

Vector = gymnasium.vector.VectorEnv[Any, np.ndarray, np.ndarray]


class StableVector(VecEnv):
    """A vector environment of gymnasium, autoreset mode SAME_STEP, as Stable-Baselines3 wants it."""

    def __init__(self, env: Vector):
        self.env, self._seed = env, 0
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset."""
        self._seed = seed or 0
        return [seed] * self.num_envs

    def reset(self) -> Any:
        """Begin all episodes anew."""
        return self.env.reset(seed=self._seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        """Keep actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take a step."""
        seen, rewards, ended, _, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            for one, last, reward in zip(infos, info["final_obs"], rewards):
                one |= {"terminal_observation": last, "episode": {"r": reward, "l": 0, "t": 0.0}}
        return seen, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """It is not."""
        return [False] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Of the vector environment, for each."""
        return [getattr(self.env, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not supported: environments share everything."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Not supported: environments share everything."""
        raise NotImplementedError


def train_trpo(
    env: Vector,
    params: GraspPolicyConfig,
    seed: int,
    purpose: tuple[str, ...],
    validate: Callable[[Actor], float],
    checkpoint: Path,
    report: Callable[[int, float, float, float], None] = lambda *figures: None,
) -> tuple[Actor, list[list[float]], float]:
    """Train a policy.

    Every part, of ``params.updates`` updates, starts with fresh episodes and generators that follow from its
    number. So the same arguments give the same policy, whether or not the call was interrupted in between.
    One thread is assumed; the global generators of torch, numpy and random are reseeded, since
    Stable-Baselines3 draws from them.

    Parameters
    ----------
    env : VectorEnv
    params : GraspPolicyConfig
    seed : int
    purpose : tuple of str
        What is trained, for `objectfolder.seeding`.
    validate : callable
        Success of a policy.
    checkpoint : Path
        Keeps the state after each part, from which the same call goes on; remove it afterwards.
    report : callable
        Called after each part with the episodes so far, success in training and in validation, and seconds
        since the start.

    Returns
    -------
    Actor
        Best of all parts in validation, the last of equals.
    list
        A row per part: episodes so far, success in training, success in validation.
    float
        Seconds of training and validation, those of interrupted calls included.

    Raises
    ------
    ObjectFolderError
        If the checkpoint is damaged, or of another training.
    """
    settings = {"params": asdict(replace(params, seeds=1)), "seed": seed, "purpose": "/".join(purpose)}
    envs = StableVector(env)
    model = TRPO(
        "MlpPolicy",
        envs,
        n_steps=params.rollout,
        batch_size=params.batch,
        gamma=params.discount,
        gae_lambda=params.gae,
        cg_damping=params.damping,
        target_kl=params.divergence,
        learning_rate=params.learning_rate,
        policy_kwargs={"net_arch": [params.width] * 2, "log_std_init": params.log_deviation},
        seed=draw_seed(seed, *purpose, "0"),
        device="cpu",  # two small layers: a GPU is slower
    )
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own leaves a folder in /tmp per training
    curve: list[list[float]] = []
    best, before = _actor(model), 0.0
    if checkpoint.is_file():
        stored = read_checkpoint(checkpoint, FORMAT, settings)
        curve, before = stored["curve"], stored["seconds"]
        best = Actor.of({name: value.numpy() for name, value in stored["best"].items()})
        model.policy.load_state_dict(stored["policy"])
        model.policy.optimizer.load_state_dict(stored["optimizer"])
    start, steps = time.perf_counter(), params.rollout * env.num_envs
    while not _finished(curve, params):
        model.set_env(envs, force_reset=True)
        model.set_random_seed(draw_seed(seed, *purpose, str(len(curve) + 1)))
        model.num_timesteps = 0
        model.ep_info_buffer = None
        model.learn(params.updates * steps, reset_num_timesteps=False)
        played: Any = model.ep_info_buffer
        actor = _actor(model)
        success = validate(actor)
        if not curve or success >= max(row[2] for row in curve):
            best = actor
        done = (curve[-1][0] if curve else 0) + params.updates * steps // STEPS
        curve.append([done, float(np.mean([episode["r"] for episode in played])), success])
        seconds = before + time.perf_counter() - start
        state = {
            "format": FORMAT,
            "settings": settings,
            "curve": curve,
            "seconds": seconds,
            "best": {name: torch.from_numpy(value) for name, value in best.tensors().items()},
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
        }
        with atomic(checkpoint) as temporary:
            torch.save(state, temporary)
        report(int(done), curve[-1][1], success, seconds)
    return best, curve, before + time.perf_counter() - start


def _finished(curve: list[list[float]], params: GraspPolicyConfig) -> bool:
    """Whether all episodes are played, or validation was not better for as many parts as ``patience``."""
    if not curve or curve[-1][0] >= params.episodes:
        return bool(curve)
    best = max(range(len(curve)), key=lambda part: curve[part][2])
    return len(curve) - 1 - best >= params.patience


def _actor(model: TRPO) -> Actor:
    """Mean action of the policy as it is now."""
    policy: Any = model.policy
    linear = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers = [
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in (*linear, policy.action_net)
    ]
    size = layers[0][0].shape[1]
    return Actor(np.zeros(size), np.ones(size), layers)
