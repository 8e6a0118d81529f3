"""The engine as a process of its own: killed, interrupted, or kept out by another DVC process."""

import os
import signal
import time

import psutil
import pytest
from refusals import refused

from objectfolder.engine.build import build

from .conftest import everything
from .processes import alive, start, started, wait_for

ENGINE = """
from objectfolder.engine.build import BuildOptions, build
build(options=BuildOptions(jobs=2), on_event=lambda event: print(type(event).__name__, flush=True))
"""


def start_and_hang(workspace):
    """Start a build that hangs in solve@mug after everything else is done; give engine and stage."""
    workspace.control("solve@mug", "60")
    engine = start(workspace, "-c", ENGINE)
    done = len(everything()) - 2
    wait_for(lambda: started(workspace, "solve@mug"))
    wait_for(lambda: sum(call[1] == "end" for call in workspace.calls()) == done)
    return engine, started(workspace, "solve@mug")


def resume(workspace):
    workspace.ran()
    workspace.control("solve@mug", None)
    summary = build(root=workspace.root)
    assert summary.ok
    ran = set(workspace.ran())
    assert {"pack@mug", "solve@mug"} <= ran
    assert len(ran) <= 3
    workspace.check_clean()


@pytest.mark.parametrize("stopped", [False, True])
def test_killed_engine_leaves_no_child_and_the_next_build_completes(workspace, stopped):
    engine, stage = start_and_hang(workspace)
    if stopped:  # the supervisor, which is the engine's child
        os.kill(
            next(p.pid for p in psutil.Process(stage).parents() if p.ppid() == engine.pid), signal.SIGSTOP
        )
    time.sleep(1)  # for the engine to save what has ended; the run cache keeps it even without dvc.lock
    engine.kill()
    engine.wait()
    wait_for(lambda: not alive(stage), seconds=5)
    resume(workspace)


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, -signal.SIGINT), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
)
def test_interrupted_engine_keeps_what_has_finished_and_others_out(workspace, number, code):
    engine, stage = start_and_hang(workspace)
    refused(rf"\(process {engine.pid}\) holds the lock", build, root=workspace.root)
    engine.send_signal(number)
    assert engine.wait(60) == code
    assert not alive(stage)
    told = (workspace.root / "process.log").read_text().split()
    assert told.count("Stopping") == (number == signal.SIGINT)
    assert "Finished" in told
    # The last stage to end may still have been on its way to the lock file.
    finished = set(everything()) - {"solve@mug", "pack@mug"}
    assert workspace.locked() <= finished
    assert len(workspace.locked()) >= len(finished) - 1
    resume(workspace)


def test_running_dvc_repro_keeps_the_engine_out(workspace):
    workspace.control("prepare@mug", "60")
    repro = start(workspace, "-m", "dvc", "repro", "prepare@mug")
    try:
        wait_for(lambda: started(workspace, "prepare@mug"))
        refused(f"process {repro.pid} .*is running a stage", build, root=workspace.root)
    finally:
        repro.kill()
        repro.wait()
        os.kill(started(workspace, "prepare@mug"), signal.SIGKILL)  # dvc leaves its child running
