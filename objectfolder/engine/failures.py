"""Which stages failed at the last build, and why: a record beside the log, void once the inputs change."""

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.dependency import ParamsDependency
from dvc.exceptions import DvcException
from dvc.stage import Stage

from objectfolder.engine.summary import StageResult
from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_json

LOGS = Path("build/.logs")


@dataclass(frozen=True)
class Failure:
    """How a stage failed.

    Parameters
    ----------
    error : str
        What went wrong, one line.
    log : str
        Log of the command; empty if none ran.
    """

    error: str
    log: str


def log_path(logs: Path, address: str) -> Path:
    """File for what the command of a stage prints."""
    return logs / f"{address.replace('/', '_')}.log"


def record(logs: Path, stage: Stage, result: StageResult) -> None:
    """Leave a record of a failure; a disk that does not take it must not stop the build."""
    error = "; ".join(filter(None, (result.error.partition("\n")[0], *result.tail[-1:])))
    value = {"error": error, "log": str(result.log or ""), "inputs": _inputs(stage)}
    with suppress(OSError, ObjectFolderError):
        write_json(_path(logs, result.address), value)


def forget(logs: Path, address: str) -> None:
    """Remove the record of a stage that is up to date again."""
    with suppress(OSError):
        _path(logs, address).unlink(missing_ok=True)


def recall(logs: Path, address: str, stage: Stage) -> Failure | None:
    """How a stage failed with the inputs that it has now; None if it did not."""
    try:
        value = json.loads(_path(logs, address).read_text())
        failure = Failure(value["error"], value["log"])
        return failure if value["inputs"] == _inputs(stage) else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _path(logs: Path, address: str) -> Path:
    return log_path(logs, address).with_suffix(".failed")


def _inputs(stage: Stage) -> dict[str, Any]:
    """Command, parameters and hashes of the dependencies, as they are on disk, in a form that JSON keeps."""
    values: dict[str, Any] = {"cmd": stage.cmd}
    for dep in stage.deps:
        try:
            values[str(dep)] = dep.get_hash().value
        except (DvcException, OSError):
            values[str(dep)] = None
        if isinstance(dep, ParamsDependency):
            values[str(dep)] = json.dumps(values[str(dep)], sort_keys=True, default=str)
    return values
