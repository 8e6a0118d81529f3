"""Records of stages, kept next to their logs: the last failure, and what the last run cost.

A failure is valid until an input changes. No record is an output, so builds stay the same bytes.
"""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_json
from objectfolder.engine.process import CommandResult
from objectfolder.engine.summary import StageResult

LOGS = Path("build/.logs")
_FAILURE, _COST = ".failed", ".cost"


@dataclass(frozen=True)
class Failure:
    """Recorded failure of a stage: its message, one line, and its log, empty if no command ran."""

    error: str
    log: str


@dataclass(frozen=True)
class Cost:
    """Cost of the run that wrote the outputs of a stage; see `objectfolder.engine.process.CommandResult`."""

    seconds: float
    cpu_seconds: float
    peak_mb: float


def log_path(logs: Path, address: str) -> Path:
    """Return the path of the log of a stage."""
    return logs / f"{address.replace('/', '_')}.log"


def record_failure(logs: Path, result: StageResult, inputs: Mapping[str, Any]) -> None:
    """Write the record of a failure."""
    error = "; ".join(filter(None, (result.error.partition("\n")[0], *result.tail[-1:])))
    _write(logs, result.address, _FAILURE, {"error": error, "log": str(result.log or ""), "inputs": inputs})


def record_cost(logs: Path, address: str, outcome: CommandResult) -> None:
    """Write the cost of a run."""
    cost = Cost(*(round(value, 2) for value in (outcome.seconds, outcome.cpu_seconds, outcome.peak_mb)))
    _write(logs, address, _COST, asdict(cost))


def forget_failure(logs: Path, address: str) -> None:
    """Remove the failure of a stage that is up to date again."""
    with suppress(OSError):
        log_path(logs, address).with_suffix(_FAILURE).unlink(missing_ok=True)


def forget_cost(logs: Path, address: str) -> None:
    """Remove the cost of a stage whose outputs another run wrote."""
    with suppress(OSError):
        log_path(logs, address).with_suffix(_COST).unlink(missing_ok=True)


def recall_failure(logs: Path, address: str, inputs: Callable[[], Mapping[str, Any]]) -> Failure | None:
    """Return the recorded failure of a stage; None if there is none with its current inputs."""
    try:
        value = json.loads(log_path(logs, address).with_suffix(_FAILURE).read_text())
        failure = Failure(value["error"], value["log"])
        return failure if value["inputs"] == inputs() else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def recall_costs(root: Path, key: str) -> Mapping[str, Cost]:
    """Return the recorded costs of an object's stages in a workspace, by stage, as far as they are known."""
    found = {}
    for path in sorted((root / LOGS).glob(f"*@{key}{_COST}")):
        with suppress(OSError, ValueError, TypeError):
            found[path.name.partition("@")[0]] = Cost(**json.loads(path.read_text()))
    return found


def recall_errors(root: Path, key: str) -> Mapping[str, str]:
    """Return what the last failures of an object's stages in a workspace said, by stage, valid or not."""
    found = {}
    for path in sorted((root / LOGS).glob(f"*@{key}{_FAILURE}")):
        with suppress(OSError, ValueError, LookupError, TypeError):
            found[path.name.partition("@")[0]] = json.loads(path.read_text())["error"]
    return found


def _write(logs: Path, address: str, suffix: str, value: Mapping[str, Any]) -> None:
    with suppress(OSError, ObjectFolderError):  # a full disk must not stop the build
        write_json(log_path(logs, address).with_suffix(suffix), value)
