"""Safely extract untrusted archives: no links, devices or paths outside the folder; bounded size."""

import io
import os
import shutil
import stat
import tarfile
import zipfile
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, cast

from objectfolder.base.errors import ObjectFolderError

SUFFIXES = (".tar.gz", ".tar.xz", ".tar.bz2", ".tgz", ".zip", ".tar")
MAX_BYTES = 2 << 30  #: extracted
MAX_MEMBERS = 10_000  #: folders included
MAX_DEPTH = 64  #: folders around a member
MAX_DIRECTORY = 2 << 20  #: bytes of a zip's directory, or of all extended headers of a tar
MAX_EXTENSION = 1 << 14  #: bytes of one extended header of a tar
MAX_PADDING = 64 << 20  #: after the end of a tar
#: Headers of a tar that extend those of the members after them: long names and other attributes.
EXTENSIONS = (
    *(tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE),
    *(tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK),
)


def extract(archive: Path, into: Path, max_bytes: int = MAX_BYTES, max_members: int = MAX_MEMBERS) -> None:
    """Extract a zip or tar archive, whose format is recognised by its content.

    ``into``: new directory; removed again on error; ``max_bytes``: maximum extracted size; ``max_members``:
    maximum number of members, folders included. Raises ObjectFolderError if it is damaged, not an archive,
    too large, or has a member that is a link, a device, encrypted, or outside the folder; the message names
    archive and member.
    """
    into.mkdir(parents=True)
    budget = _Budget(archive.name, max_bytes, max_members)
    try:
        if zipfile.is_zipfile(archive):
            _extract_zip(archive, into, budget)
        else:
            _extract_tar(archive, into, budget)
    except BaseException as error:
        shutil.rmtree(into, ignore_errors=True)
        if isinstance(error, ObjectFolderError) or not isinstance(error, Exception):
            raise
        if isinstance(error, OSError) and error.errno is not None:  # of the file system, not of a decoder
            raise ObjectFolderError(f"{archive.name} cannot be unpacked: {error}") from error
        # Readers of archives may raise anything on unexpected content.
        raise ObjectFolderError(f"{archive.name} is damaged ({error!r}); get it again") from error


def safe_path(name: str, where: str) -> PurePosixPath:
    """Return the path of a member relative to its folder.

    Raises ObjectFolderError if the path is empty, absolute, very deep or leaves the folder.
    """
    path, problem = PurePosixPath(name.replace("\\", "/")), ""
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts or "\0" in name:
        problem = f"{name!r} would be written outside the folder"
    elif not name or len(path.parts) > MAX_DEPTH:
        wanted = f"expected a name in at most {MAX_DEPTH}"
        problem = f"{name[:100]!r} lies in {len(path.parts)} folders, {wanted}"
    if problem:
        raise ObjectFolderError(f"{where}: member {problem}; the archive is not trustworthy")
    return path


class _Budget:
    """Limits of one archive.

    The sizes that members declare can be trusted: ``tarfile`` and ``zipfile`` read no more than that.
    """

    def __init__(self, archive: str, max_bytes: int, max_members: int):
        self.archive = archive
        self.max_bytes, self.max_members = max_bytes, max_members
        self.bytes = self.members = self.extensions = 0

    def spend(self, name: str, size: int) -> None:
        """Count a file or a folder."""
        self.members += 1
        self.bytes += size
        if self.members > self.max_members:
            many = f"{self.archive} has over {self.max_members} members"
            raise ObjectFolderError(f"{many}; expected one object")
        if size < 0 or self.bytes > self.max_bytes:
            large = f"the archive unpacks to over {self.max_bytes / 2**20:.0f} MB"
            raise ObjectFolderError(f"{self.archive}: {name}: {large}; refused")


class _ZipFile(io.FileIO):
    """A zip whose directory, which ``zipfile`` reads at once, is not too long."""

    def read(self, size: int | None = -1) -> bytes:
        left = os.fstat(self.fileno()).st_size - self.tell()
        if (left if size is None or size < 0 else size) > MAX_DIRECTORY:
            long = f"a directory of over {MAX_DIRECTORY:,} bytes"
            raise ObjectFolderError(f"{Path(str(self.name)).name} has {long}; expected one object")
        return super().read(size) or b""


def _extract_zip(archive: Path, into: Path, budget: _Budget) -> None:
    with _ZipFile(archive) as stream, zipfile.ZipFile(stream) as opened:
        for info in opened.infolist():
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise _refused(archive, info.filename)
            if info.flag_bits & 1:
                name = f"{archive.name}: member {info.filename!r}"
                raise ObjectFolderError(f"{name} is encrypted; unpack it yourself")
            # `orig_filename` is the name in the archive; `filename` is cut at a zero byte.
            path = safe_path(info.orig_filename, archive.name)
            budget.spend(info.filename, info.file_size)
            if not info.is_dir():
                info.filename = str(path)
                opened.extract(info, into)


def _extract_tar(archive: Path, into: Path, budget: _Budget) -> None:
    class Header(tarfile.TarInfo):
        """A header whose extensions, which ``tarfile`` reads into memory, are bounded."""

        def _proc_member(self, opened: Any) -> tarfile.TarInfo:  # for subclasses to override
            if self.type in EXTENSIONS:
                budget.extensions += self.size
                if not 0 <= self.size <= MAX_EXTENSION or budget.extensions > MAX_DIRECTORY:
                    most = f"expected at most {MAX_EXTENSION:,}, and {MAX_DIRECTORY:,} in all"
                    long = f"an extended header of {self.size:,} bytes, {most}"
                    raise ObjectFolderError(f"{archive.name} has {long}; the archive is not trustworthy")
            elif self.type == tarfile.GNUTYPE_SPARSE:
                raise _refused(archive, self.name)
            return super()._proc_member(opened)  # type: ignore[misc]

        def _proc_gnusparse_10(self, member: tarfile.TarInfo, *_: Any) -> None:
            raise _refused(archive, member.name)

    try:
        opened = tarfile.open(archive, tarinfo=Header)  # noqa: SIM115 - closed below
    except ObjectFolderError:
        raise
    except Exception as error:
        unknown = f"{archive.name} is neither a zip nor a tar archive"
        raise ObjectFolderError(f"{unknown}; it is damaged, or another file such as a web page") from error
    with opened:
        for info in opened:
            path = safe_path(info.name, archive.name)
            budget.spend(info.name, info.size)
            info.pax_headers = {}  # `tarfile` keeps all members
            if info.isdir():
                continue  # created with the files in it
            if not info.isreg():
                raise _refused(archive, info.name)
            target = into / path
            target.parent.mkdir(parents=True, exist_ok=True)
            with cast(IO[bytes], opened.extractfile(info)) as source, target.open("wb") as file:
                shutil.copyfileobj(source, file)
        # The checksum of a compressed tar follows the padding, and is verified when that is read.
        for _ in range(MAX_PADDING >> 20):
            if not cast(IO[bytes], opened.fileobj).read(1 << 20):
                return
        raise ObjectFolderError(f"{archive.name} continues after its end; it is not a plain tar archive")


def _refused(archive: Path, name: str) -> ObjectFolderError:
    return ObjectFolderError(f"{archive.name}: member {name!r} is a link, a device or sparse; refused")
