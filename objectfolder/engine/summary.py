"""What a build reports: events while it runs, and a summary at the end."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class StageOutcome(StrEnum):
    """How a stage ended."""

    RAN = "ran"
    RESTORED = "restored"  # outputs came back from DVC's run cache
    SKIPPED = "skipped"  # nothing it depends on has changed
    FAILED = "failed"
    BLOCKED = "blocked"  # something upstream failed


class Addressed:
    """Statement about one stage."""

    address: str

    @property
    def stage(self) -> str:
        """Stage name without the object."""
        return self.address.partition("@")[0]

    @property
    def key(self) -> str:
        """Object key, empty for a stage that is not per object."""
        return self.address.partition("@")[2]


@dataclass(frozen=True)
class StageResult(Addressed):
    """How one stage ended.

    Parameters
    ----------
    address : str
        Stage address, such as ``modal@mug``.
    status : StageOutcome
        How it ended.
    seconds : float
        Wall time of the command, or of the restore.
    peak_mb : float, optional
        Peak resident memory of the largest process of the command; None if no command ran.
    log : Path, optional
        Output of the command; None if no command ran.
    error : str
        What went wrong, empty unless failed or blocked.
    tail : tuple of str
        Last lines of the log of a failed command.
    """

    address: str
    status: StageOutcome
    seconds: float = 0.0
    peak_mb: float | None = None
    log: Path | None = None
    error: str = ""
    tail: tuple[str, ...] = ()


@dataclass(frozen=True)
class Summary:
    """How a build ended.

    Parameters
    ----------
    stages : mapping of str to StageResult
        Result of every wanted stage, by address, in topological order.
    seconds : float
        Wall time of the whole build.
    """

    stages: Mapping[str, StageResult]
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether no stage failed (then none is blocked either)."""
        return not self.failures

    @property
    def failures(self) -> tuple[StageResult, ...]:
        """Results of the stages that failed."""
        return self.with_status(StageOutcome.FAILED)

    def with_status(self, status: StageOutcome) -> tuple[StageResult, ...]:
        """Results of the stages that ended in one way."""
        return tuple(result for result in self.stages.values() if result.status is status)

    def counts(self) -> dict[StageOutcome, int]:
        """Count the stages by how they ended."""
        return {status: len(self.with_status(status)) for status in StageOutcome}


@dataclass(frozen=True)
class Planned:
    """The graph is known: these stages will be looked at, in topological order, with their rough seconds."""

    seconds: Mapping[str, float]


@dataclass(frozen=True)
class Started:
    """A command was handed to a worker."""

    address: str
    log: Path


@dataclass(frozen=True)
class Lost:
    """A command ended with its worker or node; it will be started again."""

    address: str
    reason: str


@dataclass(frozen=True)
class Finished:
    """A stage has ended, in whatever way."""

    result: StageResult


Event = Planned | Started | Lost | Finished
Listener = Callable[[Event], None]
