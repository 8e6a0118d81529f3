"""Download saved runs and outputs from the default remote, many files at a time."""

import logging
import os
import re
from collections.abc import Iterable
from pathlib import Path

from dvc.config import NoRemoteError
from dvc.data_cloud import Remote
from dvc.exceptions import CollectCacheError, DvcException
from dvc.repo import Repo
from dvc.stage import Stage
from dvc_data.hashfile.db import HashFileDB
from dvc_data.hashfile.hash_info import HashInfo
from dvc_objects.fs.errors import RemoteMissingDepsError
from dvc_objects.fs.generic import copy
from dvc_objects.fs.local import localfs

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command

_ENTRY = re.compile(r"[0-9a-f]{2}/[0-9a-f]{64}/[0-9a-f]{64}")  # of the run cache
_log = logging.getLogger(__name__)


def pull_build(repo: Repo, stages: Iterable[Stage]) -> bool:
    """Download the run cache and the recorded outputs of stages into the local cache.

    ``stages``: stages whose outputs to download. Returns whether the remote could be reached; if not, the
    reason is logged as a warning. Raises ObjectFolderError if there is no default remote, or the package for
    its protocol is not installed.
    """
    remote = _default(repo)
    try:
        if not remote.fs.exists(remote.path):
            _log.warning("%s is empty or does not exist; continuing without it", _name(remote))
            return False
        _fetch_runs(repo, remote)
        if lacking := pull_outputs(repo, stages):
            _log.warning(
                "%d files are missing in %s or failed to download; their stages are built here",
                lacking,
                _name(remote),
            )
    except Exception as error:  # every kind of remote has its own errors
        _log.warning("cannot fetch from %s: %s; continuing without it", _name(remote), error)
        return False
    return True


def pull_outputs(repo: Repo, stages: Iterable[Stage]) -> int:
    """Download the outputs of stages; raises the remote's own error if it cannot be reached.

    Returns how many files are still missing.
    """
    outs = [out for stage in stages for out in stage.outs if out.use_cache and out.hash_info]
    # Directory listings first: `get_used_objs` would fetch them one by one and hide errors.
    if listings := {out.hash_info for out in outs if out.hash_info.isdir}:
        repo.cloud.pull(listings)
    wanted: dict[HashFileDB | None, set[HashInfo]] = {}
    lacking = 0
    for out in outs:
        try:
            for source, objects in out.get_used_objs().items():
                wanted.setdefault(source, set()).update(objects)
        except CollectCacheError:
            lacking += 1  # a directory without its listing
    for source, objects in wanted.items():
        repo.cloud.pull(objects, odb=source)
        lacking += sum(not repo.cache.local.exists(info.value) for info in objects)
    return lacking


def _default(repo: Repo) -> Remote:
    try:
        return repo.cloud.get_remote(command="pull")
    except NoRemoteError as error:
        raise ObjectFolderError(
            f"{repo.root_dir} has no default remote to pull from; name one with "
            "`dvc remote add -d NAME URL`, or build without --pull"
        ) from error
    except (ImportError, RemoteMissingDepsError) as error:
        raise ObjectFolderError(
            f"{error}: pip install the package named above (for S3: {install_command('s3')})"
        ) from error
    except DvcException as error:
        raise ObjectFolderError(f"DVC cannot use the default remote of {repo.root_dir}: {error}") from error


def _fetch_runs(repo: Repo, remote: Remote) -> None:
    """Copy missing entries of the run cache; DVC would copy all of them, one at a time."""
    odb = remote.legacy_odb  # the run cache is stored next to the objects of DVC 2
    runs = odb.fs.join(odb.path, "runs")
    if not odb.fs.exists(runs):
        return
    cache = Path(repo.stage_cache.cache_dir)
    found = {path: odb.fs.relpath(path, runs) for path in odb.fs.find(runs)}
    wanted = {path: cache / name for path, name in found.items() if _ENTRY.fullmatch(name)}
    # An entry is named by the hash of its content. Nothing is written through a link.
    missing = {path: str(local) for path, local in wanted.items() if not os.path.lexists(local)}
    if missing:
        copy(odb.fs, list(missing), localfs, list(missing.values()), batch_size=odb.fs.jobs)


def _name(remote: Remote) -> str:
    return f"remote {remote.name} ({remote.fs.unstrip_protocol(remote.path)})"
