"""Files and folders that one process at a time works in."""

import fcntl
import glob
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PRIVATE = re.compile(r"\..*\.tmp-[0-9a-f]{16}(\.[^.]*)?", re.DOTALL)
_cleared: set[str] = set()  # folders whose abandoned files this process has removed


@contextmanager
def exclusive(folder: Path, on_wait: Callable[[], None] | None = None) -> Iterator[None]:
    """Make a folder, and let one process at a time into this block; who has to wait calls ``on_wait``."""
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
    with suppress(FileNotFoundError), _opened(folder) as handle:
        if _try_lock(handle):
            shutil.rmtree(folder, ignore_errors=True)


def private_path(path: Path) -> Path:
    """Return a hidden path beside another, of the same suffix, that nobody else has: it is random."""
    return path.with_name(f"{_beginning(path)}{secrets.token_hex(8)}{path.suffix}")


def left_folders(path: Path) -> list[Path]:
    """Return the folders beside another that `private_path` named for it and nobody removed, sorted."""
    found = path.parent.glob(f"{glob.escape(_beginning(path))}*")
    return sorted(left for left in found if _PRIVATE.fullmatch(left.name) and left.is_dir())


def claim_file(path: Path) -> tuple[Path, int]:
    """Make an empty file beside ``path``; return it and a descriptor that locks it while it is open.

    The first call for a folder removes the files there that killed processes left, see `remove_abandoned`.
    """
    folder = os.path.abspath(path.parent)  # noqa: PTH100 - Path.absolute is slow
    if folder not in _cleared:
        remove_abandoned(path.parent)
        _cleared.add(folder)
    while True:
        made = private_path(path)
        handle = os.open(made, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
        try:
            if _try_lock(handle) and _is_open(handle, made):
                return made, handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # another process took it for abandoned before it was locked, and removes it


def remove_abandoned(folder: Path) -> None:
    """Remove the files of `claim_file` in a folder that no process has locked any more."""
    with suppress(OSError), os.scandir(folder) as entries:
        for path in [folder / entry.name for entry in entries if _PRIVATE.fullmatch(entry.name)]:
            with suppress(OSError), _opened(path, os.O_NOFOLLOW | os.O_NONBLOCK) as handle:
                status = os.fstat(handle)
                own = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
                # A second name is of a file that lives on, such as one that `base.io.keep` is placing.
                if own and status.st_nlink == 1 and _try_lock(handle) and _is_open(handle, path):
                    path.unlink()


@contextmanager
def _opened(path: Path, flags: int = 0) -> Iterator[int]:
    handle = os.open(path, os.O_RDONLY | flags)
    try:
        yield handle
    finally:
        os.close(handle)


def _beginning(path: Path) -> str:
    return f".{path.stem[:50]}.tmp-"


def _try_lock(handle: int) -> bool:
    """Lock an open file or folder unless another process holds it; return whether it did."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_open(handle: int, path: Path) -> bool:
    """Return whether the open file or folder is still the one of that path."""
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
