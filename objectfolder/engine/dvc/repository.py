"""Open a DVC workspace as its only owner, quietly."""

import itertools
import json
import logging
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, chdir, contextmanager
from pathlib import Path
from typing import Any

import psutil
from dvc.exceptions import DvcException, NotDvcRepoError
from dvc.lock import LockError
from dvc.repo import Repo, lock_repo
from dvc.rwlock import RWLOCK_FILE
from dvc.rwlock import SCHEMA as RWLOCK_SCHEMA
from dvc.utils.serialize import load_yaml
from voluptuous import Invalid

from objectfolder.engine.dvc.lockfile import LockFiles
from objectfolder.engine.dvc.once import remembered
from objectfolder.errors import ObjectFolderError

LOGGERS = ("dvc", "dvc_data", "dvc_objects")
POLL = 0.5
_log = logging.getLogger(__name__)


@contextmanager
def owned(root: str | Path = ".") -> Iterator[Repo]:
    """Open the DVC repository of a workspace to read it; otherwise as `held`."""
    with held(root) as (repo, _):
        yield repo


@contextmanager
def held(root: str | Path = ".", wait: bool = False) -> Iterator[tuple[Repo, LockFiles]]:
    """Open the DVC repository of a workspace and hold its lock.

    The process works in ``root`` meanwhile: DVC resolves the outputs of its run cache against the current
    directory.

    Parameters
    ----------
    root : Path
        Workspace, the directory that holds ``dvc.yaml``.
    wait : bool
        If another process uses it, say which and wait until it ends; else refuse.

    Raises
    ------
    ObjectFolderError
        If it is not a DVC workspace, another process uses it, or DVC cannot read it.
    """
    if not Path(root).is_dir():
        raise ObjectFolderError(f"{root} is not a directory; give the one that holds dvc.yaml")
    with _quiet(), chdir(root):
        try:
            repo = Repo()
        except NotDvcRepoError as error:
            raise ObjectFolderError(
                f"{Path.cwd()} is not inside a DVC repository; run `dvc init` there"
            ) from error
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot open {Path.cwd()}: {error}") from error
        with repo, _alone(repo, wait):
            lockfiles = LockFiles(Path(repo.root_dir))
            with repo.scm_context(quiet=True), remembered(), lockfiles.serving():
                yield repo, lockfiles


def track(path: Path, root: str | Path = ".") -> None:
    """Put a file or folder of a workspace under DVC's control.

    Raises
    ------
    ObjectFolderError
        If DVC cannot, or another process uses the workspace.
    """
    with owned(root) as repo:
        try:
            repo.add(str(path.resolve()))
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot track {path}: {error}; nothing was changed") from error


def read_params(root: Path) -> dict[str, Any]:
    """Contents of ``params.yaml``; empty if there is none."""
    path = root / "params.yaml"
    try:
        values = load_yaml(path) if path.exists() else {}
    except DvcException as error:
        raise ObjectFolderError(f"DVC cannot read {path}: {error}") from error
    return values if isinstance(values, dict) else {}


@contextmanager
def _quiet() -> Iterator[None]:
    # Above ERROR, DVC disables its progress bars too.
    levels = {name: logging.getLogger(name).level for name in LOGGERS}
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


class _Busy(Exception):
    """Who uses the workspace."""


@contextmanager
def _alone(repo: Repo, wait: bool) -> Iterator[None]:
    said = ""
    with ExitStack() as stack:
        while True:
            try:
                stack.enter_context(_locked(repo))
                break
            except _Busy as busy:
                if not wait:
                    raise ObjectFolderError(
                        f"{busy}; wait until it ends (--wait does), or stop it, and build again"
                    ) from busy
                if str(busy) != said:
                    _log.warning("%s; waiting until it ends", busy)
                    said = str(busy)
            time.sleep(POLL)
        yield


@contextmanager
def _locked(repo: Repo) -> Iterator[None]:
    with ExitStack() as stack:
        try:
            stack.enter_context(lock_repo(repo))
        except LockError as error:
            raise _Busy(f"another DVC process{_holder(repo)} holds the lock of {repo.root_dir}") from error
        _refuse_if_busy(repo)
        yield


def _holder(repo: Repo) -> str:
    try:
        return f" (process {int((Path(repo.tmp_dir) / 'lock').read_text())})"
    except (OSError, ValueError):
        return ""


def _refuse_if_busy(repo: Repo) -> None:
    # While `dvc repro` runs a command it gives the lock back and keeps only entries in this file.
    path = Path(repo.tmp_dir) / RWLOCK_FILE
    try:
        entries = RWLOCK_SCHEMA(json.loads(path.read_text()))
    except FileNotFoundError:
        return
    except (ValueError, Invalid):
        # Torn by a process that was killed while it wrote: nobody can be writing now, the lock is ours.
        path.unlink()
        return
    readers = itertools.chain.from_iterable(entries["read"].values())
    for holder in (*entries["write"].values(), *readers):
        pid = int(holder["pid"])
        if pid != os.getpid() and psutil.pid_exists(pid):
            raise _Busy(
                f"process {pid} (`{holder['cmd']}`) is running a stage in {repo.root_dir} (if it is not a "
                f"DVC process, remove {path})"
            )
