"""``dvc repro`` of one stage, split into steps so that the command can run elsewhere.

The order is DVC's (``Stage.reproduce``, ``Stage.run``, ``run_stage``) and matters: dependencies must not be
saved before `restore_run`, or the run cache would store the old outputs under the new dependencies.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.dependency import ParamsDependency
from dvc.exceptions import DvcException
from dvc.stage import Stage
from dvc.stage.cache import RunCacheNotFoundError
from dvc.stage.run import prepare_kwargs

from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.dvc.inputs import Stamps, check_code, find_written, stamps
from objectfolder.engine.dvc.runcache import is_there, remove_damaged


@dataclass(frozen=True)
class ShellCommand:
    """Command of a stage."""

    lines: Sequence[str]  #: shell commands, to run one after another
    cwd: Path
    env: Mapping[str, str]  #: environment, with DVC's variables
    inputs: Stamps  #: identity of the files that it reads


@contextmanager
def _explain_errors() -> Iterator[None]:
    """Raise DVC's errors as ObjectFolderError, with the cause that DVC often leaves out of the message."""
    try:
        yield
    except DvcException as error:
        cause = f": {error.__cause__}" if error.__cause__ else ""
        raise ObjectFolderError(f"{error}{cause}") from error


def has_command(stage: Stage) -> bool:
    """Return whether a stage runs a command; otherwise it is data (``dvc add``), an import, or frozen."""
    return bool(stage.cmd) and not stage.frozen


@_explain_errors()
def has_changed(stage: Stage) -> bool:
    """Return whether a stage differs from the lock file."""
    return bool(stage.changed())


@_explain_errors()
def update_data(stage: Stage, force: bool) -> bool:
    """Let DVC handle a stage without a command: it verifies data or downloads an import.

    Returns whether anything was done. Raises ObjectFolderError if data is missing, and so is a part of its
    copy in the cache. DVC would restore the rest, and record that as the data from then on.
    """
    missing = [out for out in stage.outs if out.hash_info and not is_there(out)]
    if missing:
        remove_damaged(missing)
        for out in missing:
            if stage.is_data_source and out.changed_cache():
                raise ObjectFolderError(
                    f"{out} is missing, and its copy in DVC's cache is missing or damaged, too; fetch it "
                    "with `dvc pull`, restore it from a backup, or remove the object and add it again"
                )
        stage.checkout()  # restores deleted data from the cache
    if not (force or stage.changed()):
        return False
    remove_damaged(stage.outs)  # DVC would keep them, and the data would stay without a copy
    return stage.reproduce(force=force) is not None


@_explain_errors()
def restore_run(stage: Stage) -> bool:
    """Replace old outputs by those in the run cache; return whether it had them."""
    stage.remove_outs(ignore_remove=False, force=False)
    try:
        stage.repo.stage_cache.restore(stage)
    except RunCacheNotFoundError:
        return False
    # Unlike DVC's `save`, do not hash the dependencies again, here and in `save_run`: one that changed during
    # the run must count as changed.
    stage.save_outs()
    _store(stage)
    return True


@_explain_errors()
def prepare_run(stage: Stage) -> ShellCommand:
    """Remove old outputs, hash dependencies, and return the command to run."""
    stage.remove_outs(ignore_remove=False, force=False)
    for out in stage.outs:
        out.clear()  # or `restore_run` would bring them back for the new dependencies, if it runs again
    inputs = stamps(stage)
    stage.save_deps()
    check_code(stage, inputs)
    lines = stage.cmd if isinstance(stage.cmd, list) else stage.cmd.splitlines()
    return ShellCommand(lines, Path(stage.wdir), prepare_kwargs(stage)["env"], inputs)


def changed_inputs(stage: Stage, inputs: Stamps) -> list[str]:
    """Return the files, relative to the workspace, that were written since `prepare_run` stamped them."""
    return [os.path.relpath(path, stage.wdir) for path in find_written(inputs, stamps(stage))]


@_explain_errors()
def save_run(stage: Stage) -> None:
    """Hash the outputs of a finished command and store them in DVC's cache and run cache."""
    stage.save_outs()
    remove_damaged(stage.outs)  # DVC would replace the outputs by cached files of the same names
    _store(stage)


def output_paths(stage: Stage) -> list[Path]:
    """Return the paths of the outputs of a stage."""
    return [Path(out.fs_path) for out in stage.outs]


def input_state(stage: Stage) -> dict[str, Any]:
    """Return command, parameters and hashes of the dependencies on disk, as JSON values."""
    values: dict[str, Any] = {"cmd": stage.cmd}
    for dep in stage.deps:
        try:
            values[str(dep)] = dep.get_hash().value
        except (DvcException, OSError):
            values[str(dep)] = None
        if isinstance(dep, ParamsDependency):
            values[str(dep)] = json.dumps(values[str(dep)], sort_keys=True, default=str)
    return values


def _store(stage: Stage) -> None:
    plain = (out for out in stage.outs if not (out.is_metric or out.is_plot))
    run_cache = all(out.use_cache for out in plain)
    stage.md5 = stage.compute_md5()
    if run_cache:
        stage.repo.stage_cache.save(stage)
    stage.commit()
