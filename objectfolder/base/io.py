"""Read and write files; `objectfolder.base.arrays` has those of arrays.

All writers use `atomic`, so a file is either absent or complete. All readers check their input and name the
file in errors.
"""

import codecs
import errno
import hashlib
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from objectfolder.base.disk import FULL_BELOW, free_bytes, is_shortage
from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.locks import claim_file, private_path

#: First bytes of what servers and checkouts leave in place of a file.
STRAY = {
    b"<": "XML or HTML",
    b"version https://git-lfs": "a Git LFS pointer, not the file itself: run `git lfs pull`",
    b"\x1f\x8b": "a .gz archive",
}


def content_hint(path: str | Path, kinds: Mapping[bytes, str] = STRAY) -> str:
    """Return what a file looks like that its reader refuses, for the error's message; or nothing.

    ``kinds``: words for the bytes that files may begin with, after spaces.
    """
    try:
        with Path(path).open("rb") as stream:
            head = stream.read(64).removeprefix(codecs.BOM_UTF8).lstrip()
    except OSError:
        return ""
    found = [kind for start, kind in kinds.items() if head.startswith(start)]
    return f" (its content looks like {found[0]})" if found else ""


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to ``path``; on success, fsync the file and rename it into place.

    The temporary file is new, its name is drawn at random, and it has the same suffix, because writers choose
    the format by it. So no link is followed that somebody else made: one at ``path`` is replaced. Of several
    who write the same path the last one wins. What killed writers leave, the next process that writes in the
    folder removes.

    Raises ObjectFolderError if the directory cannot be written, or the path is a folder or a device. Raises
    OSError of the block, or of a full disk that the block met, which names ``path``.
    """
    with _replace(Path(path)) as (temporary, _):
        yield temporary
        with temporary.open("rb") as stream:  # a library may have replaced the file
            os.fsync(stream.fileno())


@contextmanager
def atomic_stream(path: str | Path) -> Iterator[BinaryIO]:
    """Yield a stream to write a file; otherwise like `atomic`.

    Nobody can divert it: the file stays open from when it is made.
    """
    with _replace(Path(path)) as (_, handle), os.fdopen(handle, "wb", closefd=False) as stream:
        yield stream
        stream.flush()
        os.fsync(handle)


@contextmanager
def _replace(path: Path) -> Iterator[tuple[Path, int]]:
    """Yield a new file beside ``path`` and its descriptor; then rename it into place, or remove it."""
    temporary, lock = _claim(path)
    try:
        yield temporary, lock
        temporary.replace(path)
    except BaseException as error:
        # What torch, numpy and Pillow raise if a disk is full has no number.
        vague = isinstance(error, RuntimeError) or (isinstance(error, OSError) and error.errno is None)
        full = vague and free_bytes(path.parent) < FULL_BELOW
        temporary.unlink(missing_ok=True)
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
        if isinstance(error, OSError) and (is_shortage(error) or error.filename in (None, str(temporary))):
            error.filename = str(path)
            del error.filename2
        raise
    finally:
        os.close(lock)


def check_output(path: str | Path) -> None:
    """Raise ObjectFolderError unless a file can be written at a path: before work that takes long."""
    temporary, lock = _claim(Path(path))
    temporary.unlink(missing_ok=True)
    os.close(lock)


def _claim(path: Path) -> tuple[Path, int]:
    """Return a new file beside ``path``, whose folder is made, and a descriptor that locks it."""
    if not path.name:
        raise ObjectFolderError(f"cannot write {str(path)!r}: it is a folder, expected a file's name")
    try:
        if path.exists() and not path.is_file():
            other = "it is a folder or a device, expected a file's name"
            raise ObjectFolderError(f"cannot write {path}: {other}")
        try:
            return claim_file(path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            return claim_file(path)
    except OSError as error:
        folder = shortened(path.parent, 300)
        writable = f"make the directory {folder} writable"
        advice = f"make space on the disk of {folder}" if is_shortage(error) else writable
        problem = f"cannot write {shortened(path, 300)}: {error.strerror}"
        raise ObjectFolderError(f"{problem}; {advice}, or choose another name") from error


def write_json(path: str | Path, value: Any) -> None:
    """Write JSON with sorted keys."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write text."""
    write_bytes(path, text.encode())


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write bytes."""
    with atomic_stream(path) as stream:
        stream.write(content)


def write_table(path: str | Path, columns: list[str], rows: list[list[Any]]) -> None:
    """Write rows of numbers as CSV."""
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    write_text(path, "\n".join([",".join(columns), *lines]) + "\n")


def write_curve(path: str | Path, curve: list[Any]) -> None:
    """Write a training curve (`nets.fit.CurvePoint`) as CSV, without times: equal inputs give equal bytes."""
    rows = [[p.step, p.train_loss, p.val_loss] for p in curve]
    write_table(path, ["step", "train_loss", "val_loss"], rows)


def keep(path: str | Path, name: str | Path) -> None:
    """Hard-link a file to a second name, or copy it where links are impossible."""
    if Path(name).exists() and Path(name).samefile(path):
        return  # of two names of a file, a rename would leave the temporary one
    with atomic(name) as temporary:
        linked = private_path(Path(name))
        try:
            os.link(path, linked)
        except OSError:
            shutil.copyfile(path, temporary)
        else:
            linked.replace(temporary)


def file_digest(path: str | Path) -> str:
    """Return the SHA-256 digest of a file in hexadecimal."""
    with existing_file(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_json(path: str | Path) -> Any:
    """Read a JSON file; raises ObjectFolderError if it is missing or damaged."""
    path = existing_file(path)
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise ObjectFolderError(f"{path} is damaged ({error}); delete it and rebuild") from error


def parse_json(text: str | bytes) -> Any:
    """Parse JSON, without the extensions and the ambiguities that Python accepts."""
    return json.loads(text, parse_constant=_no_number, object_pairs_hook=unique_names)


def unique_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return values by name; raises ValueError if a name is there twice."""
    values = dict(pairs)
    if len(values) < len(pairs):
        [(name, times)] = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"it holds {shortened(repr(name))} {times} times, expected once")
    return values


def _no_number(name: str) -> None:
    raise ValueError(f"its header holds {name}, which is not JSON")


def existing_file(path: str | Path, hint: str = "build it with `objectfolder build`") -> Path:
    """Return a path; raises ObjectFolderError, with what to do, unless it is that of a file."""
    path = Path(path)
    try:
        problem = None if path.is_file() else "does not exist"
        if problem and path.exists():
            problem, hint = "is a folder" if path.is_dir() else "is a device", "expected a file"
    except OSError as error:  # a name that is too long, a folder without permission
        problem = f"cannot be read: {error.strerror}"
    if problem:
        raise ObjectFolderError(f"{shortened(path, 300)} {problem}; {hint}")
    return path
