"""What a build with nothing to do has found: the next one need only see that nothing was touched since.

DVC takes a second to say so. The note holds the identity of every file and folder of the workspace, of the
package, and of what else DVC has looked at. After a change of any of them, even one that was taken back, a
build asks DVC again: the time of a file's status (``ctime``) cannot be set back.
"""

import fcntl
import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text
from objectfolder.engine.summary import Finished, Listener, Planned, StageOutcome, StageResult, Summary
from objectfolder.workspace.installed import INSTALLED, PACKAGE

NOTES = Path(".dvc/tmp/objectfolder/nothing_to_do.json")
MOST = 8  #: choices of targets that are remembered
CLOCK = 50_000_000  #: ns by which the clock of a file system may be late
#: Environment variables by which DVC finds its settings.
VARIABLES = ("DVC_", "XDG_", "HOME")


def recall(
    targets: Sequence[str] = (), root: str | Path = ".", on_event: Listener = lambda event: None
) -> Summary | None:
    """Return the summary of a build that has nothing to do; None if a build must find out.

    The arguments are those of `objectfolder.engine.build.build`.
    """
    start = time.monotonic()
    root = Path(root).resolve()
    addresses: list[str] | None = None
    # Whatever a note lacks or says wrongly, it is no answer.
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):
        note = json.loads((root / NOTES).read_bytes())[json.dumps([*targets])]
        with (root / ".dvc/tmp/lock").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # else another process uses the workspace
            if _runs_stage(root / ".dvc/tmp/rwlock"):
                return None
            if _identity(root, note["others"])[0] != note["identity"]:
                return None
        addresses = list(note["stages"])
    if addresses is None:
        return None
    on_event(Planned(dict.fromkeys(addresses, 0.0)))
    results = {address: StageResult(address, StageOutcome.SKIPPED) for address in addresses}
    for result in results.values():
        on_event(Finished(result))
    return Summary(results, time.monotonic() - start)


def remember(
    targets: Sequence[str], root: Path, stages: Iterable[str], others: Iterable[str], since: int
) -> None:
    """Note that a build skipped all stages, unless something changed meanwhile.

    ``root``: absolute path of the workspace, whose lock this process holds; ``stages``: addresses, upstream
    first; ``others``: paths outside the workspace's own folders that the build looked at, or missed;
    ``since``: when it began to look, ns since 1970.
    """
    others = sorted(others)
    with suppress(OSError, ObjectFolderError):  # a folder that cannot be written costs time, nothing else
        identity, newest = _identity(root, others)
        if newest >= since - CLOCK:
            return
        name = json.dumps([*targets])
        notes = []
        with suppress(OSError, ValueError, AttributeError):  # none yet, or damaged
            found = json.loads((root / NOTES).read_bytes()).items()
            notes = [(key, note) for key, note in found if key != name][1 - MOST :]
        note = {"identity": identity, "stages": [*stages], "others": others}
        write_text(root / NOTES, json.dumps(dict([*notes, (name, note)])))


def _runs_stage(path: Path) -> bool:
    """Return whether ``dvc repro`` runs a stage, without the lock."""
    return path.exists() and any(json.loads(path.read_bytes()).values())


def _identity(root: Path, others: Sequence[str]) -> tuple[str, int]:
    """Return a digest of the identity of all files, and the time of the last change, ns."""
    variables = sorted(item for item in os.environ.items() if item[0].startswith(VARIABLES))
    digest = hashlib.sha256(repr(variables).encode())
    newest = 0
    listed = chain(_found(root, top=True), _found(INSTALLED / PACKAGE))
    outside = ((path, _stat(path), False) for path in others)
    for path, status, is_listed in chain(listed, outside):
        stamp: tuple[int, ...] = ()
        if status is not None:
            stamp = status.st_dev, status.st_ino, status.st_mode
            if not is_listed:
                stamp += status.st_size, status.st_mtime_ns, status.st_ctime_ns
            newest = max(newest, status.st_ctime_ns)
        digest.update(f"{path}\0{stamp}\0".encode(errors="surrogateescape"))
    return digest.hexdigest(), newest


def _found(folder: Path | str, top: bool = False) -> Iterator[tuple[str, os.stat_result | None, bool]]:
    """Yield a folder, what is in it at any depth, and what links lead to; at the top no hidden folders.

    The third value says whether it is a folder whose content follows: names tell more than its times, which
    change whenever a file comes and goes. Raises OSError if a link leads to a folder, where it would have to
    look, too.
    """
    yield str(folder), Path(folder).stat(), True
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.is_dir(follow_symlinks=False):
                if entry.name != "__pycache__" and not (top and entry.name.startswith(".")):
                    yield from _found(entry.path)
                continue
            yield entry.path, entry.stat(follow_symlinks=False), False
            if entry.is_symlink():
                if entry.is_dir():
                    raise NotADirectoryError(entry.path)
                yield entry.path, _stat(entry.path), False


def _stat(path: str) -> os.stat_result | None:
    with suppress(OSError):
        return Path(path).stat()
    return None
