"""Other processes: start them in a workspace, wait for what they do, see whether they live."""

import os
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import psutil

PATH = f"{Path(sys.executable).parent}:{os.environ['PATH']}"


def start(workspace, *command):
    """Start Python in a workspace, as with its environment activated: DVC's commands call ``python``."""
    with (workspace.root / "process.log").open("wb") as log:
        return workspace.server.start(command, workspace.root, log, log, PATH=PATH)


def wait_for(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def started(workspace, address):
    return next((int(call[3]) for call in workspace.calls() if call[:2] == [address, "start"]), None)


def alive(pid):
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


@contextmanager
def meanwhile(action):
    """Do something in another thread; what it raises is raised at the end."""
    problems = []

    def work():
        try:
            action()
        except BaseException as problem:
            problems.append(problem)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        thread.join(60)
    assert not problems


#: Code for a process that is to die before the n-th change of a file below a folder.
DIE_AT_A_CHANGE = """
def die_at_a_change(left, number, root):
    import os, sys

    def count(event, arguments):
        nonlocal left
        writes = event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if writes or event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.chmod", "os.link"):
            if isinstance(arguments[0], str) and os.path.abspath(arguments[0]).startswith(root):
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), number)

    sys.addaudithook(count)
"""
