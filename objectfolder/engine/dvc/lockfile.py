"""``dvc.lock``, parsed at most once and written in batches.

DVC rewrites the whole file after every stage, which is quadratic, and parses it at every start. The holder of
the repository's lock is the only writer, so the contents stay in memory and are written periodically; the
text of an unchanged stage is reused. A JSON copy under ``.dvc/tmp``, which loads a hundred times faster than
YAML, replaces the parser, and the file itself if that is damaged.
"""

import hashlib
import json
import logging
import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dvc.stage import PipelineStage, Stage
from dvc.stage.serialize import to_lockfile
from dvc.utils.serialize import EncodingError, dumps_yaml
from dvc.utils.strictyaml import YAMLSyntaxError, YAMLValidationError

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text

PERIOD = 5.0
# With thousands of stages a write takes seconds; this bounds its share of the build time.
PERIOD_PER_WRITE = 20.0
COPIES = Path(".dvc/tmp/objectfolder")
HEAD = "schema: '2.0'\nstages:\n"
_STAGE = re.compile(r"^  (?=\S)", re.MULTILINE)
_log = logging.getLogger(__name__)
WIDTH = 80  # where the emitter folds lines
# Strings that need no quotes. Everything else needs the full emitter.
_PLAIN = re.compile(r"[A-Za-z/][\w./@-]*(?: [A-Za-z/-][\w./@-]*)*", re.ASCII)
_WORDS = {"true", "false", "null"}
_DIGEST = re.compile(r"[0-9a-f]{32}(?:\.dir)?")
_NUMBER = re.compile(r"[0-9]+(?:e[0-9]+)?")


class LockFiles:
    """Contents of the lock files of a workspace, including finished stages not written yet.

    ``root``: directory that holds ``.dvc``.
    """

    def __init__(self, root: Path):
        self._root = root
        self._contents: dict[Path, dict[str, Any]] = {}
        self._text: dict[Path, dict[str, str]] = {}
        self._dirty: set[Path] = set()
        self._due = 0.0
        self._period = PERIOD

    def add(self, stage: Stage) -> None:
        """Record the state of a finished stage; `flush` writes it."""
        if not isinstance(stage, PipelineStage):
            stage.dump(update_pipeline=False)  # a .dvc file holds a single stage
            return
        path = Path(stage.dvcfile.path).absolute().with_suffix(".lock")
        entry = to_lockfile(stage)
        self.stages(path).update(entry)
        self._text[path].pop(stage.name, None)
        stage.repo.scm_context.track_file(os.path.relpath(path))
        if not self._dirty:
            self._due = time.monotonic() + self._period
        self._dirty.add(path)

    def remove(self, path: Path, name: str) -> None:
        """Remove the entry of a stage; `flush` writes the change."""
        if self.stages(path).pop(name, None) is not None:
            self._dirty.add(path)

    def flush_if_due(self) -> None:
        """Write pending changes if the last write was long enough ago."""
        if self._dirty and time.monotonic() >= self._due:
            self.flush()

    def flush(self) -> None:
        """Write all pending changes."""
        start = time.monotonic()
        for path in sorted(self._dirty):
            self._write(path)
            self._dirty.discard(path)
        self._period = max(PERIOD, PERIOD_PER_WRITE * (time.monotonic() - start))

    def seconds_until_due(self) -> float | None:
        """Return the time until the next write; None if nothing is pending."""
        return max(0.0, self._due - time.monotonic()) if self._dirty else None

    def stages(self, path: Path) -> dict[str, Any]:
        """Return the entries of a lock file by stage, including those added since it was read."""
        if path not in self._contents:
            self._contents[path], self._text[path] = {"schema": "2.0"}, {}
        return self._contents[path].setdefault("stages", {})

    def read(self, path: Path, parse: Callable[[], tuple[Any, str]]) -> tuple[Any, str]:
        """Return contents and text of a lock file, parsing it with DVC only if no valid copy exists."""
        if not path.exists():
            return parse()
        text = path.read_bytes()
        copy = self._copy(path)
        if copy is not None and copy["sha256"] == hashlib.sha256(text).hexdigest():
            contents = copy["contents"]
        else:
            try:
                contents = parse()[0]
                if not contents and copy is not None:
                    raise ObjectFolderError("it is empty")
            except (YAMLSyntaxError, YAMLValidationError, EncodingError, ObjectFolderError) as error:
                if copy is None or b"<<<<<<<" in text:  # a merge conflict is the user's to resolve
                    raise
                contents = self._restore(path, copy, error)
                text = path.read_bytes()
            self._write_copy(path, contents, text)
        self._contents[path] = contents
        self._text[path] = _split(text.decode(), contents)
        return contents, text.decode()

    def _restore(self, path: Path, copy: dict[str, Any], error: Exception) -> Any:
        broken = path.with_name(path.name + ".damaged")
        path.replace(broken)
        _log.warning(
            "%s is damaged (%s); restored from the last build, the damaged file is kept as %s",
            path,
            getattr(error, "__cause__", None) or error,
            broken.name,
        )
        self._contents[path], self._text[path] = copy["contents"], {}
        self._write(path)
        return copy["contents"]

    def _write(self, path: Path) -> None:
        contents = self._contents[path]
        if set(contents) == {"schema", "stages"} and contents["stages"]:
            texts = self._text[path]
            for name, entry in contents["stages"].items():
                if name not in texts:
                    texts[name] = lock_yaml({"stages": {name: entry}}).removeprefix("stages:\n")
            text = HEAD + "".join(texts[name] for name in contents["stages"])
        else:
            text = lock_yaml(contents)
        write_text(path, text)
        self._write_copy(path, contents, text.encode())

    def _copy_path(self, path: Path) -> Path:
        name = path.relative_to(self._root).as_posix().replace("/", "__")
        return self._root / COPIES / f"{name}.json"

    def _copy(self, path: Path) -> dict[str, Any] | None:
        try:
            copy = json.loads(self._copy_path(path).read_bytes())
        except (OSError, ValueError):
            return None
        return copy if isinstance(copy, dict) and set(copy) == {"sha256", "contents"} else None

    def _write_copy(self, path: Path, contents: Any, text: bytes) -> None:
        copy = {"sha256": hashlib.sha256(text).hexdigest(), "contents": contents}
        dumped = json.dumps(copy)
        if json.loads(dumped) == copy:  # numeric keys of parameters would become strings
            write_text(self._copy_path(path), dumped)
        else:
            self._copy_path(path).unlink(missing_ok=True)


def _split(text: str, contents: dict[str, Any]) -> dict[str, str]:
    """Return the text of every stage by name; empty if the layout is not that of DVC."""
    if set(contents) != {"schema", "stages"} or not text.startswith(HEAD):
        return {}
    chunks = _STAGE.split(text[len(HEAD) :])[1:]
    names = list(contents["stages"])
    if len(chunks) != len(names) or not all(
        chunk.startswith((f"{name}:", f"'{name}':", f'"{name}":')) for name, chunk in zip(names, chunks)
    ):
        return {}
    return {name: f"  {chunk}" for name, chunk in zip(names, chunks)}


class _NeedsEmitter(Exception):
    """A value that needs the full emitter."""


def lock_yaml(value: dict[str, Any]) -> str:
    """Return nested mappings and lists as YAML, as `dvc.utils.serialize.dumps_yaml` does."""
    try:
        return "".join(f"{line}\n" for line in _mapping(value, ""))
    except _NeedsEmitter:
        return str(dumps_yaml(value))


def _mapping(value: dict[str, Any], indent: str) -> Iterator[str]:
    for key, item in value.items():
        start = f"{indent}{_scalar(key)}:"
        if isinstance(item, dict) and item:
            yield start
            yield from _mapping(item, f"{indent}  ")
        elif isinstance(item, list) and item:
            yield start
            yield from _list(item, indent)
        else:
            yield _fitting(start if item is None else f"{start} {_scalar(item)}")


def _list(items: list[Any], indent: str) -> Iterator[str]:
    for item in items:
        if isinstance(item, dict) and item:
            first, *rest = _mapping(item, f"{indent}  ")
            yield f"{indent}- {first.lstrip()}"
            yield from rest
        else:
            yield _fitting(f"{indent}- {_scalar(item)}")


def _scalar(value: Any) -> str:
    kind = type(value)
    if kind is int:
        return str(value)
    if kind is bool:
        return "true" if value else "false"
    if kind is float and 1e-4 <= abs(value) < 1e15:
        return repr(value)
    if kind is str and _DIGEST.fullmatch(value):
        return f"'{value}'" if _NUMBER.fullmatch(value) else value
    if kind is str and _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    raise _NeedsEmitter


def _fitting(line: str) -> str:
    if len(line) > WIDTH and " " in line.strip():
        raise _NeedsEmitter
    return line
