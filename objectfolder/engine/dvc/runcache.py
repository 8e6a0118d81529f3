"""DVC's run cache, made to hash again what it gives back and to pull what it lacks."""

import logging
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from dvc.output import Output
from dvc.repo import Repo
from dvc.stage import PipelineStage
from dvc.stage.cache import StageCache
from dvc_data.hashfile.hash import file_md5
from dvc_data.hashfile.tree import Tree

from objectfolder.engine.dvc.remote import pull_outputs

_log = logging.getLogger(__name__)


class RunCache(StageCache):
    """Stands in for ``repo.stage_cache``.

    DVC trusts a cached file whose permissions say that nobody wrote to it, and enters the hash that it ought
    to have as the hash of the copy: a damaged object would be delivered, and recorded, as good.

    Parameters
    ----------
    repo : Repo
        Open DVC repository.
    pull : bool
        Fetch objects that the run cache refers to and the cache lacks from the default remote.
    """

    def __init__(self, repo: Repo, pull: bool = False):
        super().__init__(repo)
        self.pull_objects = pull

    def _load_cache(self, key: str, value: str | None) -> dict[str, Any] | None:
        # DVC makes a folder for the entry first, and trips over it if it was killed before the entry.
        return None if value is None else super()._load_cache(key, value)

    def _create_stage(self, cache: dict[str, Any], wdir: str | None = None) -> PipelineStage:
        # DVC's `restore` makes this stage from an entry, and checks its outputs out if they are cached.
        stage = super()._create_stage(cache, wdir)
        cached = stage.outs_cached
        stage.outs_cached = lambda: self._whole(stage, cached)
        return stage

    def _whole(self, stage: PipelineStage, cached: Any) -> bool:
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
        except Exception as error:  # each kind of remote has its own
            _log.warning("the remote cannot be reached any more: %s; going on with what is here", error)
            self.pull_objects = False
            return False


def remove_damaged(outs: Iterable[Output]) -> list[str]:
    """Remove cached files of some outputs whose content does not have the hash that names them.

    Returns
    -------
    damaged : list of str
        Paths of the files as they would be in the workspace.
    """
    damaged = []
    for out in outs:
        for path, oid in _files(out):
            cached = out.local_cache.oid_to_path(oid)
            try:
                whole = file_md5(cached, name=out.hash_name) == oid.removesuffix(".dir")
            except FileNotFoundError:
                continue
            if not whole:
                _log.warning("%s: its copy in the cache, %s, is damaged and was removed", path, cached)
                Path(cached).unlink()
                damaged.append(path)
                if oid.endswith(".dir"):
                    break  # its listing is wrong too
    return damaged


def _files(out: Output) -> Iterator[tuple[str, str]]:
    """Path and hash of every cached file of an output; of a directory, the listing first."""
    oid = out.hash_info.value
    if not oid:
        return
    yield str(out), oid
    if out.hash_info.isdir and isinstance(tree := out.get_obj(), Tree):
        for key, _, info in tree:
            yield os.path.join(str(out), *key), info.value  # noqa: PTH118
