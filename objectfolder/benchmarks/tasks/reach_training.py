"""Reach past an object: PPO on the task of Meta-World's MT1 (supplementary J)."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from objectfolder.base.seeding import numpy_generator
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.policy_training import PolicyPoint
from objectfolder.benchmarks.models.ppo import train_ppo
from objectfolder.benchmarks.models.settings import ReachConfig
from objectfolder.benchmarks.reporting.film import mark_outcome, write_gif
from objectfolder.benchmarks.scoring.scores import share_95
from objectfolder.benchmarks.tasks.job import ObjectJob
from objectfolder.sim.reach import ACTION_SCALE, TIP, ReachEnv

POLICIES = ("ppo", "controller", "random", "nothing")  #: that are scored
GAIN = 0.5  #: of the controller: fraction of the distance to the goal per step
FRAME_STEPS, FRAME = 4, 0.05  #: control steps and seconds between frames of an animation

Policy = Callable[[np.ndarray], np.ndarray]  #: from an observation (39,) to an action (4,)
Env = gymnasium.Env[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class EpisodeScores:
    """Scores of E episodes."""

    last: np.ndarray  #: (E,) bool: near the goal at the last step
    ever: np.ndarray  #: (E,) bool: near the goal at any time
    returns: np.ndarray  #: (E,) float64: sum of the rewards
    distance: np.ndarray  #: (E,) float64: from the goal at the last step, m


def episode_steps(env: Env, policy: Policy, seed: int) -> Iterator[tuple[float, dict[str, Any]]]:
    """Run one episode; yield reward and info of each step."""
    observation, _ = env.reset(seed=seed)
    done = False
    while not done:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        done = terminated or truncated
        yield float(reward), info


def run_episodes(env: Env, policy: Policy, seeds: Iterable[int]) -> EpisodeScores:
    """Run an episode from each seed, which determines the goal and the placement of the object."""
    rows = []
    for seed in seeds:
        rewards, infos = zip(*episode_steps(env, policy, seed))
        success = [info["success"] == 1 for info in infos]
        rows.append((success[-1], any(success), sum(rewards), infos[-1]["distance"]))
    last, ever, returns, distance = map(np.array, zip(*rows))
    return EpisodeScores(last, ever, returns, distance)


def fresh_seeds(seed: int, key: str, part: str, count: int) -> list[int]:
    """Draw the seeds of the episodes of a part, such as ``val`` or ``test``; training uses other goals."""
    return [int(s) for s in numpy_generator(seed, "reach", key, part).integers(2**31, size=count)]


def controller(observation: np.ndarray) -> np.ndarray:
    """Move straight towards the goal, whose position is part of the observation: an upper baseline."""
    error = observation[36:39] - (observation[:3] + TIP)
    return np.append(np.clip(GAIN * error / ACTION_SCALE, -1, 1), 0).astype(np.float32)


def nothing(observation: np.ndarray) -> np.ndarray:
    """Stay in place."""
    return np.zeros(4, np.float32)


def random_policy(rng: np.random.Generator) -> Policy:
    """Return a policy of uniformly random actions."""
    return lambda observation: rng.uniform(-1, 1, 4).astype(np.float32)


def environment_class(task: str) -> Callable[..., Env]:
    """Return the environment class of a task, ``reach`` or ``metaworld_reach``."""
    if task == "reach":
        return ReachEnv
    from objectfolder.sim.metaworld import MetaWorldReach

    return MetaWorldReach


def reach(job: ObjectJob[ReachConfig]) -> tuple[dict[str, Any], list[list[Any]]]:
    """Train PPO with one object on the table, and score it on goals not used in training.

    Those of each training seed are others; baselines are scored on those of the first. The job's task is
    ``reach``, with a floating hand, or ``metaworld_reach``, with Meta-World's Sawyer arm. Its ``progress``
    receives the files to keep: an animation of one success and one failure, as far as there are any
    (``episodes.gif``), and the first training's policy (``model.safetensors``). Raises ObjectFolderError if
    the object does not fit into the scene.

    Returns scores: for each of `POLICIES` its success at the ``last`` step and at ``any`` time, both with
    ``interval_95`` (Wilson, over all episodes), mean ``return`` and ``distance`` at the end (m); for PPO the
    success of each of the ``seeds``. The numbers of ``episodes`` and, for each training, of control
    ``steps``; ``seconds`` of training.
    """
    task, body, params, seed, progress = job.task, job.body, job.params, job.seed, job.progress
    assert body is not None
    make = partial(environment_class(task), body, horizon=params.horizon)
    val = fresh_seeds(seed, body.key, "val", params.goals)
    # Other goals for each training: given its policy, episodes are independent, as Wilson's interval asks.
    tests = [
        fresh_seeds(seed, body.key, f"test {run}" if run else "test", params.goals)
        for run in range(params.seeds)
    ]
    env = make()

    def validate(actor: Actor) -> tuple[float, ...]:
        played = run_episodes(env, actor, val)
        means = (played.last, played.ever, played.returns, played.distance)
        return tuple(float(values.mean()) for values in means)

    actors, curve, steps, seconds = [], [], [], 0.0
    for run in range(params.seeds):

        def report(point: PolicyPoint, run: int = run) -> None:
            last, ever = (round(100 * share) for share in point.figures[:2])
            job.report(
                f"{task} {body.key}, seed {run + 1} of {params.seeds}, {point.done} of {params.steps} steps: "
                f"validation success {last} % at the last step, {ever} % at any time, {point.seconds:.0f} s"
            )

        purpose = (task, body.key, str(run))
        actor, rows, took = train_ppo(make, params, seed, purpose, validate, progress / f"{run}.pt", report)
        actors.append(actor)
        curve += [[run, int(row[0]), *row[1:]] for row in rows]
        steps.append(int(rows[-1][0]))
        seconds += took
    trained = [run_episodes(env, actor, goals) for actor, goals in zip(actors, tests)]
    rng = numpy_generator(seed, "reach", body.key, "random")
    baselines = {"controller": controller, "random": random_policy(rng), "nothing": nothing}
    scores = {name: _summary([run_episodes(env, act, tests[0])]) for name, act in baselines.items()}
    actors[0].save(progress / "model.safetensors", f"{task} {body.key}")
    if "rgb_array" in env.metadata["render_modes"]:
        last = trained[0].last
        shown = [*np.flatnonzero(last)[:1], *np.flatnonzero(~last)[:1]]
        frames = reach_frames(make(render_mode="rgb_array"), actors[0], [tests[0][i] for i in shown])
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


def reach_frames(env: Env, policy: Policy, seeds: Sequence[int]) -> list[np.ndarray]:
    """Draw episodes; frames (H, W, 3), marked green near the goal and red elsewhere."""
    return [
        mark_outcome(np.asarray(env.render()), info["success"])
        for seed in seeds
        for step, (_, info) in enumerate(episode_steps(env, policy, seed))
        if step % FRAME_STEPS == 0
    ]


def _summary(played: Sequence[EpisodeScores]) -> dict[str, Any]:
    last, ever = (np.array([getattr(part, name) for part in played]) for name in ("last", "ever"))
    return {
        "last": share_95(last),
        "any": share_95(ever),
        "return": float(np.mean([part.returns for part in played])),
        "distance": float(np.mean([part.distance for part in played])),
        "seeds": [float(value) for value in last.mean(1)],
    }
