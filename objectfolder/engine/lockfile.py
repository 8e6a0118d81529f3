"""Batched, atomic writes of ``dvc.lock``.

DVC rewrites the whole file after every stage, which is quadratic. Whoever holds the repository's lock is the
only writer, so the contents stay in memory and go to disk now and then.
"""

import os
import time
from pathlib import Path
from typing import Any

from dvc.stage import PipelineStage, Stage
from dvc.stage.serialize import to_lockfile
from dvc.utils.serialize import dump_yaml, load_yaml

from objectfolder.artifacts import atomic

PERIOD = 5.0
# With thousands of stages a write takes seconds; this bounds its share of the build's time.
PERIOD_PER_WRITE = 20.0


class LockFiles:
    """States of finished stages on their way to disk."""

    def __init__(self) -> None:
        self._contents: dict[Path, dict[str, Any]] = {}
        self._dirty: set[Path] = set()
        self._due = 0.0
        self._period = PERIOD

    def add(self, stage: Stage) -> None:
        """Record the state of a finished stage; it reaches the disk at the next `flush`."""
        if not isinstance(stage, PipelineStage):
            stage.dump(update_pipeline=False)  # a .dvc file holds one stage: nothing to batch
            return
        path = Path(stage.dvcfile.path).with_suffix(".lock")
        if path not in self._contents:
            written = load_yaml(path) if path.exists() else {}
            self._contents[path] = {"schema": "2.0", **written}
        self._contents[path].setdefault("stages", {}).update(to_lockfile(stage))
        stage.repo.scm_context.track_file(os.path.relpath(path))
        if not self._dirty:
            self._due = time.monotonic() + self._period
        self._dirty.add(path)

    def flush_if_due(self) -> None:
        """Write what has waited long enough."""
        if self._dirty and time.monotonic() >= self._due:
            self.flush()

    def flush(self) -> None:
        """Write everything that is not on disk yet."""
        start = time.monotonic()
        for path in sorted(self._dirty):
            with atomic(path) as temporary:
                dump_yaml(temporary, self._contents[path])
            self._dirty.discard(path)
        self._period = max(PERIOD, PERIOD_PER_WRITE * (time.monotonic() - start))

    def seconds_until_due(self) -> float | None:
        """Time until the next write; None if there is nothing to write."""
        return max(0.0, self._due - time.monotonic()) if self._dirty else None
