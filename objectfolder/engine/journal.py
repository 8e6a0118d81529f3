"""How far a build is, in a file that ``objectfolder status`` reads without DVC's lock, from any terminal."""

import json
import os
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import write_text
from objectfolder.engine.summary import Event, Finished, StageOutcome, Tally

JOURNAL = Path(".dvc/tmp/objectfolder/build.json")
PERIOD = 0.5  # seconds between two writes
BEAT = 10.0  # seconds after which it is written although nothing has happened
SILENCE = 60.0  # seconds without a write after which a build on another machine is taken for dead
MOST_FAILURES = 20  # that it names, the last ones


@dataclass(frozen=True)
class BuildState:
    """How far a build is, or was when it died."""

    host: str
    pid: int  #: process of the engine
    alive: bool
    elapsed: float  #: s
    left: float | None  #: rough s; None if it is too early to tell
    total: int  #: stages; 0: the pipeline is being read
    counts: Mapping[str, int]  #: stages that have ended, by outcome
    running: Mapping[str, float]  #: seconds since each running stage started, by address
    failed: Mapping[str, str]  #: errors of the last stages that failed, by address

    @property
    def done(self) -> int:
        """Number of stages that have ended."""
        return sum(self.counts.values())


class Journal(Tally):
    """Keeps the journal of a build, from a thread of its own, until the block ends.

    ``path``: where; the file goes with the block, so that only a build that died leaves one.
    """

    def __init__(self, path: Path):
        super().__init__()
        self._path = path
        self._failed: dict[str, str] = {}
        self._news, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._news.set()
        self._thread.join()
        self._path.unlink(missing_ok=True)

    def add(self, event: Event) -> None:
        """Count one event, and write it down soon."""
        super().add(event)
        if isinstance(event, Finished) and event.result.status is StageOutcome.FAILED:
            failed = {**self._failed, event.result.address: shortened(event.result.error, 300)}
            self._failed = dict([*failed.items()][-MOST_FAILURES:])
        self._news.set()

    def _write(self) -> None:
        pid = os.getpid()
        builder = {"place": _place(), "start": _start_of(pid)}
        while not self._ended.is_set():
            self._news.clear()
            with suppress(OSError, ObjectFolderError):  # a full disk must not stop the build
                note = {**builder, "time": time.time(), **asdict(self._state(pid))}
                write_text(self._path, json.dumps(note))
            self._ended.wait(PERIOD)
            self._news.wait(BEAT)

    def _state(self, pid: int) -> BuildState:
        now = time.monotonic()
        return BuildState(
            host=socket.gethostname(),
            pid=pid,
            alive=True,
            elapsed=self.elapsed,
            left=self.seconds_left(),
            total=self.total,
            counts={status: count for status, count in self.counts.items() if count},
            running={address: now - start for address, start in self.running.copy().items()},
            failed=self._failed,
        )


def read_journal(root: str | Path = ".") -> BuildState | None:
    """Return how far the build of a workspace is; None if none runs, and the last one did not die."""
    root = Path(root).resolve()
    home = next((folder for folder in (root, *root.parents) if (folder / ".dvc").is_dir()), root)
    # Whatever a journal lacks or says wrongly, it is none.
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):
        note = json.loads((home / JOURNAL).read_bytes())
        silence = max(0.0, time.time() - float(note["time"]))
        alive = silence < SILENCE
        if note["place"] and note["place"] == _place():
            alive = bool(note["start"]) and note["start"] == _start_of(int(note["pid"]))
        since = silence if alive else 0.0
        return BuildState(
            host=str(note["host"]),
            pid=int(note["pid"]),
            alive=alive,
            elapsed=float(note["elapsed"]) + since,
            left=None if note["left"] is None else max(0.0, float(note["left"]) - since),
            total=int(note["total"]),
            counts={str(status): int(count) for status, count in note["counts"].items()},
            running={str(address): float(age) + since for address, age in note["running"].items()},
            failed={str(address): str(error) for address, error in note["failed"].items()},
        )
    return None


def _place() -> str:
    """Return where the numbers of processes mean the same: a machine since it started, and a container."""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {Path('/proc/self/ns/pid').readlink()}"
    return ""


def _start_of(pid: int) -> str:
    """Return when a process of this place started, as the kernel counts; empty if it has ended."""
    with suppress(OSError):
        state, *fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return "" if state in "ZX" else fields[18]
    return ""
