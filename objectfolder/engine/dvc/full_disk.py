"""Full disks: say which, and give back what half-written copies hold."""

import errno
import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from dvc.repo import Repo

#: A disk with less than this left is full: nothing of use fits.
LOW = 2**20
_FULL = (errno.ENOSPC, errno.EDQUOT)


def is_shortage(error: BaseException | None) -> bool:
    """Whether an error, or what caused it, is that a disk is full."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


def mentions_shortage(lines: Iterable[str]) -> bool:
    """Whether a log says that a disk is full."""
    return any(os.strerror(number) in line for line in lines for number in _FULL)


def fullest(paths: Iterable[Path]) -> tuple[Path, int, int]:
    """Of some paths, the one whose disk has least left, with free and total bytes; they need not exist."""
    usage = {path: shutil.disk_usage(_existing(path)) for path in paths}
    path = min(usage, key=lambda path: usage[path].free)
    return path, usage[path].free, usage[path].total


def describe(path: Path, free: int, total: int) -> str:
    """Say how much a disk has left."""
    return f"the disk of {path} is full ({free / 1e6:.1f} of {total / 1e6:.1f} MB free)"


def sweep(repo: Repo) -> None:
    """Remove what copies into the cache left when they broke off; needs the repository's lock.

    DVC copies to a temporary name, and removes it neither when it is killed nor when the disk is full.
    """
    cache = Path(repo.cache.local.path)
    if not cache.is_relative_to(repo.root_dir):
        return  # shared: another repository may be writing now
    for folder in _folders(cache):
        for entry in os.scandir(folder):
            if entry.name.startswith(".") and entry.name.endswith(".tmp"):
                with suppress(OSError):
                    Path(entry).unlink()


def _folders(cache: Path) -> list[str]:
    try:
        return [str(cache), *(entry.path for entry in os.scandir(cache) if entry.is_dir())]
    except FileNotFoundError:
        return []


def _existing(path: Path) -> Path:
    return next(parent for parent in (path, *path.parents) if parent.exists())
