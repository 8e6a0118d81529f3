"""Events of a build, what they add up to, and its final summary."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

NO_OBJECTS = "there are no objects yet; run `objectfolder add MESH --name NAME --material MATERIAL`"


class StageOutcome(StrEnum):
    """Outcome of a stage."""

    RAN = "ran"
    RESTORED = "restored"  # outputs taken from DVC's run cache
    SKIPPED = "skipped"  # up to date
    FAILED = "failed"
    BLOCKED = "blocked"  # an upstream stage failed


class Addressed:
    """Base class of records about one stage."""

    address: str

    @property
    def stage(self) -> str:
        """Stage name without the object."""
        return self.address.partition("@")[0]

    @property
    def key(self) -> str:
        """Object key; empty for a stage that is not per object."""
        return self.address.partition("@")[2]


@dataclass(frozen=True)
class StageResult(Addressed):
    """Outcome of one stage, with its time, memory and log."""

    address: str  #: stage address, such as ``modal@mug``
    status: StageOutcome
    seconds: float = 0.0  #: wall time of the command or of the restore, s
    #: Peak resident memory of the largest process of the command, MB; None if no command ran.
    peak_mb: float | None = None
    log: Path | None = None  #: log file of the command; None if no command ran
    error: str = ""  #: error message; empty unless failed or blocked
    tail: tuple[str, ...] = ()  #: last lines of the log of a failed command


@dataclass(frozen=True)
class Summary:
    """Results of a build."""

    stages: Mapping[str, StageResult]  #: result of every requested stage, by address, in topological order
    seconds: float  #: wall time of the whole build, s

    @property
    def ok(self) -> bool:
        """Whether no stage failed, and hence none is blocked."""
        return not self.failures

    @property
    def failures(self) -> tuple[StageResult, ...]:
        """Results of the stages that failed."""
        return self.with_status(StageOutcome.FAILED)

    def with_status(self, status: StageOutcome) -> tuple[StageResult, ...]:
        """Return the results with one outcome."""
        return tuple(result for result in self.stages.values() if result.status is status)

    def counts(self) -> dict[StageOutcome, int]:
        """Count the stages by outcome."""
        return {status: len(self.with_status(status)) for status in StageOutcome}


@dataclass(frozen=True)
class Planned:
    """Start of a build: rough seconds of all requested stages, in topological order."""

    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Started:
    """Start of a command on a worker."""

    address: str
    log: Path


@dataclass(frozen=True)
class Lost:
    """Loss of a command with its worker or node; the engine starts it again."""

    address: str
    reason: str


@dataclass(frozen=True)
class Disturbed:
    """Change of input files while a command read them; its outputs are not saved, and it starts again."""

    address: str
    files: Sequence[str]


@dataclass(frozen=True)
class Finished:
    """End of a stage, with any outcome."""

    result: StageResult


@dataclass(frozen=True)
class Stopping:
    """Interruption from the keyboard: no more stages start, and the running ones are killed."""


Event = Planned | Started | Lost | Disturbed | Finished | Stopping
Listener = Callable[[Event], None]
MIN_SHARE = 0.1  # of the planned work, after which the rest is estimated


class Tally:
    """What a build has done so far, by its events."""

    def __init__(self) -> None:
        self.total = 0
        self.counts = dict.fromkeys(StageOutcome, 0)
        self.running: dict[str, float] = {}  #: when each running stage started, by `time.monotonic`
        self._start = time.monotonic()
        # Rough seconds of the remaining stages, and of those that have run.
        self._ahead: dict[str, float] = {}
        self._behind = 0.0

    def add(self, event: Event) -> None:
        """Count one event."""
        match event:
            case Planned(seconds):
                self._start = time.monotonic()
                self._ahead = dict(seconds)
                self.total = len(seconds)
            case Started(address):
                self.running[address] = time.monotonic()
            case Lost(address) | Disturbed(address):
                self.running.pop(address, None)
            case Finished(result):
                self.running.pop(result.address, None)
                self.counts[result.status] += 1
                expected = self._ahead.pop(result.address, 0.0)
                if result.status is StageOutcome.RAN:
                    self._behind += expected

    @property
    def done(self) -> int:
        """Number of stages that have ended."""
        return sum(self.counts.values())

    @property
    def elapsed(self) -> float:
        """Seconds since the stages are known, or before that, since the tally was made."""
        return time.monotonic() - self._start

    def seconds_left(self) -> float | None:
        """Return the remaining time in s at the speed so far; None before a tenth of the work is done."""
        ahead = sum(self._ahead.copy().values())  # in one step: other threads ask
        if not self._behind or self._behind < MIN_SHARE * (self._behind + ahead):
            return None
        return self.elapsed * ahead / self._behind
