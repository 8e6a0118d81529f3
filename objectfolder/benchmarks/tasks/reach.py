"""Reach with an object of one's own: PPO on the task of Meta-World's MT1 (supplementary J)."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from objectfolder.benchmarks.layout import Benchmarks
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.ppo import ReachConfig, train_ppo
from objectfolder.benchmarks.params import RobotParams
from objectfolder.benchmarks.reporting.film import write_gif
from objectfolder.benchmarks.scoring.scores import share_95
from objectfolder.benchmarks.tasks.running import leave, object_identity
from objectfolder.envs.body import RigidBody, rigid_body
from objectfolder.envs.reach import ACTION_SCALE, TIP, ReachEnv
from objectfolder.objectfile.file import ObjectFile
from objectfolder.seeding import numpy_generator

if TYPE_CHECKING:
    import trimesh

#: Of the training curves; figures are those of the validation goals.
CURVE_COLUMNS = ("seed", "steps", "val_last", "val_any", "val_return", "val_distance")
TASKS = ("reach", "metaworld_reach")  #: with a floating hand, and with Meta-World's Sawyer arm
POLICIES = ("ppo", "controller", "random", "nothing")  #: that are scored
GAIN = 0.5  #: of the controller: share of the way to the goal that it asks for in a step
FRAME_STEPS, FRAME = 4, 0.05  #: from one frame of a film to the next: control steps, seconds

Policy = Callable[[np.ndarray], np.ndarray]  #: observation (39,) -> action (4,)
Env = gymnasium.Env[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Episodes:
    """What episodes came to, E of them."""

    last: np.ndarray  #: (E,) bool: near the goal at the last step
    ever: np.ndarray  #: (E,) bool: near the goal at any time
    returns: np.ndarray  #: (E,) float64: sum of the rewards
    distance: np.ndarray  #: (E,) float64: from the goal at the last step, m


def play(env: Env, policy: Policy, seed: int) -> Iterator[tuple[float, dict[str, Any]]]:
    """Play one episode; give reward and info of each step."""
    observation, _ = env.reset(seed=seed)
    done = False
    while not done:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        done = terminated or truncated
        yield float(reward), info


def episodes(env: Env, policy: Policy, seeds: Iterable[int]) -> Episodes:
    """Play an episode from each seed, which gives the goal and the object's place."""
    rows = []
    for seed in seeds:
        rewards, infos = zip(*play(env, policy, seed))
        success = [info["success"] == 1 for info in infos]
        rows.append((success[-1], any(success), sum(rewards), infos[-1]["distance"]))
    last, ever, returns, distance = map(np.array, zip(*rows))
    return Episodes(last, ever, returns, distance)


def fresh_seeds(seed: int, key: str, part: str, count: int) -> list[int]:
    """Seeds of the episodes of a part, ``val`` or ``test``; no training meets their goals."""
    return [int(s) for s in numpy_generator(seed, "reach", key, part).integers(2**31, size=count)]


def controller(observation: np.ndarray) -> np.ndarray:
    """Straight towards the goal: what the task admits, as it is told where that is."""
    error = observation[36:39] - (observation[:3] + TIP)
    return np.append(np.clip(GAIN * error / ACTION_SCALE, -1, 1), 0).astype(np.float32)


def nothing(observation: np.ndarray) -> np.ndarray:
    """Stay where you are."""
    return np.zeros(4, np.float32)


def random_policy(rng: np.random.Generator) -> Policy:
    """Any action, whatever is observed."""
    return lambda observation: rng.uniform(-1, 1, 4).astype(np.float32)


def environment(task: str) -> Callable[..., Env]:
    """Class of the environments of a task, one of `TASKS`."""
    if task == "reach":
        return ReachEnv
    from objectfolder.envs.metaworld import MetaWorldReach

    return MetaWorldReach


def reach(
    body: RigidBody,
    params: ReachConfig,
    seed: int,
    progress: Path,
    report: Callable[[str], None] = lambda line: None,
    task: str = "reach",
) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train PPO with one object on the table, and score it on goals that no training met.

    Parameters
    ----------
    body : RigidBody
    params : ReachConfig
    seed : int
    progress : Path
        Folder of checkpoints, and of what is kept: a film of one success and, if there is any, one failure
        (``episodes.gif``), and the first training's policy (``model.safetensors``). A call that was
        interrupted goes on from it: it must be empty, or of a call with the same arguments.
    report : callable
        Called with a line about each part of a training.
    task : str
        One of `TASKS`.

    Returns
    -------
    dict
        For each of `POLICIES` its success at the ``last`` step and at ``any`` time, both with ``interval_95``
        (Wilson, over all episodes), mean ``return`` and ``distance`` at the end (m); for PPO the
        success of each of the ``seeds``. The numbers of ``episodes`` and, for each training, of control
        ``steps``; ``seconds`` of training.
    list
        Rows of the training curves: `CURVE_COLUMNS`.
    """
    make = partial(environment(task), body, horizon=params.horizon)
    goals = {part: fresh_seeds(seed, body.key, part, params.goals) for part in ("val", "test")}
    env = make()

    def validate(actor: Actor) -> tuple[float, ...]:
        played = episodes(env, actor, goals["val"])
        means = (played.last, played.ever, played.returns, played.distance)
        return tuple(float(values.mean()) for values in means)

    actors, curve, steps, seconds = [], [], [], 0.0
    for run in range(params.seeds):

        def say(done: int, figures: tuple[float, ...], elapsed: float, run: int = run) -> None:
            last, ever = (round(100 * share) for share in figures[:2])
            report(
                f"{task} {body.key}, seed {run + 1} of {params.seeds}, {done} of {params.steps} steps: "
                f"validation success {last} % at the last step, {ever} % at any time, {elapsed:.0f} s"
            )

        purpose = (task, body.key, str(run))
        actor, rows, took = train_ppo(make, params, seed, purpose, validate, progress / f"{run}.pt", say)
        actors.append(actor)
        curve += [[run, int(row[0]), *row[1:]] for row in rows]
        steps.append(int(rows[-1][0]))
        seconds += took
    trained = [episodes(env, actor, goals["test"]) for actor in actors]
    rng = numpy_generator(seed, "reach", body.key, "random")
    baselines = {"controller": controller, "random": random_policy(rng), "nothing": nothing}
    scores = {name: _summary([episodes(env, act, goals["test"])]) for name, act in baselines.items()}
    actors[0].save(progress / "model.safetensors", f"{task} {body.key}")
    if "rgb_array" in env.metadata["render_modes"]:
        shown = [trained[0].last.argmax(), *np.flatnonzero(~trained[0].last)[:1]]
        frames = film(make(render_mode="rgb_array"), actors[0], [goals["test"][i] for i in shown])
        write_gif(progress / "episodes.gif", frames, FRAME)
    env.close()
    return {
        "ppo": _summary(trained),
        **scores,
        "episodes": params.goals,
        "horizon": params.horizon,
        "task": task,
        "steps": steps,
        "seconds": seconds,
    }, curve


def film(env: Env, policy: Policy, seeds: Sequence[int]) -> list[np.ndarray]:
    """Frames (H, W, 3) of episodes, a line below them: green near the goal, red elsewhere."""
    frames = []
    for seed in seeds:
        for step, (_, info) in enumerate(play(env, policy, seed)):
            if step % FRAME_STEPS == 0:
                frame = np.array(env.render())
                frame[-6:] = (30, 150, 60) if info["success"] else (190, 40, 40)
                frames.append(frame)
    return frames


def run_reach(
    path: Path,
    hulls: "Sequence[trimesh.Trimesh]",
    params: RobotParams[ReachConfig],
    folder: Benchmarks,
    report: Callable[[str], None],
    task: str = "reach",
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
    task : str
        One of `TASKS`.

    Returns
    -------
    Seconds that training took, those of interrupted calls included.

    Raises
    ------
    ObjectFolderError
        If the object does not fit into the scene.
    """
    body = rigid_body(ObjectFile.load(path), hulls)
    progress = folder.progress(task, body.key, object_identity(path, hulls, params, reach))
    scores, curve = reach(body, params.settings, params.seed, progress, report, task)
    return leave(task, body.key, folder, progress, scores, CURVE_COLUMNS, curve)


def _summary(played: Sequence[Episodes]) -> dict[str, Any]:
    last, ever = (np.array([getattr(part, name) for part in played]) for name in ("last", "ever"))
    return {
        "last": share_95(last),
        "any": share_95(ever),
        "return": float(np.mean([part.returns for part in played])),
        "distance": float(np.mean([part.distance for part in played])),
        "seeds": [float(value) for value in last.mean(1)],
    }
