"""Run commands one after another in a session of their own, and end them when the engine dies.

A script, started by `objectfolder.engine.process` with ``ENGINE_PID REPORT_FD COMMAND...``. It is an
intermediate process for two reasons. When the engine dies, the kernel signals only its direct children; the
supervisor kills the whole process group, including children of the shell. And the peak memory of a process
starts at that of its parent, so a fork of the engine would hide smaller peaks.

It consists of two processes: a dying Ray worker kills its direct children, and the second process then ends
the command. The first dies by SIGKILL, which ends it even while it is stopped (SIGSTOP).
"""

import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable

PR_SET_PDEATHSIG = 1


def start_shell(command: str) -> int:
    """Start a command in a shell; return its process id."""
    return os.posix_spawn(
        "/bin/sh", ["sh", "-c", command], os.environ, setsigdef=[signal.SIGPIPE, signal.SIGXFSZ]
    )


def main(parent: int, report: int, commands: list[str], start: Callable[[str], int] = start_shell) -> None:
    """Report the process group; run commands until one fails; report exit code, seconds and peak MB."""
    os.set_inheritable(report, False)
    signal.signal(signal.SIGTERM, lambda *_: os.killpg(0, signal.SIGKILL))
    die_with(parent, signal.SIGKILL)
    first = os.getpid()
    os.write(report, f"{first}\n".encode())
    if second := os.fork():
        os.waitpid(second, 0)
        return
    die_with(first)
    begin = time.monotonic()
    code, cpu, peak_kb = 0, 0.0, 0
    for command in commands:
        try:  # noqa: SIM105 (contextlib would cost every stage milliseconds)
            print(f"$ {command}", flush=True)
        except OSError:
            pass  # the disk of the log is full, but the command may not need it
        _, status, usage = os.wait4(start(command), 0)
        code, peak_kb = os.waitstatus_to_exitcode(status), max(peak_kb, usage.ru_maxrss)
        cpu += usage.ru_utime + usage.ru_stime
        if code:
            break
    result = {"code": code, "seconds": time.monotonic() - begin, "cpu_seconds": cpu}
    os.write(report, json.dumps({**result, "peak_mb": peak_kb / 1024}).encode())


def die_with(parent: int, number: int = signal.SIGTERM) -> None:
    """Request a signal for this process when its parent ends; Linux only."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:  # the parent died before the request
        sys.exit()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
