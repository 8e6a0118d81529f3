"""Inputs of a stage while its command runs: they must stay what DVC has recorded.

DVC records parameters and digests before a command starts, but the command reads the files later. Parameters
are therefore read from a copy that a build makes when it begins. All other files are stamped before their
digests are recorded, and again after the command: an edit shows even if it was reverted meanwhile.
"""

import stat
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from dvc.dependency import ParamsDependency, param
from dvc.stage import Stage

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_bytes
from objectfolder.workspace.code_digests import content_digest
from objectfolder.workspace.installed import INSTALLED, located
from objectfolder.workspace.layout import CODE
from objectfolder.workspace.params import HELD_PARAMS, PARAMS_FILE

#: Identity of every file that a stage reads; None if it does not exist.
Stamps = dict[Path, tuple[int, ...] | None]


class _HeldParams(ParamsDependency):
    """Parameters that DVC reads from a copy of their file, whatever becomes of the file."""

    exists = True

    def __init__(self, dep: ParamsDependency, held: str):
        self.__dict__.update(vars(dep))  # a new one takes DVC 0.1 ms, and an object has twenty
        self.held = held

    def isfile(self) -> bool:
        return True

    def read_params(self, flatten: bool = True, **_: Any) -> dict[str, Any]:
        assert self.repo is not None
        values: dict[str, Any] = param.read_param_file(self.repo.fs, self.held, self.params, flatten)
        return values


def hold_params(stages: Iterable[Stage], root: Path, folder: Path) -> dict[str, str]:
    """Copy ``params.yaml`` of a workspace to a folder, and let DVC read the copy from now on.

    Returns the environment that makes the commands of stages read the copy as well; empty without the file.
    Raises ObjectFolderError if it cannot be copied.
    """
    path, held = root / PARAMS_FILE, folder / PARAMS_FILE
    if not path.exists():
        return {}
    try:
        content = path.read_bytes()
        if not held.exists() or held.read_bytes() != content:  # a build with nothing to do writes nothing
            write_bytes(held, content)
    except OSError as error:
        raise ObjectFolderError(f"cannot copy {path} to {held}: {error}; build again once it can") from error
    for stage in stages:
        stage.deps = [
            _HeldParams(dep, str(held))
            if isinstance(dep, ParamsDependency) and dep.fs_path == str(path)
            else dep
            for dep in stage.deps
        ]
    return {HELD_PARAMS: str(held)}


def stamps(stage: Stage) -> Stamps:
    """Return the identity of every file that a stage reads, without reading it."""
    return {path: _stamp(path) for dep in stage.deps for path in _files(dep)}


def find_written(before: Stamps, after: Stamps) -> list[Path]:
    """Return the files that were written, made or removed between two stamps."""
    if before == after:
        return []
    return sorted(
        path for path in before.keys() | after.keys() if before.get(path, ()) != after.get(path, ())
    )


def check_code(stage: Stage, found: Stamps) -> None:
    """Check that the modules of a stage are those that this build has recorded; ``found`` are its stamps.

    Raises ObjectFolderError if one was edited since.
    """
    edited = [
        _name(path, Path(stage.wdir))
        for dep in stage.deps
        for path, digest in _modules(dep).items()
        if _digest(path, found.get(path)) != digest
    ]
    if edited:
        raise ObjectFolderError(
            f"{', '.join(edited)} was edited after this build had recorded the code; build again"
        )


def _files(dep: Any) -> list[Path]:
    if dep.protocol != "local" or isinstance(dep, _HeldParams):
        return []
    path = Path(dep.fs_path)
    if path.is_dir():
        return [Path(name) for name in dep.dvcignore.find(dep.fs, dep.fs_path)]
    return [path, *_modules(dep)]


def _modules(dep: Any) -> dict[Path, str]:
    """Return digests by file if a dependency is a list of modules, as `code_digests.digests` writes it."""
    path, home = Path(dep.fs_path), Path(dep.stage.wdir)
    return _read_list(path, home, _stamp(path)) if path.is_relative_to(home / CODE) else {}


@cache  # all objects share it
def _read_list(path: Path, home: Path, stamp: tuple[int, ...] | None) -> dict[Path, str]:
    lines = [] if stamp is None else path.read_text().splitlines()
    return {located(name, home): digest for digest, _, name in (line.partition("  ") for line in lines)}


def _name(path: Path, home: Path) -> str:
    return path.relative_to(INSTALLED if path.is_relative_to(INSTALLED) else home).as_posix()


def _stamp(path: Path) -> tuple[int, ...] | None:
    try:
        status = path.lstat()
        linked = stat.S_ISLNK(status.st_mode) or status.st_nlink > 1
        status = path.stat() if linked else status
    except OSError:
        return None
    # The clock of a file's status cannot be set back as its modification time can. Every new link to the same
    # bytes sets it forward, though: with linked caches DVC makes one whenever two outputs are equal.
    changed = 0 if linked else status.st_ctime_ns
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, changed


@cache
def _digest(path: Path, stamp: tuple[int, ...] | None) -> str | None:
    """Return the digest of a file, which is read once for every stamp; None if it cannot be read."""
    try:
        return None if stamp is None else content_digest(path)
    except (ObjectFolderError, SyntaxError, ValueError):  # while it is edited
        return None
