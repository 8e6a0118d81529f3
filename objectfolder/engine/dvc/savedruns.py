"""Entries of DVC's run cache: which outputs a command produced from which inputs."""

import shutil
from collections.abc import Iterator
from pathlib import Path

from dvc.repo import Repo
from dvc.stage import Stage
from dvc.stage.cache import _can_hash
from dvc.stage.serialize import to_single_stage_lockfile

from objectfolder.locks import private_path


def saved_run(stage: Stage, changed: bool) -> Stage | None:
    """Find the run whose outputs `steps.restore_run` would restore; None if missing or incomplete.

    Changes nothing on disk.

    Parameters
    ----------
    stage : Stage
        Its dependencies hold the hashes that they will have when it runs.
    changed : bool
        Whether command or dependencies differ from the lock file; if not, the lock file names the outputs.
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


def saved_runs(repo: Repo) -> Iterator[Path]:
    """Yield the files of the run cache, one per saved run."""
    return (path for path in Path(repo.stage_cache.cache_dir).glob("*/*/*") if path.is_file())


def saved_outputs(text: str) -> str:
    """Return the part of an entry that lists the outputs; dependencies come before it."""
    return text.partition("\nouts:\n")[2]


def remove_saved_run(entry: Path) -> None:
    """Remove an entry, with its directory if it is the last one: DVC cannot read an empty directory."""
    if len(list(entry.parent.iterdir())) > 1:
        entry.unlink()
        return
    trash = private_path(entry.parents[2] / entry.parent.name)  # ignored by `saved_runs` and DVC
    entry.parent.rename(trash)
    shutil.rmtree(trash)
