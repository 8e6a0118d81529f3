"""DVC's run cache, extended to verify what it restores and to pull what is missing."""

import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from dvc.output import Output
from dvc.repo import Repo
from dvc.schema import COMPILED_LOCK_FILE_STAGE_SCHEMA
from dvc.stage import PipelineStage, Stage
from dvc.stage.cache import StageCache, _can_hash, _get_cache_hash, _get_stage_hash
from dvc.stage.serialize import to_single_stage_lockfile
from dvc.utils.serialize import EncodingError, ParseError, load_yaml
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.tree import Tree
from voluptuous import Invalid

from objectfolder.base.locks import private_path
from objectfolder.engine.dvc.remote import pull_outputs
from objectfolder.workspace.params import UNSEEN_BY_DVC

_log = logging.getLogger(__name__)


def find_saved_run(stage: Stage, changed: bool) -> Stage | None:
    """Find the run whose outputs `steps.restore_run` would restore; None if missing or incomplete.

    Changes nothing on disk. The stage's dependencies hold the hashes that they will have when it runs.
    ``changed`` says whether command or dependencies differ from the lock file; if not, it names the outputs.
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


def read_entry(path: Path) -> Any:
    """Return the content of a saved run, a .dvc file or a lock file; None if it is damaged."""
    try:
        return load_yaml(path)
    except (ParseError, EncodingError):
        return None


def outputs_of(run: Any) -> list[Mapping[str, Any]]:
    """Return the outputs that a saved run lists; none of a damaged one, which is never restored."""
    return run.get("outs") or [] if isinstance(run, Mapping) else []


def hashes_in(value: Any) -> Iterator[str]:
    """Yield the hashes of files that a record names, at any depth."""
    if isinstance(value, list):
        for each in value:
            yield from hashes_in(each)
    elif isinstance(value, Mapping):
        if isinstance(oid := value.get("md5"), str):
            yield oid
        yield from hashes_in(list(value.values()))


def remove_saved_run(entry: Path) -> None:
    """Remove an entry, with its directory if it is the last one: DVC cannot read an empty directory."""
    if len(list(entry.parent.iterdir())) > 1:
        entry.unlink()
        return
    trash = private_path(entry.parents[2] / entry.parent.name)  # ignored by `saved_runs` and DVC
    entry.parent.rename(trash)
    shutil.rmtree(trash)


class RunCache(StageCache):
    """Replacement for ``repo.stage_cache``.

    DVC trusts a read-only cached file and records the expected hash for the copy without computing it: a
    damaged object would be restored and recorded as valid. It trusts entries, too, and the key by which it
    finds them, which leaves out parameters called ``size`` or ``nfiles``: it would restore what another size
    gave. Damaged objects and entries are removed if it ``restores`` outputs; else nothing changes. With
    ``pull``, missing cached objects come from the default remote.
    """

    def __init__(self, repo: Repo, restores: bool = False, pull: bool = False):
        super().__init__(repo)
        self.restores, self.pull_objects = restores, pull

    def _load_cache(self, key: str, value: str | None) -> dict[str, Any] | None:
        if value is None:  # a killed DVC leaves the folder of an entry empty
            return None
        path = Path(self._get_cache_path(key, value))
        try:
            entry: dict[str, Any] = COMPILED_LOCK_FILE_STAGE_SCHEMA(load_yaml(path))
            if _get_cache_hash(entry) == value:
                return entry
        except FileNotFoundError:
            return None
        except (ParseError, Invalid):
            pass
        if self.restores:
            _log.warning("%s: this saved run is damaged and was removed", path)
            remove_saved_run(path)
        return None

    def _load(self, stage: Stage) -> dict[str, Any] | None:
        """Return the newest saved run of a stage with its command, dependencies and parameters."""
        key, asked = _get_stage_hash(stage), recorded_inputs(to_single_stage_lockfile(stage))
        runs = (self._load_cache(key, path.name) for path in saved_runs_of(self, key))
        return next((run for run in runs if run is not None and recorded_inputs(run) == asked), None)

    def save(self, stage: Stage) -> None:
        """Save a run, in the place of one of the same name with other parameters, which DVC would keep."""
        if _can_hash(stage):
            entry = to_single_stage_lockfile(stage)
            key, value = _get_stage_hash(stage), _get_cache_hash(entry)
            run = self._load_cache(key, value)
            if run is not None and recorded_inputs(run) != recorded_inputs(entry):
                remove_saved_run(Path(self._get_cache_path(key, value)))
        super().save(stage)

    def _create_stage(self, cache: dict[str, Any], wdir: str | None = None) -> PipelineStage:
        if not self.restores:
            return super()._create_stage(cache, wdir)
        # DVC's `restore` creates this stage from an entry and checks out its outputs if they are cached.
        stage = super()._create_stage(cache, wdir)
        cached = stage.outs_cached
        stage.outs_cached = lambda: self._outs_cached(stage, cached)
        return stage

    def _outs_cached(self, stage: PipelineStage, cached: Any) -> bool:
        remove_damaged(stage.outs)
        if cached():
            return True
        if not (self.pull_objects and self._pull(stage)):
            return False
        remove_damaged(stage.outs)
        return cached()

    def _pull(self, stage: PipelineStage) -> bool:
        try:
            return pull_outputs(self.repo, [stage]) == 0
        except Exception as error:  # every kind of remote has its own errors
            _log.warning("lost connection to the remote: %s; continuing without it", error)
            self.pull_objects = False
            return False


def is_there(out: Output) -> bool:
    """Return whether an output exists; an empty folder is what a restore leaves that was killed or failed."""
    path = Path(out.fs_path)
    return bool(out.exists) and not (path.is_dir() and next(path.iterdir(), None) is None)


def remove_damaged(outs: Iterable[Output]) -> None:
    """Remove cached files of outputs whose content does not match the hash in their name."""
    for out in outs:
        for path, oid in _files(out):
            cached = out.local_cache.oid_to_path(oid)
            try:
                valid = file_md5(cached, name=out.hash_name) == oid.removesuffix(".dir")
            except FileNotFoundError:
                continue
            if not valid:
                _log.warning("%s: its copy in the cache, %s, is damaged and was removed", path, cached)
                Path(cached).unlink()
                if oid.endswith(".dir"):
                    break  # the rest of the listing cannot be trusted


def _files(out: Output) -> Iterator[tuple[str, str]]:
    """Yield path and hash of every cached file of an output; for a directory, the listing first."""
    oid = out.hash_info.value
    if not oid:
        return
    yield str(out), oid
    if out.hash_info.isdir and isinstance(tree := out.get_obj(), Tree):
        for key, _, info in tree:
            yield os.path.join(str(out), *key), info.value  # noqa: PTH118
