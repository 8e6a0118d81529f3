"""Processes that end with the engine: commands of stages, with their children, and pools of workers."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.supervisor import die_with

SUPERVISOR = Path(__file__).with_name("supervisor.py")
TAIL_LINES = 15
#: Seconds for the processes of a stage to end, after a killed engine or worker.
END_TIMEOUT = 30.0
_POLL = 0.1
TAIL_BYTES = 16_384
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Command:
    """Shell commands of a stage, with their environment and log."""

    lines: Sequence[str]  #: shell commands, run one after another until one fails
    cwd: Path
    env: Mapping[str, str]
    log: Path  #: file for standard output and standard error
    timeout: float | None = None  #: wall seconds after which the command is killed; None: never


@dataclass(frozen=True)
class CommandResult:
    """Exit code, times and peak memory of a command."""

    code: int  #: exit code; the negative signal number if the shell was killed
    seconds: float  #: wall time, s
    #: Peak resident memory of the largest process, MB. Of a warm start, it contains the libraries that the
    #: process has in common with others.
    peak_mb: float
    timed_out: bool = False  #: whether the command was killed at its time limit
    cpu_seconds: float = 0.0  #: processor time of the command and the processes that it waited for, s


class NotStarted(RuntimeError):
    """No supervisor was started for a command."""


#: Starts the supervisor of a command, with open files for the output of the command and the reports of the
#: supervisor. Returns a function that forgets the supervisor, given its process group or 0 if it reported
#: none, and returns its exit code.
Start = Callable[[Command, int, int], Callable[[int], int]]


def start_process(command: Command, log: int, report: int) -> Callable[[int], int]:
    """Start the supervisor of a command as a new Python process."""
    supervisor = subprocess.Popen(
        [sys.executable, "-I", "-S", SUPERVISOR, str(os.getpid()), str(report), *command.lines],
        cwd=command.cwd,
        env=command.env,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        pass_fds=[report],
        start_new_session=True,
    )
    return lambda group: supervisor.wait()


class Children:
    """Running commands of this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._groups: set[int] = set()
        self._closed = False

    def run(self, command: Command, start: Start = start_process) -> CommandResult:
        """Run a command and wait for it.

        The calling thread must outlive the command: to the kernel, the thread that started a child is its
        parent.

        Raises NotStarted if no supervisor was started.
        """
        if self._closed:
            return CommandResult(-signal.SIGKILL, 0.0, 0.0)
        command.log.parent.mkdir(parents=True, exist_ok=True)
        read, write = os.pipe()
        with os.fdopen(read, "rb") as report:
            with os.fdopen(write, "wb"), open_log(command.log) as log:
                reap = start(command, log.fileno(), write)
            said = report.readline().decode().strip()
            if not said.isdigit():
                reap(0)
                raise NotStarted(said or f"no supervisor started; see {command.log}")
            group, begin, timed_out = int(said), time.monotonic(), threading.Event()
            with self._lock:
                self._groups.add(group)
                if self._closed:
                    _kill(group)

            def expire() -> None:
                timed_out.set()
                _kill(group)

            with _alarm(command.timeout, expire):
                text = report.read()  # ends with the supervisor, which holds the other end
            with self._lock:
                _kill(group)  # background processes of the command
                code = reap(group)  # not before: the kernel could use the number of the group again
                self._groups.discard(group)
        if not text and code != -signal.SIGKILL:
            raise RuntimeError(f"the supervisor process exited with code {code}; see {command.log}")
        if not text:
            return CommandResult(-signal.SIGKILL, time.monotonic() - begin, 0.0, timed_out.is_set())
        return CommandResult(**json.loads(text))

    def kill(self) -> None:
        """Kill all running commands with their child processes, and start no more."""
        with self._lock:
            self._closed = True
            for group in self._groups:
                _kill(group)


def open_log(log: Path) -> BinaryIO:
    """Open the log of a command, empty and locked: by that, `users` sees the command and its children."""
    if log.is_symlink():
        log.unlink()  # it is replaced, not followed
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
    stream = os.fdopen(os.open(log, flags, 0o666), "ab", buffering=0)
    with suppress(OSError):  # a file system without locks
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    stream.truncate(0)
    return stream


def users(log: Path) -> list[int] | None:
    """Return the processes that write a log, those of this machine; None if no command holds it."""
    try:
        with log.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return None
    except BlockingIOError:
        pass
    except OSError:  # no such log, or a file system without locks
        return None
    found = []
    for link in Path("/proc").glob("[0-9]*/fd/1"):
        with suppress(OSError):
            if link.samefile(log):
                found.append(int(link.parts[2]))
    return sorted(found)


def await_end(log: Path, check: Callable[[], None]) -> None:
    """Wait until no process of an earlier run of a stage writes its log, as it would write the same outputs.

    ``check``: called again and again meanwhile; may raise. Raises ObjectFolderError if one still does after
    `END_TIMEOUT` seconds.
    """
    deadline = time.monotonic() + END_TIMEOUT
    while (left := users(log)) is not None:
        if time.monotonic() > deadline:
            numbers = ", ".join(map(str, left))
            who = f"processes {numbers}" if left else "a process, perhaps of another node,"
            raise ObjectFolderError(
                f"{who} of an earlier run of it still write to {log}; end them (kill -9), and build again"
            )
        check()
        time.sleep(_POLL)


def stage_environment(base: Mapping[str, str], threads: int = 1) -> dict[str, str]:
    """Return the environment of a stage: this ``python`` first in PATH, and a limit on library threads.

    Stages already run in parallel; a thread per core in each numerical library would oversubscribe the cores.
    """
    path = os.pathsep.join(filter(None, (str(Path(sys.executable).parent), base.get("PATH"))))
    return {
        **base,
        "PATH": path,
        "OMP_NUM_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": str(threads),
        "MKL_NUM_THREADS": str(threads),
        "PYTHONUNBUFFERED": "1",  # keeps the log complete when a stage is killed
    }


def tail(log: Path) -> tuple[str, ...]:
    """Return the last lines of a log; empty without a log."""
    try:
        with log.open("rb") as stream:
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - TAIL_BYTES))
            text = stream.read().decode(errors="replace")
    except FileNotFoundError:
        return ()
    return tuple(text.splitlines()[-TAIL_LINES:])


def describe_result(outcome: CommandResult) -> str:
    """Describe the failure of a command; empty if it succeeded."""
    if outcome.timed_out:
        return f"killed after {outcome.seconds:.0f} s, its time limit (--timeout sets another)"
    return describe_exit(outcome.code) if outcome.code else ""


def describe_exit(code: int) -> str:
    """Describe a nonzero exit code."""
    # A shell reports a child's death by signal N as exit code 128 + N.
    number = -code if code < 0 else code - 128
    try:
        name = signal.Signals(number).name
    except ValueError:
        return f"the command exited with code {code}"
    hint = " (perhaps out of memory: build with fewer jobs)" if number == signal.SIGKILL else ""
    return f"the command was killed by {name}{hint}"


@contextmanager
def _alarm(seconds: float | None, action: Callable[[], None]) -> Iterator[None]:
    """Call an action if the block takes longer than ``seconds``."""
    if seconds is None:
        yield
        return
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _kill(group: int) -> None:
    with suppress(ProcessLookupError, PermissionError):  # only a zombie is left
        os.killpg(group, signal.SIGKILL)


def process_pool(jobs: int | None) -> ProcessPoolExecutor:
    """Return a pool of ``jobs`` spawned processes; default: one per core.

    Without `die_with`, workers of a killed parent would finish their task and then wait forever.
    """
    return ProcessPoolExecutor(jobs, get_context("spawn"), initializer=die_with, initargs=(os.getpid(),))


def in_processes(
    call: Callable[..., _Result], arguments: list[tuple[Any, ...]], jobs: int
) -> Iterator[_Result]:
    """Call a function with each tuple of arguments in parallel; yield results in the order they finish."""
    with process_pool(min(jobs, len(arguments))) as pool:
        waiting = [pool.submit(call, *given) for given in arguments]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
