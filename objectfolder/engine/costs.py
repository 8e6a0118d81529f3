"""What the last run of each stage cost, kept next to its log; no output, so builds stay the same bytes."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from objectfolder.engine.failures import LOGS, log_path
from objectfolder.engine.process import CommandResult
from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_json

_SUFFIX = ".cost"


@dataclass(frozen=True)
class Cost:
    """Cost of the run that wrote the outputs of a stage.

    Parameters
    ----------
    seconds : float
        Wall time, s.
    cpu_seconds : float
        Processor time, s.
    peak_mb : float
        Peak resident memory, MB; see `objectfolder.engine.process.CommandResult`.
    """

    seconds: float
    cpu_seconds: float
    peak_mb: float


def record_cost(logs: Path, address: str, outcome: CommandResult) -> None:
    """Write the cost of a run; errors are ignored, because a full disk must not stop the build."""
    cost = Cost(*(round(value, 2) for value in (outcome.seconds, outcome.cpu_seconds, outcome.peak_mb)))
    with suppress(OSError, ObjectFolderError):
        write_json(_path(logs, address), asdict(cost))


def forget_cost(logs: Path, address: str) -> None:
    """Remove the record of a stage whose outputs another run wrote."""
    with suppress(OSError):
        _path(logs, address).unlink(missing_ok=True)


def recall_costs(root: Path, key: str) -> Mapping[str, Cost]:
    """Return the recorded costs of an object's stages, by stage, as far as they are known.

    Parameters
    ----------
    root : Path
        Workspace.
    key : str
        Of the object.
    """
    found = {}
    for path in sorted((root / LOGS).glob(f"*@{key}{_SUFFIX}")):
        with suppress(OSError, ValueError, TypeError):
            found[path.name.partition("@")[0]] = Cost(**json.loads(path.read_text()))
    return found


def _path(logs: Path, address: str) -> Path:
    return log_path(logs, address).with_suffix(_SUFFIX)
