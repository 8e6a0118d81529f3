"""Room on a disk: asked for before a folder is written, and named where it runs out on the way."""

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from objectfolder.errors import ObjectFolderError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def enough_space(what: str, folder: Path, needed: int, hint: str) -> Iterator[None]:
    """Write into a folder, if its disk has room.

    Parameters
    ----------
    what : str
        What is written, for messages.
    folder : Path
        It need not exist.
    needed : int
        Bytes that it takes at least.
    hint : str
        What else than to make room helps; ends messages.

    Raises
    ------
    ObjectFolderError
        If the disk has less than that, or is full before all is written.
    """
    there = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())

    def shortage() -> ObjectFolderError:
        free = shutil.disk_usage(there).free
        return ObjectFolderError(
            f"{what}: no space in {folder}: at least {needed:,} bytes needed, {free:,} free; make room{hint}"
        )

    if shutil.disk_usage(there).free < needed:
        raise shortage()
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise shortage() from error
        raise


@contextmanager
def new_folder(what: str, out: Path, needed: int, hint: str) -> Iterator[Path]:
    """Give a folder that takes its name when all is written; otherwise as `enough_space`.

    Raises
    ------
    ObjectFolderError
        If the folder exists already.
    """
    if out.exists():
        raise ObjectFolderError(f"{out} exists already: choose another name, or delete it")
    temporary = out.with_name(f".{out.name}.tmp")
    try:
        with enough_space(what, out, needed, hint):
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir(parents=True)
            yield temporary
            temporary.rename(out)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
