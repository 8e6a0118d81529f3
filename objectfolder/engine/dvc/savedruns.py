"""DVC's run cache, the record of what commands made of which inputs."""

import shutil
from collections.abc import Iterator
from pathlib import Path

from dvc.repo import Repo
from dvc.stage import Stage
from dvc.stage.cache import _can_hash
from dvc.stage.serialize import to_single_stage_lockfile


def saved_run(stage: Stage, changed: bool) -> Stage | None:
    """Find the run whose outputs `steps.restore` would bring back; None if there is none, or not whole.

    Changes nothing on disk.

    Parameters
    ----------
    stage : Stage
        Its dependencies hold the hashes that they will have.
    changed : bool
        Whether command or dependencies differ from the lock file; if not, it says what to bring back.
    """
    cache = stage.repo.stage_cache
    if not _can_hash(stage):
        return None
    if not changed and all(out.hash_info for out in stage.outs):
        entry = to_single_stage_lockfile(stage)
    else:
        entry = cache._load(stage)
    if not entry:
        return None
    found = cache._create_stage(entry, wdir=stage.wdir)
    return found if found.outs_cached() else None


def entries(repo: Repo) -> Iterator[Path]:
    """Files of the run cache."""
    return (path for path in Path(repo.stage_cache.cache_dir).glob("*/*/*") if path.is_file())


def outputs(text: str) -> str:
    """The part of an entry that names the outputs; what comes before names the dependencies."""
    return text.partition("\nouts:\n")[2]


def remove(entry: Path) -> None:
    """Remove an entry; the directory goes with its last one in one step, as DVC cannot read an empty one."""
    if len(list(entry.parent.iterdir())) > 1:
        entry.unlink()
        return
    runs = entry.parents[2]
    trash = entry.parent.rename(runs / f".{entry.parent.name}")  # where `entries` and DVC do not look
    shutil.rmtree(trash)
