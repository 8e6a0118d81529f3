from dataclasses import asdict, replace

import numpy as np
import pytest
from PIL import Image
from refusals import refused
from ruamel.yaml import YAML
from tiny_tasks import Line
from typer.testing import CliRunner

from objectfolder.base.arrays import write_safetensors
from objectfolder.base.io import read_json
from objectfolder.benchmarks.models import ppo
from objectfolder.benchmarks.models.actor import Actor
from objectfolder.benchmarks.models.ppo import train_ppo
from objectfolder.benchmarks.models.settings import ReachConfig
from objectfolder.benchmarks.tasks import reach_training as task
from objectfolder.benchmarks.tasks.job import ObjectJob
from objectfolder.benchmarks.tasks.reach import TASK
from objectfolder.benchmarks.tasks.running import KnownObject, Run, run_benchmark
from objectfolder.benchmarks.tasks.task import TaskParams
from objectfolder.cli import app
from objectfolder.sim.body import rigid_body
from objectfolder.sim.reach import ReachEnv
from objectfolder.workspace.layout import Benchmarks

TINY = ReachConfig(
    **{"seeds": 1, "steps": 32, "horizon": 8, "goals": 2, "environments": 2, "rollout": 8, "batch": 8},
    **{"epochs": 2, "learning_rate": 1e-3, "discount": 0.9, "width": 4, "log_deviation": -0.5},
)


@pytest.fixture(scope="module")
def body(brick):
    return rigid_body(brick, [brick.to_mesh().convex_hull])


@pytest.fixture(autouse=True)
def _short_parts(monkeypatch):
    """Two rollouts in a part."""
    monkeypatch.setattr(ppo, "ROUNDS", 2)


def _score(actor):
    """Success, and minus the distance that is left: of a point at 0.8."""
    place = np.array([0.8])
    for _ in range(10):
        place = place + 0.3 * actor(place)
    return float(abs(place[0]) < 0.1), -float(abs(place[0]))


def _train(checkpoint, steps=512, validate=_score, report=lambda *point: None, **changes):
    small = {"steps": steps, "rollout": 16, "environments": 4, "batch": 32, "learning_rate": 0.01}
    params = replace(TINY, **small | changes)
    return train_ppo(Line, params, 0, ("test",), validate, checkpoint, report)


def _bytes(actor):
    return {name: value.tobytes() for name, value in actor.tensors().items()}


def test_ppo_learns_and_stops_when_nothing_fails_twice(tmp_path):
    actor, curve, seconds = _train(tmp_path / "a.pt", steps=12800)
    assert _score(actor)[0] == 1
    solved = "".join(str(int(row[1])) for row in curve)
    assert solved.endswith("11")
    assert "11" not in solved[:-1]
    assert [row[0] for row in curve] == [128 * (part + 1) for part in range(len(curve))]  # 2 rollouts of 64
    assert seconds > 0


def test_the_best_part_in_validation_is_kept(tmp_path, monkeypatch):
    figures = iter([(0.5, 1.0), (0.7, 0.0), (0.7, 0.0), (0.6, 9.0)])
    actors = []

    def validate(actor):
        actors.append(actor)
        return next(figures)

    best, _, _ = _train(tmp_path / "a.pt", validate=validate)
    assert _bytes(best) == _bytes(actors[2]) != _bytes(actors[1])


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    checkpoint = tmp_path / "a.pt"
    _train(checkpoint, steps=128)
    refused(r"a\.pt is of a training with .* delete it", _train, checkpoint, steps=256)
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    refused(r"a\.pt is damaged", _train, checkpoint, steps=128)


@pytest.fixture
def models(monkeypatch):
    """Models of Stable-Baselines3 that a test has trained."""
    found = []

    class Kept(ppo.PPO):
        def __init__(self, *arguments, **named):
            super().__init__(*arguments, **named)
            found.append(self)

    monkeypatch.setattr(ppo, "PPO", Kept)
    return found


def test_the_learning_rate_falls_to_nothing(models, tmp_path):
    rates = []

    def report(*point):
        rates.append(models[0].policy.optimizer.param_groups[0]["lr"])

    _train(tmp_path / "a.pt", validate=lambda actor: (0.0,), report=report)
    np.testing.assert_allclose(rates, [0.01, 0.0075, 0.005, 0.0025], rtol=1e-12)


def test_the_arrays_act_as_the_policy_does(models, tmp_path):
    """`Actor` against Stable-Baselines3's own normalisation and nets."""
    last = []
    _train(tmp_path / "a.pt", steps=128, validate=lambda actor: (last.append(actor) or 0.0,))
    observations = np.linspace(-1, 1, 21)[:, None]
    normalised = models[0].get_vec_normalize_env().normalize_obs(observations)
    expected, _ = models[0].predict(normalised, deterministic=True)
    np.testing.assert_allclose(last[0](observations), expected, atol=1e-6)
    assert len(np.unique(expected)) > 3


def test_an_actor_is_read_as_it_was_written(tmp_path):
    rng = np.random.default_rng(0)
    layers = [(rng.standard_normal((n, 2)), rng.standard_normal(n)) for n in (2, 1)]
    actor = Actor(np.zeros(2), np.ones(2), layers)
    actor.save(tmp_path / "actor.safetensors", "test")
    read = Actor.load(tmp_path / "actor.safetensors")
    assert _bytes(read) == _bytes(actor)
    write_safetensors(tmp_path / "other.safetensors", {"x": np.ones(1)}, {"format": "other"})
    refused(r"other\.safetensors is not a trained policy", Actor.load, tmp_path / "other.safetensors")


def test_an_actor_by_hand():
    layers = [(np.eye(2), np.zeros(2)), (np.array([[1.0, 1.0]]), np.ones(1))]
    actor = Actor(np.array([1.0, 0.0]), np.array([2.0, 1e-9]), layers)
    np.testing.assert_allclose(actor(np.array([2.0, 0.0])), [min(1, np.tanh(0.5) + 1)])
    np.testing.assert_allclose(actor(np.array([1.0, -1.0])), [np.tanh(-10) + 1], atol=1e-9)  # cut at 10


def test_baselines_bound_the_task(body):
    env = ReachEnv(body, horizon=60)
    seeds = task.fresh_seeds(0, "brick", "test", 5)
    best, idle = task.run_episodes(env, task.controller, seeds), task.run_episodes(env, task.nothing, seeds)
    aimless = task.run_episodes(env, task.random_policy(np.random.default_rng(0)), seeds)
    assert best.last.all()
    assert best.ever.all()
    assert not idle.ever.any()
    assert aimless.last.mean() < 0.5
    assert (best.returns > idle.returns).all()
    assert (idle.distance > 0.05).all()
    assert (best.distance < 1e-3).all()


def test_success_at_any_time_is_not_success_at_the_end(body):
    env = ReachEnv(body, horizon=80)

    def leaving(observation):
        """To the goal, then away, which the opening of the gripper remembers."""
        near = np.linalg.norm(observation[36:39] - observation[:3] - [0, 0, -0.045]) < 0.03
        away = near or observation[3] < 0.97
        return np.array([0, -1, 1, 1], np.float32) if away else task.controller(observation) - [0, 0, 0, 1]

    played = task.run_episodes(env, leaving, [0, 1])
    assert played.ever.all()
    assert not played.last.any()


def test_goals_of_validation_and_test_are_others_and_stay():
    val, test = (task.fresh_seeds(0, "mug", part, 100) for part in ("val", "test"))
    assert len({*val, *test}) == 200
    assert task.fresh_seeds(0, "mug", "test", 10) == test[:10]
    assert task.fresh_seeds(1, "mug", "test", 10) != test[:10] != task.fresh_seeds(0, "cup", "test", 10)


def test_films_show_where_the_goal_is_met(body):
    env = ReachEnv(body, horizon=60, render_mode="rgb_array", resolution=(30, 40))
    frames = task.reach_frames(env, task.controller, [0, 1])
    assert len(frames) == 2 * 15
    assert {tuple(frame[-1, 0]) for frame in (frames[0], frames[15])} == {(190, 40, 40)}
    assert {tuple(frame[-1, 0]) for frame in (frames[14], frames[29])} == {(30, 150, 60)}


def test_scores_have_everything_and_are_the_same_again(brick, body, tmp_path):
    said = []
    params = replace(TINY, seeds=2)
    scores, curve = task.reach(ObjectJob("reach", brick, body, params, 0, tmp_path / "a", said.append))
    assert len(said) == len(curve) == 2  # a part has 32 steps
    assert [row[:2] for row in curve] == [[0, 32], [1, 32]]
    assert len(curve[0]) == len(TASK.columns)
    assert scores["steps"] == [32, 32]
    for name in task.POLICIES:
        low, high = scores[name]["last"]["interval_95"]
        assert 0 <= low <= scores[name]["last"]["rate"] <= scores[name]["any"]["rate"] <= 1
        assert low <= high
    assert len(scores["ppo"]["seeds"]) == 2
    # Of none of n the upper end of Wilson's interval is z^2 / (n + z^2).
    high = pytest.approx(1.96**2 / (2 + 1.96**2), abs=1e-4)
    assert scores["nothing"]["last"] == {"rate": 0, "interval_95": [0, high]}
    again, curve_again = task.reach(ObjectJob("reach", brick, body, params, 0, tmp_path / "b"))
    assert curve_again == curve
    assert again | {"seconds": 0} == scores | {"seconds": 0}
    assert (tmp_path / "b/episodes.gif").read_bytes() == (tmp_path / "a/episodes.gif").read_bytes()


@pytest.fixture
def play(monkeypatch):
    """Lets episodes end as told; lists the policies and goals that are asked for, and goals of films."""
    asked, shown = [], []

    def by(last):
        def run_episodes(env, policy, seeds):
            asked.append((policy, seeds))
            return task.EpisodeScores(*[np.array(last)] * 2, *[np.zeros(len(last))] * 2)

        monkeypatch.setattr(task, "run_episodes", task.run_episodes)
        return asked, shown

    def frames(env, policy, seeds):
        shown.extend(seeds)
        return [np.zeros((8, 8, 3), np.uint8)]

    monkeypatch.setattr(task, "reach_frames", frames)
    return by


def test_each_training_is_scored_on_goals_of_its_own(brick, body, tmp_path, monkeypatch, play):
    class Trained:
        save = staticmethod(lambda *given: None)

    asked, _ = play([True] * 2)
    monkeypatch.setattr(task, "train_ppo", lambda *given: (Trained(), [[32, 0, 0, 0, 0]], 0.0))
    scores, _ = task.reach(ObjectJob("reach", brick, body, replace(TINY, seeds=2), 0, tmp_path))
    first, second = (seeds for policy, seeds in asked if isinstance(policy, Trained))
    assert first == task.fresh_seeds(0, brick.key, "test", TINY.goals)  # as with one seed
    assert not set(first) & set(second)
    assert {tuple(seeds) for policy, seeds in asked if not isinstance(policy, Trained)} == {tuple(first)}
    assert scores["ppo"]["seeds"] == [1.0, 1.0]


@pytest.mark.parametrize(
    ("last", "shown"), [([True] * 4, [0]), ([False] * 4, [0]), ([False, False, True, False], [2, 0])]
)
def test_the_animation_shows_each_outcome_once(brick, body, tmp_path, play, last, shown):
    _, found = play(last)
    task.reach(ObjectJob("reach", brick, body, replace(TINY, goals=4), 0, tmp_path))
    goals = task.fresh_seeds(0, brick.key, "test", 4)
    assert found == [goals[i] for i in shown]


def run_with(brick, body, params, folder):
    known = KnownObject(brick, "digest", body)
    return Run(task=TASK, training=task.reach, part="brick", inputs=known, params=params, folder=folder)


def test_a_run_leaves_its_files_and_goes_on_where_it_was(brick, body, tmp_path):
    params = TaskParams(TINY, None, 0)
    whole, part = Benchmarks(tmp_path / "whole"), Benchmarks(tmp_path / "part")
    run_benchmark(run_with(brick, body, params, whole), print)
    files = {path.name for path in whole.dir.iterdir()} - {".progress"}
    assert files == {f"reach_brick.{suffix}" for suffix in ("json", "csv", "gif", "safetensors")}
    assert read_json(whole.result("reach", "brick"))["task"] == "reach"
    with Image.open(whole.film("reach", "brick")) as picture:
        assert picture.n_frames >= 2

    def stop(line):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(run_with(brick, body, params, part), stop)
    kept = list((part.dir / ".progress").glob("*/0.pt"))
    assert len(kept) == 1
    run_benchmark(run_with(brick, body, params, part), lambda line: pytest.fail("nothing is left to train"))
    for name in files:
        assert (part.dir / name).read_bytes() == (whole.dir / name).read_bytes()


def test_more_seeds_go_on_where_fewer_ended(brick, body, tmp_path):
    one, two = (TaskParams(replace(TINY, seeds=seeds), None, 0) for seeds in (1, 2))
    grown, whole = Benchmarks(tmp_path / "grown"), Benchmarks(tmp_path / "whole")
    said = [[], [], []]
    for params, folder, lines in zip((one, two, two), (grown, grown, whole), said):
        run_benchmark(run_with(brick, body, params, folder), lines.append)
    assert len(said[0]) + len(said[1]) == len(said[2])
    for path in (grown.result("reach", "brick"), grown.curve("reach", "brick")):
        assert path.read_bytes() == (whole.dir / path.name).read_bytes()
    other = TaskParams(replace(TINY, discount=0.8), None, 0)
    run_benchmark(run_with(brick, body, other, grown), print)
    assert len(list((grown.dir / ".progress").iterdir())) == 1  # what is of no more use is gone


def test_params_are_read_and_checked(tmp_path):
    values = {"seed": 3, "sensor": "digit", "reach": asdict(TINY)}
    assert TASK.params(values) == TaskParams(TINY, None, 3)
    values["reach"] |= {"discount": 1.5}
    refused("reach: discount", TASK.params, values)
    refused("lacks section 'reach'", TASK.params, {"seed": 0, "sensor": "digit"})


def test_a_table_has_a_row_for_each_policy_of_each_object():
    shares = {
        when: {"interval_95": [0.96378, 1.0], "rate": rate} for when, rate in (("last", 0.97), ("any", 1))
    }
    played = shares | {"return": 950.0, "distance": 0.0123, "seeds": [0.97]}
    run = {"episodes": 100, "horizon": 100, "task": "reach", "steps": [163840, 81920]}
    scores = dict.fromkeys(task.POLICIES, played) | run
    (shown,) = TASK.tables({"cup": scores, "die": scores})
    assert [row[0] for row in shown.rows] == ["cup"] * 4 + ["die"] * 4
    assert shown.rows[0] == ("cup", "PPO", "97 (96-100)", "100 (96-100)", "12", "9.50", "164k/82k", "100")
    assert shown.rows[3][1:] == ("none", "97 (96-100)", "100 (96-100)", "12", "9.50", "-", "-")
    assert all(len(row) == len(shown.columns) for row in shown.rows)


def test_the_command_runs_the_task_and_shows_the_table(brick_path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = {"seed": 0, "sensor": "digit", "objects": {}, "procedural": {}}
    values |= {"decompose": {"hulls": 4}, "reach": asdict(TINY)}
    YAML().dump(values, tmp_path / "params.yaml")
    words = ["bench", "reach", str(brick_path), "--out", "here", "--jobs", "1"]
    told = CliRunner().invoke(app, words, catch_exceptions=False)
    assert told.exit_code == 0
    assert "brick" in told.output
    folder = Benchmarks("here")
    assert read_json(folder.result("reach", "brick"))["episodes"] == TINY.goals
    assert read_json(folder.machine("reach", "brick"))["threads"] == 1
    assert (folder.hulls / "brick.npz").is_file()
