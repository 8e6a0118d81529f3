"""Warm starts: stages as forks of a process that has imported their libraries, which takes seconds.

The process imports nothing of the project for them: each fork imports that from disk, as a new Python would.
"""

import ast
import atexit
import gc
import importlib
import json
import logging
import os
import re
import runpy
import shutil
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from objectfolder.engine import supervisor
from objectfolder.engine.process import Command
from objectfolder.workspace.code_digests import PACKAGES
from objectfolder.workspace.installed import located

#: Commands that can start warm: nothing in them is for a shell.
STAGE = re.compile(r"python -m (stages\.\w+)(?: [\w./-]+)*")
#: Starts with the options, variables and paths that ``python -m stages.NAME`` has.
BOOT = """
import sys
sys.path.insert(0, sys.argv[1])
from objectfolder.engine.warm import serve
del sys.path[0]
serve(*map(int, sys.argv[2:]))
"""
PROJECT = Path(__file__).parents[2]
MAX_REQUEST = 2**20
_log = logging.getLogger(__name__)


def is_stage(command: Command) -> bool:
    """Return whether a command can start warm."""
    return len(command.lines) == 1 and STAGE.fullmatch(command.lines[0]) is not None


class Starter:
    """Client of the process that starts stages warm; it ends with the thread that makes this object.

    ``env``: environment of a stage.
    """

    def __init__(self, env: Mapping[str, str]):
        self.usable = True
        self._known: set[str] = set()
        self._parsing = threading.Lock()
        self._control, control = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        python = shutil.which("python", path=env.get("PATH")) or sys.executable  # as a shell finds it
        with control:
            self._process = subprocess.Popen(
                [python, "-c", BOOT, PROJECT, str(os.getpid()), str(control.fileno())],
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[control.fileno()],
                start_new_session=True,
            )

    @property
    def alive(self) -> bool:
        """Whether the process runs; its forks end with it."""
        return self._process.poll() is None

    def start(self, command: Command, log: int, report: int) -> Callable[[int], int]:
        """Start the supervisor of a command that `STAGE` matches; see `objectfolder.engine.process.Start`.

        Instead of its process group, the first report may be a reason why nothing was started.
        """
        (line,) = command.lines
        module = line.split()[2]
        libraries: list[str] = []
        if module not in self._known:
            # One thread at a time: Python 3.11 counts the depth of its parser for all threads together.
            with self._parsing, suppress(OSError, SyntaxError, ValueError):  # the stage itself will say so
                libraries = _libraries(f"{module.replace('.', '/')}.py", command.cwd)
            self._known.add(module)
        cwd = str(command.cwd)
        request = {"line": line, "cwd": cwd, "env": {**command.env, "PWD": cwd}, "libraries": libraries}
        with suppress(OSError):  # it has died, so nobody holds the file for reports
            socket.send_fds(self._control, [json.dumps(request).encode()], [log, report])
        return self._reap

    def give_up(self, reason: object) -> None:
        """Start nothing more, and say once why."""
        if self.usable:
            self.usable = False
            _log.warning("stages import their libraries themselves from now on: %s", reason)

    def kill(self) -> None:
        """Kill the process; its forks end too."""
        self.usable = False
        self._process.kill()

    def close(self) -> None:
        """End the process, after its forks."""
        self._control.close()
        self._process.wait()

    def _reap(self, group: int) -> int:
        """Let the process forget a supervisor; whatever ended it, one without a result was killed."""
        if group:
            with suppress(OSError):
                self._control.send(str(group).encode())
        return -signal.SIGKILL


def _libraries(script: str, root: Path) -> list[str]:
    """List what a script imports at once, itself or through files of the workspace, from elsewhere."""
    local = {*PACKAGES, *(path.stem for path in root.iterdir() if path.is_dir() or path.suffix == ".py")}
    names: dict[str, None] = {}
    todo = [root / script]
    for file in todo:
        for name in filter(lambda name: name not in names, _imports(file)):
            names[name] = None
            if name.partition(".")[0] in local:
                place = name.replace(".", "/")
                files = (located(f"{place}{end}", root) for end in (".py", "/__init__.py"))
                todo += filter(Path.is_file, files)
    return [name for name in names if name.partition(".")[0] not in local]


def _imports(file: Path) -> Iterator[str]:
    """Yield what a file imports in no function: modules, and perhaps names in them."""
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def forget_project() -> None:
    """Let forks of this process import the modules of the project anew."""
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        del sys.modules[name]


def serve(engine: int, control_fd: int) -> None:
    """Start a supervisor for each request, until the engine ends."""
    supervisor.die_with(engine, signal.SIGKILL)
    forget_project()
    if "" in sys.path:
        sys.path.remove("")  # the workspace, where code may be edited
    starter = os.getpid()
    with socket.socket(fileno=control_fd) as control:
        while True:
            message, files, _, _ = socket.recv_fds(control, MAX_REQUEST, 2)
            if not message:
                return
            if not files:
                os.waitpid(int(message), 0)
                continue
            request = json.loads(message)
            log, report = files
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.close(log)
            _import(request.pop("libraries"))
            if len(os.listdir("/proc/self/task")) > 1:  # noqa: PTH208
                os.write(report, b"a library started a thread, which a fork would lack\n")
            elif os.fork() == 0:
                control.close()
                _supervise(starter, report, **request)
            os.close(report)
            with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
                os.dup2(nowhere.fileno(), 1)  # an open log would mean that its command runs
                os.dup2(nowhere.fileno(), 2)


def _import(libraries: Sequence[str]) -> None:
    for name in libraries:
        with suppress(Exception):  # no module, but something in one; or an error that the stage will meet
            importlib.import_module(name)
    if libraries:
        gc.collect()
        gc.freeze()  # a collection in a fork would copy the pages of all these objects


def _supervise(starter: int, report: int, line: str, cwd: str, env: Mapping[str, str]) -> NoReturn:
    def start(line: str) -> int:
        if pid := os.fork():
            return pid
        os.close(report)
        run_to_exit(partial(_run, line.split(), cwd, env))

    try:
        os.setsid()
        supervisor.main(starter, report, [line], start)
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(0)


def _run(command: Sequence[str], cwd: str, env: Mapping[str, str]) -> None:
    """Become ``python -m MODULE ARGUMENT...``."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(env)
    if not getattr(sys.flags, "safe_path", False):  # Python 3.10 has none
        sys.path.insert(0, cwd)
    sys.argv = ["-m", *command[3:]]
    sys.orig_argv = [*command]
    sys.modules["__main__"] = ModuleType("__main__")
    importlib.invalidate_caches()
    runpy._run_module_as_main(command[2])  # type: ignore[attr-defined]


def run_to_exit(call: Callable[[], None]) -> NoReturn:
    """Run a main program and exit as Python does, but without tearing libraries down, which takes long."""
    code = 0
    try:
        call()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if not isinstance(end.code, int | None):
            print(end.code, file=sys.stderr)
    except BaseException as error:
        trace = error.__traceback__
        while trace and trace.tb_frame.f_globals is globals():
            trace = trace.tb_next
        sys.excepthook(type(error), error.with_traceback(trace), trace)
        code = -signal.SIGINT if isinstance(error, KeyboardInterrupt) else 1
    finally:
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        if code == -signal.SIGINT:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGINT)
        os._exit(code & 0xFF)
