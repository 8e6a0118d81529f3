"""Learn to grasp by touch: TRPO in ``ObjectFolder/Grasp-v0`` (supplementary I.4)."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.trpo import GraspPolicyConfig, train_trpo
from objectfolder.benchmarks.params import RobotParams
from objectfolder.benchmarks.reporting.film import write_gif
from objectfolder.benchmarks.scoring.scores import share_95
from objectfolder.benchmarks.tasks.running import leave, object_identity
from objectfolder.envs.body import rigid_body
from objectfolder.envs.camera import ExternalCamera
from objectfolder.envs.episodes import Episodes
from objectfolder.envs.features import FeatureFunction, TouchBank, TouchFeatures
from objectfolder.envs.grasp import GraspVectorEnv
from objectfolder.envs.grasp_task import FORCE, STEPS, GraspTask
from objectfolder.objectfile.file import ObjectFile
from objectfolder.seeding import numpy_generator

CURVE_COLUMNS = ("policy", "seed", "episodes", "train_success", "val_success")  #: of the training curves
#: What trained policies observe: all; all but the tactile images; what is known without touching.
OBSERVED = {"touch": "features", "width": "width", "blind": "blind"}
FRAME, PIXELS = 0.1, 160  #: seconds between frames of a film, and their side

Policy = Callable[[Any], np.ndarray]  #: observations of N episodes -> (N, 4) actions


def grasp_policy(
    task: GraspTask,
    params: GraspPolicyConfig,
    seed: int,
    progress: Path,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train policies that feel, that know the opening of the jaws alone, and that are blind; score them.

    Tests start where neither training nor validation did. Features of touches come from a `TouchBank` while
    policies learn; the test asks the Object File itself, too.

    Parameters
    ----------
    task : GraspTask
    params : GraspPolicyConfig
    seed : int
    progress : Path
        Folder of what is finished, and of what is kept: a film (``episodes.gif``) and the first seed's
        policy (``model.safetensors``). A call that was interrupted goes on from it: it must be empty, or of a
        call with the same arguments.
    report : callable
        Called with a line about each part of a training.

    Returns
    -------
    dict
        By policy (`OBSERVED`, ``touch_exact``, ``random`` and ``nothing``) the ``rate`` of success, its
        ``interval_95`` over all rollouts (Wilson), and the rates of the ``seeds``; the numbers of
        ``rollouts`` per seed, of ``episodes`` of a training and of ``presses`` that the bank holds;
        ``seconds`` of training.
    list
        Rows of the training curves: `CURVE_COLUMNS`.
    """
    key = task.file.key
    bank = _bank(task, params.presses, seed, progress / "bank.npz", report)

    def rollouts(observation: str, features: FeatureFunction | None, policy: Policy, part: str) -> np.ndarray:
        rng = numpy_generator(seed, "grasp_policy", key, part)
        return play(Episodes(task, observation, features), policy, params.rollouts, rng)

    curve, seconds, actors = [], 0.0, {}
    for name, observation in OBSERVED.items():
        for run in range(params.seeds):
            env = GraspVectorEnv(params.environments, observation=observation, task=task, features=bank)

            def say(
                done: int, train: float, val: float, took: float, name: str = name, run: int = run
            ) -> None:
                report(
                    f"grasp {key} by {name}, seed {run + 1} of {params.seeds}: {done} of {params.episodes} "
                    f"episodes, success {100 * train:.0f} % in training, {100 * val:.0f} % in validation, "
                    f"{took:.0f} s"
                )

            def validate(actor: Actor, observation: str = observation) -> float:
                return float(rollouts(observation, bank, actor, "val").mean())

            purpose = ("grasp_policy", key, name, str(run))
            actor, rows, took = train_trpo(
                env, params, seed, purpose, validate, progress / f"{name}_{run}.pt", say
            )
            actors[name, run] = actor
            curve += [[name, run, int(row[0]), *row[1:]] for row in rows]
            seconds += took
    rng = numpy_generator(seed, "grasp_policy", key, "random")

    def random(seen: Any) -> np.ndarray:
        return rng.uniform(-1, 1, (len(seen), 4))

    def nothing(seen: Any) -> np.ndarray:
        return np.zeros((len(seen), 4))

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
        success = np.stack([rollouts(observation, features, policy, "test") for policy in runs])
        scores[name] = share_95(success) | {"seeds": [float(rate) for rate in success.mean(1)]}
    best = actors["touch", 0]
    best.save(progress / "model.safetensors", f"Grasp-v0 {key}")
    write_gif(progress / "episodes.gif", film(task, bank, best, params.rollouts, seed), FRAME)
    return scores | {
        "rollouts": params.rollouts,
        "episodes": params.episodes,
        "presses": len(bank.features),
        "seconds": seconds,
    }, curve


def play(episodes: Episodes, policy: Policy, count: int, rng: np.random.Generator) -> np.ndarray:
    """Whether each of ``count`` episodes succeeds; (count,) bool."""
    seen, rewards = episodes.begin(count, rng), np.zeros(count)
    for _ in range(STEPS):
        rewards = episodes.act(policy(seen))
        seen = episodes.observe()
    return rewards > 0


def film(task: GraspTask, bank: TouchBank, actor: Actor, count: int, seed: int) -> list[np.ndarray]:
    """Frames (H, W, 3) of the first success and the first failure of ``count`` rollouts, marked below."""
    episodes = Episodes(task, "features", bank)
    held = play(episodes, actor, count, numpy_generator(seed, "grasp_policy", task.file.key, "film"))
    free = task.free(episodes.objects, episodes.hands)
    shown = [*np.flatnonzero(held)[:1], *np.flatnonzero(~held & free)[:1]]
    camera, frames = ExternalCamera(PIXELS), []
    for row in shown:
        place = task.placed(episodes.objects[row])
        for moment in task.scene.watch(place, episodes.hands[row], FORCE, FRAME):
            frame = camera.picture(task.file, moment.place, moment.hand, moment.width).copy()
            frame[-6:] = (30, 150, 60) if held[row] else (190, 40, 40)
            frames.append(frame)
    return frames


def run_grasp_policy(
    path: Path,
    hulls: Any,
    params: RobotParams[GraspPolicyConfig],
    folder: Benchmarks,
    report: Callable[[str], None],
    threads: int = 1,
) -> float:
    """Run the task with an Object File, and write scores, curves, policy and film.

    An interrupted call is gone on from, unless object, hulls, parameters or the task's code have changed.

    Parameters
    ----------
    path : Path
    hulls : sequence of trimesh.Trimesh
        Convex parts of the object.
    params : RobotParams
    folder : Benchmarks
    report : callable
        Called with a line about each part of a training.
    threads : int
        Of the simulation; the same figures follow for any number.

    Returns
    -------
    Seconds that training took, those of interrupted calls included.

    Raises
    ------
    ObjectFolderError
        If the object does not fit the gripper, or the file lacks touch.
    """
    file = ObjectFile.load(path)
    task = GraspTask(file, rigid_body(file, hulls), threads)
    identity = object_identity(path, hulls, params, grasp_policy)
    progress = folder.progress("grasp_policy", file.key, identity)
    scores, curve = grasp_policy(task, params.settings, params.seed, progress, report)
    return leave("grasp_policy", file.key, folder, progress, scores, CURVE_COLUMNS, curve)


def _bank(task: GraspTask, poses: int, seed: int, path: Path, report: Callable[[str], None]) -> TouchBank:
    if path.is_file() and (kept := TouchBank.load(path, task.file.key)) is not None:
        return kept
    bank = task.bank(poses, seed, lambda done, total: report(f"{task.file.key}: {done} of {total} touches"))
    bank.save(path, task.file.key)
    return bank
