"""How far a build is, as another process sees it."""

import io
import json
import os
import re
import socket
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from objectfolder.base.io import write_json
from objectfolder.engine import journal
from objectfolder.engine.build import build
from objectfolder.engine.journal import JOURNAL, BuildState, Journal, read_journal
from objectfolder.engine.progress import print_build, print_death
from objectfolder.engine.summary import Disturbed, Finished, Planned, StageOutcome, StageResult, Started

from .processes import start, wait_for
from .test_interruption import ENGINE

CLI = "from objectfolder.cli import main; main()"
STATE = BuildState(
    host="node7",
    pid=4321,
    alive=True,
    elapsed=311.0,
    left=3700.0,
    total=5000,
    counts={"ran": 1200, "restored": 200, "failed": 1, "blocked": 2},
    running={"train_vision@" + "k" * 64: 72.4, "modal@mug": 3.0},
    failed={"modal@pan": "the command was killed by SIGKILL (perhaps out of memory: build with fewer jobs)"},
)


def printed(printer, state, terminal=False):
    console = Console(file=io.StringIO(), width=80, force_terminal=terminal, color_system=None)
    printer(state, console)
    return console.file.getvalue().splitlines()


def test_status_tells_of_a_running_build_and_of_one_that_died(workspace):
    workspace.control("solve@mug", "60")
    workspace.control("prepare@bell", "fail")
    engine = start(workspace, "-c", ENGINE)
    wait_for(lambda: (state := read_journal(workspace.root)) and state.done == 7)

    def status(*options):
        return workspace.server.run(("-c", CLI, "status", *options), workspace.root)

    told = status("--check")
    assert told.returncode == 1, told.stderr
    lines = [re.sub(r"\d:\d\d:\d\d", "TIME", line) for line in told.stdout.splitlines()]
    builder = f"(process {engine.pid} on {socket.gethostname()})"
    assert re.fullmatch(rf"a build runs {re.escape(builder)}: TIME elapsed(, about TIME left)?", lines[0])
    assert lines[1:] == [
        "  TIME  solve@mug",
        "  failed  prepare@bell: the command exited with code 3",
        "7 of 9 stages done (4 ran, 1 failed, 2 blocked), 1 running, 2 left",
    ]
    told = json.loads(status("--json").stdout)
    assert (told["alive"], told["pid"], [*told["running"]]) == (True, engine.pid, ["solve@mug"])
    assert status().returncode == 0

    engine.kill()
    engine.wait()
    state = read_journal(workspace.root)
    assert (state.alive, state.done, [*state.running]) == (False, 7, ["solve@mug"])
    for address in ("solve@mug", "prepare@bell"):
        workspace.control(address, None)
    assert build(root=workspace.root).ok
    assert read_journal(workspace.root) is None


def test_a_build_that_is_refused_or_fails_leaves_no_journal(workspace):
    workspace.control("prepare@mug", "fail")
    assert not build(["prepare@mug"], root=workspace.root).ok
    with pytest.raises(ValueError, match="unknown target"):
        build(["nothing"], root=workspace.root)
    assert not (workspace.root / JOURNAL).exists()


@pytest.fixture
def note(tmp_path):
    """The journal of a build in this process, that was written just now."""
    with Journal(tmp_path / JOURNAL) as kept:
        kept.add(Planned({"modal@mug": 1.0}))
        wait_for(lambda: (state := read_journal(tmp_path)) and state.total == 1, 5)
        return json.loads((tmp_path / JOURNAL).read_text())


@pytest.mark.parametrize(
    ("changes", "alive"),
    [
        ({}, True),
        ({"time": 0.0}, True),  # a stopped process
        ({"start": "1"}, False),  # another process has its number
        ({"pid": 2**22 + 1}, False),
        ({"place": "another machine"}, True),
        ({"place": "another machine", "time": time.time() - 90}, False),
        ({"place": ""}, True),  # no /proc
    ],
)
def test_a_dead_builder_is_known_by_its_start_and_elsewhere_by_its_silence(tmp_path, note, changes, alive):
    write_json(tmp_path / JOURNAL, note | changes)
    (tmp_path / "build").mkdir()
    for folder in (tmp_path, tmp_path / "build"):
        assert read_journal(folder).alive is alive


def test_times_go_on_after_the_last_write(tmp_path, note):
    write_json(
        tmp_path / JOURNAL, note | {"time": time.time() - 5, "elapsed": 10, "left": 7, "running": {"a": 2}}
    )
    state = read_journal(tmp_path)
    assert [state.elapsed, state.left, state.running["a"]] == pytest.approx([15, 2, 7], abs=1)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"time": 1}', '{"time": "now"}', "\0", json.dumps({"time": 1, "place": [1]})]
)
def test_a_damaged_journal_is_none(tmp_path, text):
    (tmp_path / JOURNAL).parent.mkdir(parents=True)
    (tmp_path / JOURNAL).write_text(text)
    assert read_journal(tmp_path) is None


def test_it_is_written_a_few_times_a_second_and_names_the_last_failures(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(journal, "write_text", lambda path, text: written.append(json.loads(text)))
    with Journal(Path("build.json")) as kept:
        kept.add(Planned(dict.fromkeys(map(str, range(100)), 1.0)))
        for number in range(100):
            address = str(number)
            kept.add(Started(address, Path("log")))
            if number == 99:
                kept.add(Disturbed(address, ["a.ply"]))
            else:
                kept.add(Finished(StageResult(address, StageOutcome.FAILED, error="no " * 1000)))
            time.sleep(0.012)
        wait_for(lambda: written[-1]["counts"] == {"failed": 99}, 5)
    assert len(written) <= 6
    assert written[-1]["running"] == {}
    assert [*written[-1]["failed"]] == [str(number) for number in range(79, 99)]
    assert len(json.dumps(written[-1])) < 10_000


def test_a_full_disk_does_not_stop_a_build(tmp_path, monkeypatch):
    def full(path, text):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(journal, "write_text", full)
    with Journal(tmp_path / "build.json") as kept:
        kept.add(Planned({"modal@mug": 1.0}))
    assert kept.total == 1


def test_it_fits_eighty_columns_and_is_whole_lines_elsewhere():
    lines = printed(print_build, STATE, terminal=True)
    assert max(map(len, lines)) <= 80
    assert lines[1].startswith("  0:01:12  train_vision@kkk")
    assert printed(print_build, STATE) == [
        "a build runs (process 4321 on node7): 0:05:11 elapsed, about 1:01:40 left",
        f"  0:01:12  train_vision@{'k' * 64}",
        "  0:00:03  modal@mug",
        f"  failed  modal@pan: {STATE.failed['modal@pan']}",
        "1403 of 5000 stages done (1200 ran, 200 restored, 1 failed, 2 blocked), 2 running, 3597 left",
    ]
    early = replace(STATE, total=0, counts={}, running={}, failed={}, left=None)
    assert printed(print_build, early)[1] == "reading the pipeline"


def test_a_death_is_told_in_a_line():
    died = "the last build (process 4321 on node7) died after 0:05:11 with modal@mug running; 1403 of 5000 "
    (line,) = printed(print_death, replace(STATE, alive=False, running={"modal@mug": 3.0}))
    assert line.startswith(died)
    assert line.endswith("1 running, 3597 left; `objectfolder build` continues")
