"""What a run on a split depends on, and how many threads it takes."""

import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from encoding import encoding
from refusals import refused
from threadpoolctl import threadpool_info

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.base.locks import exclusive, remove_unused
from objectfolder.benchmarks import run
from objectfolder.benchmarks.datasets import splits
from objectfolder.benchmarks.models import encoders
from objectfolder.benchmarks.tasks import localize, retrieve, running
from objectfolder.benchmarks.tasks.retrieve import RetrieveConfig
from objectfolder.benchmarks.tasks.running import KnownObject, Run
from objectfolder.benchmarks.tasks.task import TaskParams
from objectfolder.workspace.layout import Benchmarks

PARAMS = TaskParams(RetrieveConfig(seeds=1, epochs=1, embedding=4), encoding(), 0)


def run_of(inputs, part="seen", params=PARAMS, task=retrieve.TASK, **more):
    known = {"task": task, "part": part, "inputs": inputs, "params": params}
    return Run(training=print, folder=Benchmarks("out"), **known, **more)


def small_run(folder, training, identity="same", job=0.5):
    """A run of a task that only reports and returns."""
    known = KnownObject(None, "")
    task = SimpleNamespace(name="small", columns=("a",))
    return SimpleNamespace(
        **{"task": task, "training": training, "part": "seen", "folder": folder, "inputs": known},
        **{"identity": lambda: identity, "job": lambda progress, report: report if job is None else job},
    )


@pytest.fixture
def samples(monkeypatch):
    monkeypatch.setattr(running, "code_digest", lambda function: "code")  # takes seconds
    return SimpleNamespace(digest="x", keys=("espresso_mug", "tea_beaker", "own"), count=10)


def test_an_object_that_changes_its_part_changes_the_run(samples, monkeypatch):
    spec = run_of(samples, "unseen")
    listed, parts = splits._listed(), []
    for part in ("train", "test", "train"):
        monkeypatch.setattr(splits, "_listed", lambda part=part: listed | {"own": part})
        parts.append(spec.identity())
    assert parts[0] == parts[2] != parts[1]


def test_a_finished_run_keeps_the_progress_of_one_that_still_runs(tmp_path):
    folder = Benchmarks(tmp_path)

    def run_task(job):
        remove_unused(folder.progress("small", "seen", "new"))  # as another run that finishes meanwhile
        assert folder.progress("small", "seen", "new").is_dir()
        return {"seconds": 1.0, "score": job}, []

    running_now, left = (folder.progress("small", "seen", name) for name in ("running", "left"))
    left.mkdir(parents=True)
    with exclusive(running_now):
        assert running.run_benchmark(small_run(folder, run_task, "new"), print).seconds == 1.0
    assert read_json(folder.result("small", "seen")) == {"score": 0.5}
    assert running_now.is_dir()
    assert not left.exists()
    remove_unused(running_now)
    assert not running_now.exists()
    remove_unused(running_now)  # gone already


def test_processor_time_includes_that_of_an_interrupted_call(tmp_path, monkeypatch):
    clock, lines = SimpleNamespace(now=100.0, stop=True), []
    monkeypatch.setattr(running.time, "process_time", lambda: clock.now)

    def run_task(report):
        clock.now += 3
        report("epoch 1")
        clock.now += 50  # of an epoch that is lost if the process stops
        if clock.stop:
            raise KeyboardInterrupt
        return {"seconds": 60.0}, []

    spec = small_run(Benchmarks(tmp_path), run_task, job=None)
    with pytest.raises(KeyboardInterrupt):
        running.run_benchmark(spec, lines.append)
    clock.now, clock.stop = 7.0, False  # of another process
    assert running.run_benchmark(spec, lines.append) == running.RunTime(60.0, 3 + 53)
    assert lines == ["epoch 1"] * 2


def test_a_second_run_waits_and_says_so(tmp_path):
    """Even if the folder that it waits for is removed by the process that held it."""
    folder, said, entered = tmp_path / "progress", [], threading.Event()

    def second():
        with exclusive(folder, lambda: said.append("waiting")):
            entered.set()
            assert folder.is_dir()
            remove_unused(folder)
            assert folder.is_dir()

    with ThreadPoolExecutor(1) as pool:
        with exclusive(folder):
            done = pool.submit(second)
            while not said:
                time.sleep(0.01)
            assert not entered.is_set()
            shutil.rmtree(folder)
        done.result(timeout=20)
    assert said == ["waiting"]
    with exclusive(folder, lambda: said.append("again")):
        assert said == ["waiting"]


def fail_if_odd(number, folder):
    if number % 2:
        return f"object {number}: odd"
    (folder / str(number)).touch()
    return None


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_object_that_fails_does_not_stop_the_others(tmp_path, jobs):
    with pytest.raises(ObjectFolderError, match=r"^object 1: odd\nobject 3: odd\nThe other 2 ran"):
        run._call_all(fail_if_odd, [(number, tmp_path) for number in (1, 2, 3, 4)], jobs)
    assert {path.name for path in tmp_path.iterdir()} == {"2", "4"}
    refused(r"^object 5: odd$", run._call_all, fail_if_odd, [(5, tmp_path)], jobs)


@pytest.fixture
def run_part(monkeypatch, tmp_path):
    """Runs a part of a task in a folder, with something instead of the benchmark."""

    def call(task, threads, inputs, benchmark):
        monkeypatch.setattr(run, "run_benchmark", benchmark)
        monkeypatch.setitem(run.SAMPLES, "observations", lambda folders: None)
        shared = {"task": task, "params": PARAMS, "folder": Benchmarks(tmp_path), "device": "cpu"}
        assert run._run_part("part", inputs, None, print, {**shared, "threads": threads}) is None

    return call


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_are_those_of_every_pool(run_part, brick_path, threads):
    before, found = torch.get_num_threads(), []

    def look(*given):
        found.append({pool["num_threads"] for pool in threadpool_info()} | {torch.get_num_threads()})
        return running.RunTime(1.0, 1.0)

    run_part(retrieve.TASK, threads, {}, look)
    run_part(localize.TASK, threads, (brick_path, 0), look)
    assert found == [{threads}] * 2
    assert torch.get_num_threads() == before


def test_a_device_that_torch_cannot_use_is_named():
    assert running.training_device("cpu") == "cpu"
    assert running.training_device() == ("cuda" if torch.cuda.is_available() else "cpu")
    refused(r"--device gpu: .*; expected cpu, or cuda with a GPU", running.training_device, "gpu")


def test_a_run_on_another_device_is_another_run(samples, monkeypatch):
    monkeypatch.setattr(running, "training_device", lambda device: device)
    cpu, gpu, same = (run_of(samples, device=name).identity() for name in ("cpu", "cuda", "cuda:0"))
    assert cpu != gpu == same


def test_a_run_with_another_module_of_its_own_encoder_is_another_run(samples, monkeypatch, tmp_path):
    monkeypatch.setattr(encoders, "_FACTORIES", dict(encoders._FACTORIES))
    (tmp_path / "mine.py").write_text(
        "import beside_an_encoder\n"
        "from objectfolder.benchmarks.models.encoders import register_encoder\n"
        'register_encoder("own")(None)\n'
    )
    params = replace(PARAMS, encode=encoding(f"{tmp_path / 'mine.py'}:own"))
    runs = [run_of(samples, params=params), run_of(KnownObject(None, "object"), params=params)]
    found = []
    for width in ("WIDTH = 4", "WIDTH = 16", "WIDTH = 4"):
        (tmp_path / "beside_an_encoder.py").write_text(width)
        found.append([spec.identity() for spec in runs])
    assert found[0] == found[2]
    assert all(one != other for one, other in zip(*found[:2]))


def test_the_cost_of_a_finished_run_stays_as_it_was(tmp_path, run_part):
    path, found = Benchmarks(tmp_path).machine("retrieve", "part"), []
    for threads, seconds, cpu_seconds in ((8, 100.0, 90.0), (1, 100.0, 91.0), (2, 200.0, 185.0)):
        run_part(retrieve.TASK, threads, {}, lambda *given: running.RunTime(seconds, cpu_seconds))  # noqa: B023
        found.append((read_json(path)["threads"], read_json(path)["cpu_seconds"]))
    assert found == [(8, 90.0), (8, 90.0), (2, 185.0)]


def test_a_result_without_a_film_does_not_keep_an_older_one(tmp_path):
    task, folder, progress = SimpleNamespace(name="small", columns=()), Benchmarks(tmp_path), tmp_path / "new"
    progress.mkdir()
    (progress / "episodes.gif").touch()
    for film in (True, False):
        running.write_results(task, "seen", folder, progress, {"score": 1}, [])
        assert folder.film("small", "seen").is_file() == film
