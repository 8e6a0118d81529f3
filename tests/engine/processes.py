"""Other processes: start them in a workspace, wait for what they do, see whether they live."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil

PATH = f"{Path(sys.executable).parent}:{os.environ['PATH']}"


def start(workspace, *command):
    log = (workspace.root / "process.log").open("wb")
    environment = os.environ | {"PATH": PATH, "OMP_NUM_THREADS": "1"}
    with log:
        return subprocess.Popen(
            [sys.executable, *command], cwd=workspace.root, env=environment, stdout=log, stderr=log
        )


def wait_for(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def started(workspace, address):
    return next((int(call[3]) for call in workspace.calls() if call[:2] == [address, "start"]), None)


def alive(pid):
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
