"""Entries of DVC's run cache: which outputs a command produced from which inputs."""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from dvc.repo import Repo
from dvc.stage import Stage
from dvc.stage.cache import StageCache, _can_hash, _get_cache_hash
from dvc.stage.serialize import to_single_stage_lockfile

from objectfolder.locks import private_path
from objectfolder.workspace.params import UNSEEN_BY_DVC


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


def saved_runs_of(cache: StageCache, key: str) -> list[Path]:
    """Return the files of the saved runs of a key, newest first."""
    found = []
    for path in Path(cache._get_cache_dir(key)).glob("[!.]*"):
        with suppress(FileNotFoundError):  # a pruning of a cache that workspaces share
            found.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(found, reverse=True)]


def recorded_inputs(entry: Mapping[str, Any]) -> str:
    """Return command, dependencies and parameters of an entry as a text that tells equal types and values."""
    deps = {dep["path"]: dep.get(dep.get("hash", "md5")) for dep in entry.get("deps", ())}
    return json.dumps([entry["cmd"], deps, entry.get("params", {})], sort_keys=True, default=str)


def maker(cache: StageCache, record: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the saved run of a record's outputs if it had other inputs than those recorded; else None.

    ``dvc repro`` records such outputs if a parameter is called ``size`` or ``nfiles``.
    """
    if not _has_unseen(record.get("params")):  # the key tells all others apart
        return None
    key = _get_cache_hash(dict(record), key=True)
    runs = (cache._load_cache(key, path.name) for path in saved_runs_of(cache, key))
    made = [run for run in runs if run is not None and run["outs"] == record["outs"]]
    inputs = recorded_inputs(record)
    return made[0] if made and all(recorded_inputs(run) != inputs for run in made) else None


def _has_unseen(value: Any) -> bool:
    if isinstance(value, list):
        return any(map(_has_unseen, value))
    return isinstance(value, dict) and (
        any(name in value for name in UNSEEN_BY_DVC) or _has_unseen(list(value.values()))
    )


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
