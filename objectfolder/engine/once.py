"""What DVC does again for every stage, done once while the engine owns the repository.

DVC reads ``params.yaml`` anew for each stage, and rewrites a file of read and write locks around each of its
own calls: with a thousand objects that is most of a build. Nobody else may change the repository's state
while its lock is held, so the first is remembered and the second is not needed. DVC is pinned; the tests
compare what is written with what DVC itself writes.
"""

import copy
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any
from unittest.mock import patch

from dvc.dependency import param

MISSING = object()


@contextmanager
def remembered() -> Iterator[None]:
    """Let DVC remember parameters, and leave out its locks per path; needs the repository's lock."""
    with (
        patch.object(param, "read_param_file", _Params(param.read_param_file)),
        patch("dvc.rwlock.rwlock", lambda *_: nullcontext()),
    ):
        yield


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


def _get(values: Any, key_path: str) -> Any:
    for key in key_path.split("."):
        if not isinstance(values, dict) or key not in values:
            return MISSING
        values = values[key]
    return values
