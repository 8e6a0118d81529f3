"""Run commands one after another as the head of their own session, and die with the engine.

A script, started by `objectfolder.engine.process` with ``ENGINE_PID REPORT_FD COMMAND...``. It stands between
the engine and the command for two reasons. When the engine dies, the kernel tells only its direct children;
this one passes it on to the whole process group, a shell's children included. And a process's peak memory
starts at that of the process it was forked from, so forking from the engine would hide anything smaller.

It is two processes: a worker of Ray kills its direct children when it ends, and then it is the second one
that is left to end the command.
"""

import ctypes
import json
import os
import signal
import sys
import time

PR_SET_PDEATHSIG = 1


def main(engine: int, report: int, commands: list[str]) -> None:
    """Run the commands until one fails, then write exit code, wall seconds and peak MB as JSON."""
    os.set_inheritable(report, False)
    signal.signal(signal.SIGTERM, lambda *_: os.killpg(0, signal.SIGKILL))
    die_with(engine)
    first = os.getpid()
    if second := os.fork():
        os.waitpid(second, 0)
        return
    die_with(first)
    start = time.monotonic()
    code, peak_kb = 0, 0
    for command in commands:
        try:  # noqa: SIM105 (contextlib would cost every stage milliseconds)
            print(f"$ {command}", flush=True)
        except OSError:
            pass  # the disk of the log is full: the command itself may need none
        pid = os.posix_spawn(
            "/bin/sh", ["sh", "-c", command], os.environ, setsigdef=[signal.SIGPIPE, signal.SIGXFSZ]
        )
        _, status, usage = os.wait4(pid, 0)
        code, peak_kb = os.waitstatus_to_exitcode(status), max(peak_kb, usage.ru_maxrss)
        if code:
            break
    result = {"code": code, "seconds": time.monotonic() - start, "peak_mb": peak_kb / 1024}
    os.write(report, json.dumps(result).encode())


def die_with(parent: int) -> None:
    """Get SIGTERM when the parent ends; the supervisor ends its whole group then. Only Linux can do it."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it died before the kernel was asked to watch it
        sys.exit()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
