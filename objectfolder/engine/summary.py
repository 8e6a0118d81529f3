"""Events and final summary of a build."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


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
