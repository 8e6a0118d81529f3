"""The only place that replaces parts of DVC, for as long as the engine holds a repository's lock.

DVC parses ``params.yaml`` for every stage, queries its hash database each time a stage mentions a file,
rewrites a file of read and write locks around each of its calls, commits a transaction for every output that
it checks out, and parses ``dvc.lock`` at every start. With a thousand objects, that dominates a build. While
the lock is held nobody else changes the repository, so parsed files and hashes are cached until the file
changes, the inner locks are skipped, and transactions are batched. One replacement is not for speed: DVC's
database takes files of equal inode, size and time of modification for the same file.

DVC is pinned. tests/engine/dvc/test_contract.py checks each replaced name and its signature.
"""

import copy
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from dvc import rwlock
from dvc.dependency import param
from dvc.dvcfile import Lockfile
from dvc.output import Output
from dvc.utils import serialize
from dvc_data.hashfile import state as hash_state
from dvc_data.hashfile.state import State
from dvc_objects.fs.utils import relpath

from objectfolder.engine.dvc.lockfile import LockFiles, lock_yaml
from objectfolder.workspace.params import name_as_today

#: Version of DVC whose internals this package knows.
DVC_VERSION = "3.67.1"
#: What `replacements` replaces: (owner, attribute).
REPLACED: tuple[tuple[Any, str], ...] = (
    (param, "read_param_file"),
    (rwlock, "rwlock"),
    (State, "set_link"),
    (hash_state, "_checksum"),
    (serialize, "dump_yaml"),
    (Output, "_get_hash_meta"),
    (Lockfile, "_load"),
)
MISSING = object()


@contextmanager
def replacements(lockfiles: LockFiles) -> Iterator[None]:
    """Replace slow parts of DVC until the block ends; requires the repository's lock."""
    links: dict[State, dict[str, Any]] = {}
    parse = Lockfile._load

    def set_link(state: State, path: str, inode: int, mtime: str) -> None:
        links.setdefault(state, {})[relpath(path, state.root_dir)] = inode, mtime

    def load_lockfile(lockfile: Lockfile, **kwargs: Any) -> tuple[Any, str]:
        return lockfiles.read(Path(lockfile.path).absolute(), lambda: parse(lockfile, **kwargs))

    values = (
        _Params(param.read_param_file),
        lambda *_: nullcontext(),
        set_link,
        _with_status_time(hash_state._checksum),
        lambda path, data: Path(path).write_text(lock_yaml(data)),
        _cached_hashes(Output._get_hash_meta),
        load_lockfile,
    )
    with ExitStack() as restore:
        for (owner, name), value in zip(REPLACED, values, strict=True):
            restore.callback(setattr, owner, name, vars(owner)[name])
            setattr(owner, name, value)
        try:
            yield
        finally:
            for state, entries in links.items():
                with state.links as table:
                    for path, entry in entries.items():
                        table[path] = entry


class _Params:
    """`dvc.dependency.param.read_param_file` that parses a file only if it has changed."""

    def __init__(self, read: Any):
        self._read = read
        self._files: dict[str, tuple[tuple[int, int, int], Any]] = {}

    def __call__(
        self, fs: Any, path: str, key_paths: list[str] | None = None, flatten: bool = False, **kwargs: Any
    ) -> Any:
        # A plain path of keys is looked up directly; patterns are left to DVC.
        if not flatten or not key_paths or any(set(key) & set("*?[]") for key in key_paths):
            return self._read(fs, path, key_paths, flatten, **kwargs)
        values = self._load(fs, path, **kwargs)
        found = {key: _get(values, key) for key in key_paths}
        return {key: copy.deepcopy(value) for key, value in found.items() if value is not MISSING}

    def _load(self, fs: Any, path: str, **kwargs: Any) -> Any:
        info = fs.info(path)
        stamp = info["mtime"], info["size"], info["ino"]
        if path not in self._files or self._files[path][0] != stamp:
            values = self._read(fs, path, None, **kwargs)
            name_as_today(values)  # as stages read them
            self._files[path] = stamp, values
        return self._files[path][1]


def _cached_hashes(get_hash_meta: Any) -> Any:
    """Wrap `Output._get_hash_meta` to hash a file only if it has changed, as DVC's database decides."""
    hashes: dict[tuple[str, str], tuple[tuple[int, int, int, int], Any]] = {}

    def cached(out: Output) -> Any:
        if out.protocol != "local":
            return get_hash_meta(out)
        status = Path(out.fs_path).stat()
        if not stat.S_ISREG(status.st_mode):
            return get_hash_meta(out)
        stamp = status.st_mtime_ns, status.st_ino, status.st_size, status.st_ctime_ns
        key = out.fs_path, out.hash_name
        if key not in hashes or hashes[key][0] != stamp:
            hashes[key] = stamp, get_hash_meta(out)
        return hashes[key][1]

    return cached


def _with_status_time(checksum: Any) -> Any:
    """Wrap the identity of a file in DVC's database of hashes, which time of modification and size are.

    Both may stay what they were: `cp -p` and `rsync --inplace -t` write the same file again, and archives
    give all of their files one time. The time of its status cannot be set back; see `inputs.stamps`.
    """

    def identify(info: dict[str, Any]) -> Any:
        linked = info["islink"] or info["nlink"] > 1
        return checksum({**info, "mtime": (info["mtime"], 0 if linked else info["created"])})

    return identify


def _get(values: Any, key_path: str) -> Any:
    for key in key_path.split("."):
        if not isinstance(values, dict) or key not in values:
            return MISSING
        values = values[key]
    return values
