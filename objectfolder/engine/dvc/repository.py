"""Open a DVC workspace exclusively, without DVC's log output; make a folder one."""

import getpass
import itertools
import json
import logging
import os
import re
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, chdir, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.config import Config
from dvc.dirs import site_cache_dir
from dvc.exceptions import DvcException, NotDvcRepoError
from dvc.lock import LockError
from dvc.repo import Repo, lock_repo
from dvc.rwlock import RWLOCK_FILE
from dvc.rwlock import SCHEMA as RWLOCK_SCHEMA
from dvc.stage import Stage
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.tree import Tree
from voluptuous import Invalid

from objectfolder.base.disk import free_bytes
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.locks import remove_abandoned
from objectfolder.base.yamlfile import check_yaml, merge_conflict, read_yaml
from objectfolder.engine.dvc.lockfile import COPIES, LockFiles
from objectfolder.engine.dvc.replacements import replacements
from objectfolder.engine.dvc.runcache import RunCache
from objectfolder.workspace.params import check_root, outside_workspace

LOGGERS = ("dvc", "dvc_data", "dvc_objects")
PARAMS = "params.yaml"
#: Folders that hold what stages write, and those around them.
OUTPUT_FOLDERS = ("build", "metrics", "benchmarks", "data", "data/objects", str(COPIES))
POLL = 0.5
_PARTIAL = re.compile(r"\.[0-9A-Za-z_-]{20,24}\.tmp")  # DVC's names: 22 characters at random
_log = logging.getLogger(__name__)
#: As in this project's own repository: DVC calls nobody, and adds nothing to Git's index by itself.
CORE = {"analytics": False, "check_update": False, "autostage": False}


@dataclass(frozen=True)
class OpenRepository:
    """A DVC repository whose lock this process holds."""

    repo: Repo  #: for the modules of this package
    root: Path
    lockfiles: LockFiles  #: its lock files

    @property
    def cache(self) -> Path:
        """Directory of the cached objects."""
        return Path(self.repo.cache.local.path)

    @property
    def cache_dir(self) -> Path:
        """DVC's cache directory, which holds objects and run cache."""
        return Path(self.repo.cache.local_cache_dir)

    @property
    def tmp(self) -> Path:
        """DVC's directory for temporary files."""
        return Path(self.repo.tmp_dir)

    @property
    def own_files(self) -> Path:
        """Directory of the engine's files among DVC's."""
        return Path(self.repo.root_dir) / COPIES

    @property
    def owns_cache(self) -> bool:
        """Whether the cache is where a workspace has its own, so that no other workspace uses it."""
        return self.cache_dir == self.root / ".dvc" / "cache"

    def object_path(self, oid: str) -> Path:
        """Path of a cached object by its hash."""
        return Path(self.repo.cache.local.oid_to_path(oid))

    def check_cache(self) -> None:
        """Check that this user can write to every folder of the cache.

        Raises ObjectFolderError if not: else a stage would run, and its outputs could not be kept.
        """
        folders = [self.cache_dir, self.cache, self.cache_dir / "runs"]
        folders += [
            place for folder in folders[1:] if folder.is_dir() for place in folder.glob("[0-9a-f][0-9a-f]")
        ]
        for folder in filter(Path.exists, folders):
            if not os.access(folder, os.W_OK | os.X_OK):
                raise ObjectFolderError(
                    f"cannot write to {folder}, a part of DVC's cache, where a build keeps its outputs. Make "
                    f"{self.cache_dir} writable (for several users: `dvc config cache.shared group`, once "
                    "`chmod -R g+w` on it), or take another with `dvc cache dir --local PATH`, and this one "
                    "as a remote: `dvc remote add --local -d shared` with its path, then `build --pull`"
                )

    def use_run_cache(self, pull: bool) -> None:
        """Verify what the run cache restores; if ``pull``, fetch what it lacks from the default remote."""
        self.repo.stage_cache = RunCache(self.repo, restores=True, pull=pull)

    def remove_partial_files(self) -> None:
        """Remove temporary files of interrupted writes to the caches, and of a killed engine.

        DVC removes its own neither when it is killed nor when the disk is full.
        """
        for folder in (self.root, self.own_files):
            remove_abandoned(folder)
        if not self.cache.is_relative_to(self.repo.root_dir):
            return  # shared: another repository may be writing
        patterns = ((self.cache, "*.tmp"), (self.cache, "*/*.tmp"), (self.cache_dir, "runs/*/*/.*.tmp"))
        for path in itertools.chain.from_iterable(folder.glob(pattern) for folder, pattern in patterns):
            with suppress(OSError):
                path.unlink()


def remove_partial_outputs(stages: Iterable[Stage]) -> None:
    """Remove temporary files of interrupted restores beside the outputs of stages."""
    for folder in {Path(out.fs_path).parent for stage in stages for out in stage.outs}:
        with suppress(OSError):
            for path in folder.glob(".*.tmp"):
                if _PARTIAL.fullmatch(path.name):
                    path.unlink()


@contextmanager
def open_repository(root: str | Path = ".", wait: bool = False) -> Iterator[OpenRepository]:
    """Open the DVC repository of a workspace and hold its lock.

    The working directory is ``root`` meanwhile: DVC resolves the outputs of its run cache against the
    current directory. Errors of DVC in the block are raised as ObjectFolderError.

    ``wait``: if another process uses the workspace, log which and wait until it ends; otherwise refuse.
    Raises ObjectFolderError if it is not a DVC workspace, another process uses it, or DVC cannot read it.
    """
    root = Path(root).resolve()
    if not root.is_dir():
        raise ObjectFolderError(f"{root} is not a directory; expected the one that holds dvc.yaml")
    if not (root / "dvc.yaml").is_file() and not (root / PARAMS).is_file():
        raise outside_workspace(root / PARAMS)
    check_root(root)
    if (root / PARAMS).exists():  # before DVC reads it, which has no limits
        check_yaml(root / PARAMS)
    for name in (*OUTPUT_FOLDERS, *_links_in(root / "build", root)):
        if (root / name).is_symlink():
            raise ObjectFolderError(
                f"{root / name} is a link, which DVC does not follow; make it a folder. To keep its files on "
                "another disk: `dvc cache dir PATH` and `dvc config cache.type symlink`"
            )
    with silence_dvc(), chdir(root), _site_cache():
        _give_user_a_name()
        try:
            repo = Repo()
        except NotDvcRepoError as error:
            raise ObjectFolderError(f"{root} is not inside a DVC repository; run `dvc init` there") from error
        except DvcException as error:
            git = "; run `git init` in it, or clone the repository" if "not a git" in str(error) else ""
            raise ObjectFolderError(f"DVC cannot open {root}: {error}{git}") from error
        repo.stage_cache = RunCache(repo)
        # DVC removes a file before it finds out that it cannot link it; then it copies it.
        repo.cache.local.cache_types = [*dict.fromkeys((*repo.cache.local.cache_types, "copy"))]
        with repo, _hold_lock(repo, wait):
            lockfiles = LockFiles(Path(repo.root_dir))
            with repo.scm_context(quiet=True), replacements(lockfiles):
                try:
                    yield OpenRepository(repo, root, lockfiles)
                except DvcException as error:
                    unread = re.search("unable to read: '(.+?)'", str(error))  # a path from here
                    conflict = merge_conflict(unread[1]) if unread else ""
                    if conflict and unread and unread[1].endswith("dvc.lock"):
                        conflict += "; the next build writes the rest"
                    raise ObjectFolderError(
                        conflict or f"DVC cannot read the workspace {root}: {error}"
                    ) from error


def _links_in(folder: Path, root: Path) -> list[str]:
    with suppress(FileNotFoundError, NotADirectoryError), os.scandir(folder) as entries:
        links = [entry.path for entry in entries if entry.is_symlink() and entry.is_dir()]
        return sorted(os.path.relpath(path, root) for path in links)
    return []


def track(path: Path, root: str | Path = ".") -> None:
    """Put a folder of a workspace under DVC's control, with every file in it.

    Raises ObjectFolderError if DVC cannot or leaves files out, or another process uses the workspace.
    """
    path = path.resolve()
    with open_repository(root) as repository:
        try:
            (stage,) = repository.repo.add(str(path))
        except DvcException as error:
            raise ObjectFolderError(f"DVC cannot track {path}: {error}; nothing was changed") from error
        tree = stage.outs[0].get_obj()
        stored = {"/".join(name): digest.value for name, _, digest in tree} if isinstance(tree, Tree) else {}
    files = {file.relative_to(path).as_posix(): file for file in path.rglob("*") if file.is_file()}
    for name in sorted({*files, *stored}):
        if name not in files or stored.get(name) != file_md5(str(files[name]), name="md5"):
            raise ObjectFolderError(
                f"DVC did not store {path / name} as it is; rename it, if a pattern in .dvcignore names it"
            )


def read_params(root: Path) -> dict[str, Any]:
    """Return the contents of ``params.yaml``; empty if it does not exist."""
    path = root / PARAMS
    values = read_yaml(path) if path.exists() else {}
    return values if isinstance(values, dict) else {}


@contextmanager
def _site_cache() -> Iterator[None]:
    """Report in the block that DVC cannot use the databases that it keeps outside of workspaces."""
    try:
        yield
    except sqlite3.Error as error:
        folder = Path(site_cache_dir(Config.from_cwd(validate=False)["core"].get("site_cache_dir")))
        raise ObjectFolderError(
            f"DVC cannot use its databases in {folder}: {error}; {free_bytes(folder) / 1e6:.1f} MB are free "
            "there; make space, or delete that folder, which DVC creates again"
        ) from error


def _give_user_a_name() -> None:
    """Let DVC, which asks for the user's name, have the number where there is no name, as in containers."""
    try:
        getpass.getuser()
    except (KeyError, OSError):
        os.environ["LOGNAME"] = str(os.getuid())


@contextmanager
def silence_dvc() -> Iterator[None]:
    """Silence DVC's log, in the block."""
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
    """Another process uses the workspace; the message names it."""


@contextmanager
def _hold_lock(repo: Repo, wait: bool) -> Iterator[None]:
    said = ""
    with ExitStack() as stack:
        while True:
            try:
                stack.enter_context(_try_lock(repo))
                break
            except _Busy as busy:
                if not wait:
                    raise ObjectFolderError(
                        f"{busy}; wait until it ends (`objectfolder build --wait` does), or stop it, and run "
                        "this again"
                    ) from busy
                if str(busy) != said:
                    _log.warning("%s; waiting until it ends", busy)
                    said = str(busy)
            time.sleep(POLL)
        yield


@contextmanager
def _try_lock(repo: Repo) -> Iterator[None]:
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
    # While `dvc repro` runs a command it releases the lock and keeps only entries in this file.
    path = Path(repo.tmp_dir) / RWLOCK_FILE
    try:
        entries = RWLOCK_SCHEMA(json.loads(path.read_text()))
    except FileNotFoundError:
        return
    except (ValueError, Invalid):
        # Left by a process that was killed while writing; nobody writes now, because the lock is ours.
        path.unlink()
        return
    readers = itertools.chain.from_iterable(entries["read"].values())
    for holder in (*entries["write"].values(), *readers):
        import psutil  # DVC commands that run beside a build are rare

        pid = int(holder["pid"])
        if pid != os.getpid() and psutil.pid_exists(pid):
            raise _Busy(
                f"process {pid} (`{holder['cmd']}`) is running a stage in {repo.root_dir} (if it is not a "
                f"DVC process, remove {path})"
            )


def start_repository(root: Path) -> None:
    """Initialise Git, unless the folder is a repository already, and DVC.

    Raises ObjectFolderError if Git is not installed, or one of them refuses.
    """
    if shutil.which("git") is None:
        raise ObjectFolderError(
            "git is not installed, which a workspace needs; install it (Debian: apt-get install git)"
        )
    if not (root / ".git").exists():
        command = ["git", "init", "--quiet", "--initial-branch", "main", str(root)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise ObjectFolderError(f"git cannot make a repository in {root}: {done.stderr.strip()}")
    try:
        with silence_dvc(), Repo.init(str(root)) as repo, repo.config.edit("repo") as config:
            config["core"].update(CORE)
    except DvcException as error:
        raise ObjectFolderError(f"DVC cannot make a repository in {root}: {error}") from error
