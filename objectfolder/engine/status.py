"""State of every stage, the reasons for it, and the action of the next build."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

from objectfolder.engine.dvc.changes import Changes, ChangeTracker
from objectfolder.engine.dvc.graph import stage_graph
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.engine.dvc.steps import has_command, input_state
from objectfolder.engine.records import LOGS, recall_failure
from objectfolder.engine.summary import Addressed
from objectfolder.workspace.installed import check_installed


class State(StrEnum):
    """Current state of a stage."""

    FRESH = "fresh"
    STALE = "stale"  # a dependency, a parameter, its command or an output has changed
    UPSTREAM = "upstream stale"  # nothing of its own has changed
    MISSING = "missing"  # an output is missing
    FAILED = "failed"  # at the last build, with the current inputs
    NEVER = "never built"


class Outlook(StrEnum):
    """Action of the next build."""

    SKIP = "nothing"
    RESTORE = "bring back"  # from DVC's cache
    RUN = "run"  # or restore, if another stage brings back what the cache lacks
    PERHAPS = "perhaps run"  # if the outputs of an upstream stage change


@dataclass(frozen=True)
class StageStatus(Addressed):
    """State of one stage."""

    address: str  #: stage address, such as ``modal@mug``
    state: State
    outlook: Outlook  #: action of the next build
    reasons: tuple[str, ...] = ()  #: changes that make the stage itself stale
    waits_for: tuple[str, ...] = ()  #: upstream stages that are not up to date
    log: str = ""  #: log of the command that failed, otherwise empty


def status(targets: Sequence[str] = (), root: str | Path = ".", wait: bool = False) -> list[StageStatus]:
    """Examine targets and everything upstream of them, in topological order; read-only.

    Parameters
    ----------
    targets : sequence of str
        As for `objectfolder.engine.build.build`.
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    wait : bool
        If another process uses the workspace, wait until it ends; otherwise refuse.

    Raises
    ------
    ObjectFolderError
        If the workspace is busy or cannot be read, or is of another version of the package, or a target is
        unknown.
    """
    with open_repository(root, wait) as repository:
        check_installed(repository.root)
        graph = stage_graph(repository, targets)
        tracker = ChangeTracker(graph, repository.root)
        return [
            _status(address, stage, tracker.changes(address), repository.root / LOGS)
            for address, stage in graph.stages.items()
        ]


def _status(address: str, stage: Any, changes: Changes, logs: Path) -> StageStatus:
    if changes.fresh:
        return StageStatus(address, State.FRESH, Outlook.SKIP)
    if not changes.recorded:
        state = State.NEVER
    elif changes.inputs or changes.altered:
        state = State.STALE
    else:
        state = State.MISSING if changes.missing else State.UPSTREAM
    if changes.restorable:
        outlook = Outlook.RESTORE
    elif changes.predictable or changes.inputs or not changes.recorded:
        outlook = Outlook.RUN
    else:
        outlook = Outlook.PERHAPS
    reasons = (*changes.inputs, *changes.altered, *changes.missing) if changes.recorded else ()
    failed = recall_failure(logs, address, partial(input_state, stage)) if has_command(stage) else None
    if failed is None:
        return StageStatus(address, state, outlook, reasons, changes.waits_for)
    reasons = (failed.error, *reasons)
    return StageStatus(address, State.FAILED, outlook, reasons, changes.waits_for, failed.log)
