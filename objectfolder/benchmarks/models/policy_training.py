"""Training of policies by Stable-Baselines3, in parts that can be resumed."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from objectfolder.base.seeding import draw_seed
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.settings import GraspPolicyConfig, ReachConfig
from objectfolder.nets.checkpoint import Checkpoint, Training, TrainingState, run_training

Figures = tuple[float, ...]


@dataclass(frozen=True)
class PolicyPoint:
    """One row of a training curve."""

    done: int  #: steps or episodes so far
    figures: Figures  #: measured then
    seconds: float  #: of training and validation, those of interrupted calls included


@dataclass(frozen=True)
class PolicyTraining:
    """A policy that learns, and what differs between algorithms."""

    model: OnPolicyAlgorithm
    steps: int  #: of a part, in all environments together
    done_per_part: int  #: steps or episodes
    learning_rate: Callable[[int], float]  #: given those that are done
    actor: Callable[[], Actor]  #: mean action of the policy as it is now
    measure: Callable[[Actor], Figures]  #: after each part
    is_better: Callable[[Figures, Figures], bool]  #: than the best ones so far
    is_finished: Callable[[list[PolicyPoint]], bool]  #: given one point at least
    parts: dict[str, Any] = field(default_factory=dict)  #: what learns beside the model


def model_settings(
    params: ReachConfig | GraspPolicyConfig, seed: int, purpose: tuple[str, ...]
) -> dict[str, Any]:
    """Return the arguments that the algorithms of Stable-Baselines3 share."""
    return {
        "policy": "MlpPolicy",
        "n_steps": params.rollout,
        "batch_size": params.batch,
        "gamma": params.discount,
        "policy_kwargs": {"net_arch": [params.width] * 2, "log_std_init": params.log_deviation},
        "seed": draw_seed(seed, *purpose, "0"),
        "device": "cpu",  # two small layers: a GPU is slower
    }


def train_policy(
    training: PolicyTraining,
    params: ReachConfig | GraspPolicyConfig,
    seed: int,
    purpose: tuple[str, ...],
    checkpoint: Path,
    report: Callable[[PolicyPoint], None],
) -> tuple[Actor, list[list[Any]], float]:
    """Train a policy; the checkpoint keeps the state after each part; remove it afterwards.

    Every part starts with fresh episodes and generators that follow from its number. So the same arguments
    give the same policy, whether or not the call was interrupted in between. One thread is assumed; the
    global generators of torch, numpy and random are reseeded, since Stable-Baselines3 draws from them.

    Returns the best of all parts in validation, a row per part (what is done so far, and the figures), and
    seconds of training and validation, those of interrupted calls included. Raises ObjectFolderError if the
    checkpoint is damaged, or of a training with other parameters, seed or purpose.
    """
    model = training.model
    name = "/".join(purpose)
    identity = {"params": asdict(replace(params, seeds=1)), "seed": seed, "purpose": name}
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own leaves a folder in /tmp per training

    def advance(state: TrainingState[PolicyPoint]) -> PolicyPoint:
        part, rate = state.units + 1, training.learning_rate(state.units * training.done_per_part)
        # Stable-Baselines3 tells the progress of a part, which is not that of the training.
        model.lr_schedule = lambda _: rate
        model.set_random_seed(draw_seed(seed, name, str(part)))
        model.learn(training.steps)
        figures = training.measure(training.actor())
        return PolicyPoint(part * training.done_per_part, figures, state.seconds)

    def keep() -> dict[str, torch.Tensor]:
        return {key: torch.from_numpy(value) for key, value in training.actor().tensors().items()}

    state = run_training(
        Training(
            {"policy": model.policy, "optimizer": model.policy.optimizer, **training.parts},
            advance,
            is_finished=lambda state: bool(state.curve) and training.is_finished(state.curve),
            is_better=lambda new, best: training.is_better(new.figures, best.figures),
            keep=keep,
            point=PolicyPoint,
        ),
        Checkpoint(checkpoint, identity),
        report,
    )
    best = Actor.of({key: value.numpy() for key, value in state.best.items()})
    return best, [[point.done, *point.figures] for point in state.curve], state.seconds


def extract_layers(policy: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Copy the layers from which a policy computes its mean action, as `Actor` takes them."""
    linear = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    return [
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in (*linear, policy.action_net)
    ]
