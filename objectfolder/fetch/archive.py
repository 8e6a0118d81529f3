"""Unpack archives from strangers: nothing outside the folder, no links, no devices, no bombs."""

import lzma
import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Generator
from contextlib import closing
from functools import partial
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, cast

from objectfolder.errors import ObjectFolderError

SUFFIXES = (".tar.gz", ".tar.xz", ".tar.bz2", ".tgz", ".zip", ".tar")
MAX_BYTES = 2 << 30  #: unpacked
MAX_MEMBERS = 10_000
MAX_PADDING = 64 << 20  #: after the end of a tar

Members = Generator[tuple[str, Callable[[], Any]], None, None]  #: names, and what opens each
DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    OSError,
    NotImplementedError,
)


def unpack(archive: Path, into: Path, max_bytes: int = MAX_BYTES, max_members: int = MAX_MEMBERS) -> None:
    """Unpack a zip or tar archive.

    Parameters
    ----------
    archive : Path
        Recognised by content.
    into : Path
        New directory.
    max_bytes : int
        Most bytes that it may unpack to.
    max_members : int
        Most members that it may have.

    Raises
    ------
    ObjectFolderError
        If it is damaged or no archive, too large, or has a member with an absolute path, a parent path,
        a link, a device or a password; the message names archive and member. Nothing is left in ``into``.
    """
    into.mkdir(parents=True)
    try:
        if zipfile.is_zipfile(archive):
            members = _zip_members(archive)
        elif _is_tar(archive):
            members = _tar_members(archive)
        else:
            raise ObjectFolderError(
                f"{archive.name} is neither a zip nor a tar archive; it is damaged, or something else came "
                "in its place, such as a web page"
            )
        room = max_bytes
        with closing(members):
            for count, (name, member) in enumerate(members, 1):
                if count > max_members:
                    raise ObjectFolderError(
                        f"{archive.name} has over {max_members} members; expected one object"
                    )
                target = into / safe_path(name, archive.name)
                target.parent.mkdir(parents=True, exist_ok=True)
                with member() as stream, target.open("wb") as out:
                    room -= _copy(stream, out, room, f"{archive.name}: {name}", max_bytes)
    except DAMAGE as error:
        shutil.rmtree(into, ignore_errors=True)
        if isinstance(error, OSError) and error.errno is not None:  # of the file system, not of a decoder
            raise ObjectFolderError(f"{archive.name} cannot be unpacked: {error}") from error
        raise ObjectFolderError(f"{archive.name} is damaged ({error}); get it again") from error
    except BaseException:
        shutil.rmtree(into, ignore_errors=True)
        raise


def safe_path(name: str, where: str) -> PurePosixPath:
    """Return a relative path that stays inside its folder.

    Raises
    ------
    ObjectFolderError
        If it does not.
    """
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts or "\0" in name:
        raise ObjectFolderError(
            f"{where}: member {name!r} would be written outside the folder; do not trust it"
        )
    return path


def _copy(stream: IO[bytes], out: IO[bytes], room: int, where: str, limit: int) -> int:
    """Copy, counting what comes out rather than what the archive claims."""
    written = 0
    while block := stream.read(1 << 20):
        written += len(block)
        if written > room:
            raise ObjectFolderError(f"{where}: the archive unpacks to over {limit / 2**20:.0f} MB; refused")
        out.write(block)
    return written


def _is_tar(archive: Path) -> bool:
    try:
        return tarfile.is_tarfile(archive)
    except DAMAGE:
        return False


def _zip_members(archive: Path) -> Members:
    with zipfile.ZipFile(archive) as opened:
        for info in opened.infolist():
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise _refused(archive, info.filename)
            if info.flag_bits & 1:
                raise ObjectFolderError(
                    f"{archive.name}: member {info.filename!r} is encrypted; unpack it yourself"
                )
            if info.is_dir():
                safe_path(info.filename, archive.name)
            else:
                # The name as it is in the archive: zipfile cuts the other at a zero byte.
                yield info.orig_filename, partial(opened.open, info)


def _tar_members(archive: Path) -> Members:
    with tarfile.open(archive) as opened:
        for info in opened:
            if info.isdir():
                safe_path(info.name, archive.name)
            elif info.isreg():
                yield info.name, partial(opened.extractfile, info)
            else:
                raise _refused(archive, info.name)
        # The checksum of a compressed tar comes after the padding, and is checked when that is read.
        for _ in range(MAX_PADDING >> 20):
            if not cast(IO[bytes], opened.fileobj).read(1 << 20):
                return
        raise ObjectFolderError(f"{archive.name} goes on after its end; it is not a plain tar archive")


def _refused(archive: Path, name: str) -> ObjectFolderError:
    return ObjectFolderError(f"{archive.name}: member {name!r} is a link or a device; refused")
