"""DVC's run cache, extended to verify what it restores and to pull what is missing."""

import logging
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from dvc.output import Output
from dvc.repo import Repo
from dvc.schema import COMPILED_LOCK_FILE_STAGE_SCHEMA
from dvc.stage import PipelineStage, Stage
from dvc.stage.cache import StageCache, _can_hash, _get_cache_hash, _get_stage_hash
from dvc.stage.serialize import to_single_stage_lockfile
from dvc.utils.serialize import ParseError, load_yaml
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.tree import Tree
from voluptuous import Invalid

from objectfolder.engine.dvc.remote import pull_outputs
from objectfolder.engine.dvc.savedruns import recorded_inputs, remove_saved_run, saved_runs_of

_log = logging.getLogger(__name__)


class RunCache(StageCache):
    """Replacement for ``repo.stage_cache``.

    DVC trusts a read-only cached file and records the expected hash for the copy without computing it: a
    damaged object would be restored and recorded as valid. It trusts entries, too, and the key by which it
    finds them, which leaves out parameters called ``size`` or ``nfiles``: it would restore what another size
    gave.

    Parameters
    ----------
    repo : Repo
        Open DVC repository.
    restores : bool
        Whether outputs are restored: then damaged objects and entries are removed. Else nothing changes.
    pull : bool
        Download missing cached objects from the default remote.
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
