"""Trust region policy optimisation (Schulman et al. 2015) by sb3-contrib."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from sb3_contrib import TRPO
from stable_baselines3.common.vec_env import VecEnv

from objectfolder.benchmarks.models import policy_training
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.sim.grasp_task import STEPS

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

    def set_attr(self, *given: Any, **named: Any) -> Any:
        """Not supported: environments share everything."""
        raise NotImplementedError

    env_method = set_attr


def train_trpo(
    env: Vector,
    params: GraspPolicyConfig,
    seed: int,
    purpose: tuple[str, ...],
    validate: Callable[[Actor], float],
    checkpoint: Path,
    report: Callable[[policy_training.PolicyPoint], None] = lambda point: None,
) -> tuple[Actor, list[list[Any]], float]:
    """Train a policy in parts of ``params.updates`` updates.

    ``purpose`` names what is trained, for `objectfolder.base.seeding`; ``validate`` returns the success of a
    policy. Of equally good parts the last one is kept. ``report`` is called after each part. For the rest,
    and the result, see `objectfolder.benchmarks.models.policy_training.train_policy`; its rows hold episodes
    and success in training and in validation.
    """
    envs = StableVector(env)
    settings = policy_training.model_settings(params, seed, purpose)
    settings |= {"gae_lambda": params.gae, "cg_damping": params.damping, "target_kl": params.divergence}
    model = TRPO(env=envs, learning_rate=params.learning_rate, **settings)

    def actor() -> Actor:
        layers = policy_training.extract_layers(model.policy)
        size = layers[0][0].shape[1]
        return Actor(np.zeros(size), np.ones(size), layers)

    def measure(actor: Actor) -> policy_training.Figures:
        played: Any = model.ep_info_buffer
        return float(np.mean([episode["r"] for episode in played])), validate(actor)

    def is_finished(curve: list[policy_training.PolicyPoint]) -> bool:
        # Patience counts from the first of equally good parts.
        best = max(range(len(curve)), key=lambda part: curve[part].figures[1])
        return curve[-1].done >= params.episodes or len(curve) - 1 - best >= params.patience

    steps = params.updates * params.rollout * env.num_envs
    training = policy_training.PolicyTraining(
        *(model, steps, steps // STEPS),
        learning_rate=lambda done: params.learning_rate,
        actor=actor,
        measure=measure,
        is_better=lambda new, best: new[1] >= best[1],
        is_finished=is_finished,
    )

    return policy_training.train_policy(training, params, seed, purpose, checkpoint, report)
