"""Folders that one process at a time works in."""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def exclusive(folder: Path, on_wait: Callable[[], None] | None = None) -> Iterator[None]:
    """Make a folder, and keep other processes out of this block for the same folder: they wait.

    ``on_wait`` is called if this process has to.
    """
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):  # another process removed it meanwhile
            handle = os.open(folder, os.O_RDONLY)
            break
    try:
        if not _try_lock(handle):
            if on_wait is not None:
                on_wait()
            fcntl.flock(handle, fcntl.LOCK_EX)
        held = _is_open(handle, folder)
        if held:
            yield
    finally:
        os.close(handle)
    if not held:  # removed before the lock was ours
        with exclusive(folder, on_wait):
            yield


def remove_unused(folder: Path) -> None:
    """Remove a folder, unless a process is in a block that is `exclusive` for it, or it is gone."""
    with suppress(FileNotFoundError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            if _try_lock(handle):
                shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(handle)


def _try_lock(handle: int) -> bool:
    """Lock an open folder unless another process holds it; return whether it did."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_open(handle: int, folder: Path) -> bool:
    """Return whether the open folder is still the one of that path."""
    try:
        return os.path.samestat(os.fstat(handle), folder.stat())
    except FileNotFoundError:
        return False
