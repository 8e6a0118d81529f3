"""Checks of free disk space, descriptions of full disks, and folders that are complete or absent."""

import errno
import logging
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.locks import left_folders, private_path

FULL_BELOW = 2**20  #: free bytes below which a disk counts as full
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT)
_log = logging.getLogger(__name__)


def is_shortage(error: BaseException | None) -> bool:
    """Return whether an error or one of its causes reports a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL_DISK:
            return True
        error = error.__cause__ or error.__context__
    return False


def mentions_shortage(lines: Iterable[str]) -> bool:
    """Return whether a log reports a full disk."""
    return any(os.strerror(number) in line for line in lines for number in _FULL_DISK)


def free_bytes(path: Path) -> int:
    """Return the free bytes on the disk of a path; the path need not exist."""
    return shutil.disk_usage(_existing(path)).free


def find_fullest(paths: Iterable[Path]) -> tuple[Path, int]:
    """Return the path whose disk has the least free space, and its free bytes."""
    free = {path: free_bytes(path) for path in paths}
    path = min(free, key=free.__getitem__)
    return path, free[path]


def describe_full(path: Path) -> str:
    """Describe a full disk for an error message."""
    usage = shutil.disk_usage(_existing(path))
    free, total = usage.free / 1e6, usage.total / 1e6
    return f"the disk of {path} is full ({free:.1f} of {total:.1f} MB free); make space and build again"


@contextmanager
def enough_space(what: str, folder: Path, needed: int, hint: str) -> Iterator[None]:
    """Check free space before the block writes into a folder, and report a disk that fills up in the block.

    ``what``: name of the data, for messages; ``folder``: destination; it need not exist; ``needed``: lower
    bound of the bytes to write; ``hint``: alternative to freeing space, appended to the message. Raises
    ObjectFolderError if fewer bytes are free, or the disk fills up before the block ends.
    """

    def shortage(place: object) -> ObjectFolderError:
        sizes = f"at least {needed:,} bytes needed, {free_bytes(folder):,} free"
        return ObjectFolderError(f"{what}: no space in {place}: {sizes}; make room{hint}")

    if free_bytes(folder) < needed:
        raise shortage(folder)
    try:
        yield
    except OSError as error:
        if error.errno in _FULL_DISK:
            raise shortage(f"{folder} to write {error.filename}" if error.filename else folder) from error
        raise


@contextmanager
def new_folder(what: str, out: Path, needed: int, hint: str) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to ``out`` on success; otherwise like `enough_space`.

    Its name is drawn at random. Of several who write the same folder the first that ends wins; the others
    raise. Raises ObjectFolderError if ``out`` exists already, before the block or after it.
    """
    if os.path.lexists(out):
        raise _exists(out)
    temporary = private_path(out)
    for left in left_folders(out):
        _log.warning("%s: left by a run that was stopped; delete it unless another run is writing it", left)
    with enough_space(what, out, needed, hint):
        temporary.mkdir(parents=True)
        try:
            yield temporary
            _place(temporary, out)
        except OSError as error:
            if error.errno in _FULL_DISK:  # name the file; libraries may not
                name = error.filename2 or error.filename or _last_written(temporary)
                error.filename = str(name).replace(str(temporary), str(out))
                del error.filename2
            raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def refuse_links(folder: Path, below: Path) -> None:
    """Raise ObjectFolderError if a folder, from ``folder`` up to one ``below``, is a link."""
    for path in (folder, *folder.parents):
        if path == below:
            return
        if path.is_symlink():
            raise ObjectFolderError(f"{path} is a link, expected a folder; delete it, or write elsewhere")


def _place(folder: Path, out: Path) -> None:
    """Rename a folder unless the new name exists; plain renaming would replace an empty folder."""
    try:
        out.mkdir()  # from here on, the name is ours
    except FileExistsError as error:
        raise _exists(out) from error
    try:
        folder.rename(out)
    except BaseException as error:
        with suppress(OSError):
            out.rmdir()
        if isinstance(error, OSError) and error.errno == errno.ENOTEMPTY:  # others have put files there
            raise _exists(out) from error
        raise


def _exists(out: Path) -> ObjectFolderError:
    return ObjectFolderError(f"{out} exists already: choose another name, or delete it")


def _last_written(folder: Path) -> Path:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return max(files, key=lambda path: path.stat().st_mtime_ns, default=folder)


def _existing(path: Path) -> Path:
    path = path.absolute()
    return next(parent for parent in (path, *path.parents) if parent.exists())
