"""Records of failed stages, kept next to their logs and valid until an input changes."""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from objectfolder.engine.summary import StageResult
from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_json

LOGS = Path("build/.logs")


@dataclass(frozen=True)
class Failure:
    """Recorded failure of a stage.

    Parameters
    ----------
    error : str
        Error message, one line.
    log : str
        Log of the command; empty if none ran.
    """

    error: str
    log: str


def log_path(logs: Path, address: str) -> Path:
    """Return the path of the log of a stage."""
    return logs / f"{address.replace('/', '_')}.log"


def record_failure(logs: Path, result: StageResult, inputs: Mapping[str, Any]) -> None:
    """Write the record of a failure; errors are ignored, because a full disk must not stop the build."""
    error = "; ".join(filter(None, (result.error.partition("\n")[0], *result.tail[-1:])))
    value = {"error": error, "log": str(result.log or ""), "inputs": inputs}
    with suppress(OSError, ObjectFolderError):
        write_json(_path(logs, result.address), value)


def forget_failure(logs: Path, address: str) -> None:
    """Remove the record of a stage that is up to date again."""
    with suppress(OSError):
        _path(logs, address).unlink(missing_ok=True)


def recall_failure(logs: Path, address: str, inputs: Callable[[], Mapping[str, Any]]) -> Failure | None:
    """Return the recorded failure of a stage; None if there is none with its current inputs."""
    try:
        value = json.loads(_path(logs, address).read_text())
        failure = Failure(value["error"], value["log"])
        return failure if value["inputs"] == inputs() else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _path(logs: Path, address: str) -> Path:
    return log_path(logs, address).with_suffix(".failed")
