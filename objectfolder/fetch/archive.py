"""Safely extract untrusted archives: no links, devices or paths outside the folder; bounded size."""

import lzma
import shutil
import stat
import tarfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, cast

from objectfolder.errors import ObjectFolderError

SUFFIXES = (".tar.gz", ".tar.xz", ".tar.bz2", ".tgz", ".zip", ".tar")
MAX_BYTES = 2 << 30  #: extracted
MAX_MEMBERS = 10_000
MAX_PADDING = 64 << 20  #: after the end of a tar

DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    OSError,
    NotImplementedError,
)


def extract(archive: Path, into: Path, max_bytes: int = MAX_BYTES, max_members: int = MAX_MEMBERS) -> None:
    """Extract a zip or tar archive.

    The extraction filter of ``tarfile`` only sets safe permissions and owners here: it would extract links
    inside the folder and absolute paths, and knows no limits.

    Parameters
    ----------
    archive : Path
        The format is recognised by content.
    into : Path
        New directory; removed again on error.
    max_bytes : int
        Maximum extracted size.
    max_members : int
        Maximum number of members.

    Raises
    ------
    ObjectFolderError
        If it is damaged, not an archive, too large, or has a member that is a link, a device, encrypted, or
        outside the folder; the message names archive and member.
    """
    into.mkdir(parents=True)
    budget = _Budget(archive.name, max_bytes, max_members)
    try:
        if zipfile.is_zipfile(archive):
            _extract_zip(archive, into, budget)
        elif _is_tar(archive):
            _extract_tar(archive, into, budget)
        else:
            raise ObjectFolderError(
                f"{archive.name} is neither a zip nor a tar archive; it is damaged, or another file such as "
                "a web page"
            )
    except DAMAGE as error:
        shutil.rmtree(into, ignore_errors=True)
        if isinstance(error, OSError) and error.errno is not None:  # of the file system, not of a decoder
            raise ObjectFolderError(f"{archive.name} cannot be unpacked: {error}") from error
        raise ObjectFolderError(f"{archive.name} is damaged ({error}); get it again") from error
    except BaseException:
        shutil.rmtree(into, ignore_errors=True)
        raise


def safe_path(name: str, where: str) -> PurePosixPath:
    """Return the path of a member relative to its folder.

    Raises
    ------
    ObjectFolderError
        If the path is absolute or leaves the folder.
    """
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts or "\0" in name:
        raise ObjectFolderError(
            f"{where}: member {name!r} would be written outside the folder; the archive is not trustworthy"
        )
    return path


class _Budget:
    """Limits of one archive.

    The sizes that members declare can be trusted: ``tarfile`` and ``zipfile`` read no more than that.
    """

    def __init__(self, archive: str, max_bytes: int, max_members: int):
        self.archive = archive
        self.max_bytes, self.max_members = max_bytes, max_members
        self.bytes = self.members = 0

    def spend(self, name: str, size: int) -> None:
        """Count a file."""
        self.members += 1
        self.bytes += size
        if self.members > self.max_members:
            raise ObjectFolderError(
                f"{self.archive} has over {self.max_members} members; expected one object"
            )
        if self.bytes > self.max_bytes:
            raise ObjectFolderError(
                f"{self.archive}: {name}: the archive unpacks to over {self.max_bytes / 2**20:.0f} MB; "
                "refused"
            )


def _is_tar(archive: Path) -> bool:
    try:
        return tarfile.is_tarfile(archive)
    except DAMAGE:
        return False


def _extract_zip(archive: Path, into: Path, budget: _Budget) -> None:
    with zipfile.ZipFile(archive) as opened:
        for info in opened.infolist():
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise _refused(archive, info.filename)
            if info.flag_bits & 1:
                raise ObjectFolderError(
                    f"{archive.name}: member {info.filename!r} is encrypted; unpack it yourself"
                )
            # `orig_filename` is the name in the archive; `filename` is cut at a zero byte.
            path = safe_path(info.orig_filename, archive.name)
            if not info.is_dir():
                budget.spend(info.filename, info.file_size)
                info.filename = str(path)
                opened.extract(info, into)


def _extract_tar(archive: Path, into: Path, budget: _Budget) -> None:
    def check(info: tarfile.TarInfo, folder: str) -> tarfile.TarInfo | None:
        path = safe_path(info.name, archive.name)
        if info.isdir():
            return None  # created with the files in it
        if not info.isreg():
            raise _refused(archive, info.name)
        budget.spend(info.name, info.size)
        return tarfile.data_filter(info.replace(name=str(path), deep=False), folder)

    with tarfile.open(archive) as opened:
        opened.extractall(into, filter=check)
        # The checksum of a compressed tar follows the padding, and is verified when that is read.
        for _ in range(MAX_PADDING >> 20):
            if not cast(IO[bytes], opened.fileobj).read(1 << 20):
                return
        raise ObjectFolderError(f"{archive.name} goes on after its end; it is not a plain tar archive")


def _refused(archive: Path, name: str) -> ObjectFolderError:
    return ObjectFolderError(f"{archive.name}: member {name!r} is a link or a device; refused")
