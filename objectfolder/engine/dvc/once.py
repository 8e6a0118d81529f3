"""What DVC does again for every stage, done once while the engine owns the repository.

DVC reads ``params.yaml`` anew for each stage, asks its database for a file's hash each time that a stage
mentions it, rewrites a file of read and write locks around each of its own calls, and commits a transaction
for each output that it checks out: with a thousand objects that is most of a build. Nobody else may change
the repository's state while its lock is held, so the first two are remembered (until the file changes), the
third is not needed, and the fourth waits for the end. DVC is pinned; the tests compare what is written with
what DVC itself writes.
"""

import copy
import stat
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

from dvc.dependency import param
from dvc.output import Output
from dvc_data.hashfile.state import State
from dvc_objects.fs.utils import relpath

from objectfolder.engine.dvc import emit

MISSING = object()


@contextmanager
def remembered() -> Iterator[None]:
    """Let DVC work so; needs the repository's lock."""
    links: dict[State, dict[str, Any]] = {}

    def set_link(state: State, path: str, inode: int, mtime: str) -> None:
        links.setdefault(state, {})[relpath(path, state.root_dir)] = inode, mtime

    with (
        patch.object(param, "read_param_file", _Params(param.read_param_file)),
        patch("dvc.rwlock.rwlock", lambda *_: nullcontext()),
        patch.object(State, "set_link", set_link),
        patch("dvc.utils.serialize.dump_yaml", lambda path, data: Path(path).write_text(emit.dumps(data))),
        patch.object(Output, "_get_hash_meta", _remember_hashes(Output._get_hash_meta)),
    ):
        try:
            yield
        finally:
            for state, entries in links.items():
                with state.links as table:
                    for path, entry in entries.items():
                        table[path] = entry


class _Params:
    """`dvc.dependency.param.read_param_file` that parses a file again only if it has changed."""

    def __init__(self, read: Any):
        self._read = read
        self._files: dict[str, tuple[tuple[int, int, int], Any]] = {}

    def __call__(
        self, fs: Any, path: str, key_paths: list[str] | None = None, flatten: bool = False, **kwargs: Any
    ) -> Any:
        # DVC's own names may be patterns; a plain path of keys is looked up directly.
        if not flatten or not key_paths or any(set(key) & set("*?[]") for key in key_paths):
            return self._read(fs, path, key_paths, flatten, **kwargs)
        values = self._load(fs, path, **kwargs)
        found = {key: _get(values, key) for key in key_paths}
        return {key: copy.deepcopy(value) for key, value in found.items() if value is not MISSING}

    def _load(self, fs: Any, path: str, **kwargs: Any) -> Any:
        info = fs.info(path)
        stamp = info["mtime"], info["size"], info["ino"]
        if path not in self._files or self._files[path][0] != stamp:
            self._files[path] = stamp, self._read(fs, path, None, **kwargs)
        return self._files[path][1]


def _remember_hashes(get_hash_meta: Any) -> Any:
    """`Output._get_hash_meta` that asks again only if the file has changed, as DVC's database would tell."""
    hashes: dict[tuple[str, str], tuple[tuple[int, int, int], Any]] = {}

    def remembering(out: Output) -> Any:
        if out.protocol != "local":
            return get_hash_meta(out)
        status = Path(out.fs_path).stat()
        if not stat.S_ISREG(status.st_mode):
            return get_hash_meta(out)
        stamp = status.st_mtime_ns, status.st_ino, status.st_size
        key = out.fs_path, out.hash_name
        if key not in hashes or hashes[key][0] != stamp:
            hashes[key] = stamp, get_hash_meta(out)
        return hashes[key][1]

    return remembering


def _get(values: Any, key_path: str) -> Any:
    for key in key_path.split("."):
        if not isinstance(values, dict) or key not in values:
            return MISSING
        values = values[key]
    return values
