"""Learn to grasp an object by touch: TRPO in ``ObjectFolder/Grasp-v0`` (supplementary I.4)."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.policy_training import PolicyPoint
from objectfolder.benchmarks.models.settings import GraspPolicyConfig
from objectfolder.benchmarks.models.trpo import train_trpo
from objectfolder.benchmarks.reporting.film import mark_outcome, write_gif
from objectfolder.benchmarks.scoring.scores import share_95
from objectfolder.benchmarks.tasks.job import ObjectJob
from objectfolder.sim.camera import ExternalCamera
from objectfolder.sim.features import FeatureFunction, TouchBank, TouchFeatures
from objectfolder.sim.grasp import Episodes, GraspVectorEnv
from objectfolder.sim.grasp_task import FORCE, STEPS, GraspTask

#: Observations of trained policies: everything; tactile images alone, as the paper's; all but those; what is
#: known without touch.
OBSERVED = {"touch": "features", "tactile": "tactile", "width": "width", "blind": "blind"}
FRAME, PIXELS = 0.1, 160  #: seconds between frames of an animation, and their side in pixels

Policy = Callable[[Any], np.ndarray]  #: from observations of N episodes to (N, 4) actions


def grasp_policy(job: ObjectJob[GraspPolicyConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train policies that observe touch, only the jaw opening, or neither; score them.

    Test episodes start at other poses than training and validation, and those of each training seed at
    others; all policies of a seed start alike. Touch features come from a `TouchBank` during training; the
    test also computes them exactly with the Object File.

    The job's ``progress`` receives the files to keep: an animation if an episode can be shown
    (``episodes.gif``) and the first seed's policy (``model.safetensors``). Raises ObjectFolderError if the
    object does not fit the gripper, or the file lacks touch.

    Returns scores: by policy (`OBSERVED`, ``touch_exact``, ``random`` and ``nothing``) the success ``rate``,
    its ``interval_95`` over all rollouts (Wilson), and the rates of the ``seeds``; the numbers of
    ``rollouts`` per seed, of ``episodes`` per training and of ``presses`` in the bank; ``seconds`` of
    training.
    """
    params, seed, progress, key = job.params, job.seed, job.progress, job.file.key
    assert job.body is not None
    task = GraspTask(job.file, job.body, job.threads)
    bank = _bank(task, params.presses, seed, progress / "bank.npz", job.report)

    def rollouts(
        observation: str, features: FeatureFunction | None, policy: Policy, *part: str
    ) -> np.ndarray:
        rng = numpy_generator(seed, "grasp_policy", key, *part)
        return rollout_successes(Episodes(task, observation, features), policy, params.rollouts, rng)

    curve, seconds, actors = [], 0.0, {}
    for name, observation in OBSERVED.items():
        for run in range(params.seeds):
            env = GraspVectorEnv(params.environments, observation=observation, task=task, features=bank)

            def report(point: PolicyPoint, name: str = name, run: int = run) -> None:
                train, val = (100 * share for share in point.figures)
                job.report(
                    f"grasp {key} by {name}, seed {run + 1} of {params.seeds}: {point.done} of "
                    f"{params.episodes} episodes, success {train:.0f} % in training, {val:.0f} % in "
                    f"validation, {point.seconds:.0f} s"
                )

            def validate(actor: Actor, observation: str = observation) -> float:
                return float(rollouts(observation, bank, actor, "val").mean())

            purpose = ("grasp_policy", key, name, str(run))
            kept = progress / f"{name}_{run}.pt"
            actor, rows, took = train_trpo(env, params, seed, purpose, validate, kept, report)
            actors[name, run] = actor
            curve += [[name, run, int(row[0]), *row[1:]] for row in rows]
            seconds += took
    rng = numpy_generator(seed, "grasp_policy", key, "random")

    def random(observed: Any) -> np.ndarray:
        return rng.uniform(-1, 1, (len(observed), 4))

    def nothing(observed: Any) -> np.ndarray:
        return np.zeros((len(observed), 4))

    by_seed = range(params.seeds)
    policies: dict[str, tuple[str, FeatureFunction | None, Sequence[Policy]]] = {
        name: (observation, bank, [actors[name, run] for run in by_seed])
        for name, observation in OBSERVED.items()
    }
    policies["touch_exact"] = ("features", TouchFeatures(task.file), policies["touch"][2])
    policies["random"] = ("blind", None, [random for _ in by_seed])
    policies["nothing"] = ("blind", None, [nothing])
    scores: dict[str, Any] = {}
    for name, (observation, features, runs) in policies.items():
        # Other starts for each training seed: given the policies, rollouts are independent, as Wilson's
        # interval asks.
        success = np.stack(
            [rollouts(observation, features, policy, "test", str(run)) for run, policy in enumerate(runs)]
        )
        scores[name] = share_95(success) | {"seeds": [float(rate) for rate in success.mean(1)]}
    best = actors["touch", 0]
    best.save(progress / "model.safetensors", f"Grasp-v0 {key}")
    if frames := grasp_frames(task, bank, best, params.rollouts, seed):
        write_gif(progress / "episodes.gif", frames, FRAME)
    return scores | {
        "rollouts": params.rollouts,
        "episodes": params.episodes,
        "presses": len(bank.features),
        "seconds": seconds,
    }, curve


def rollout_successes(episodes: Episodes, policy: Policy, count: int, rng: np.random.Generator) -> np.ndarray:
    """Roll out ``count`` episodes and return which succeed; (count,) bool."""
    observed, rewards = episodes.begin(count, rng), np.zeros(count)
    for _ in range(STEPS):
        rewards = episodes.act(policy(observed))
        observed = episodes.observe()
    return rewards > 0


def grasp_frames(task: GraspTask, bank: TouchBank, actor: Actor, count: int, seed: int) -> list[np.ndarray]:
    """Draw the first success and the first failure of ``count`` rollouts; marked frames (H, W, 3).

    There are none if no rollout succeeds and all start in collision.
    """
    episodes = Episodes(task, "features", bank)
    rng = numpy_generator(seed, "grasp_policy", task.file.key, "film")
    held = rollout_successes(episodes, actor, count, rng)
    free = task.free(episodes.objects, episodes.hands)
    shown = [*np.flatnonzero(held)[:1], *np.flatnonzero(~held & free)[:1]]
    camera, frames = ExternalCamera(PIXELS), []
    for row in shown:
        place = task.place_object(episodes.objects[row])
        for moment in task.scene.watch(place, episodes.hands[row], FORCE, FRAME):
            frame = camera.picture(task.file, moment.place, moment.hand, moment.width)
            frames.append(mark_outcome(frame, held[row]))
    return frames


def _bank(task: GraspTask, poses: int, seed: int, path: Path, report: Callable[[str], None]) -> TouchBank:
    if path.is_file() and (kept := TouchBank.load(path, task.file.key)) is not None:
        return kept
    bank = task.bank(poses, seed, lambda done, total: report(f"{task.file.key}: {done} of {total} touches"))
    bank.save(path, task.file.key)
    return bank
