"""Fetch what a build may need from the default remote, many files at a time."""

import logging
from collections.abc import Sequence
from pathlib import Path

from dvc.config import NoRemoteError
from dvc.data_cloud import Remote
from dvc.exceptions import DownloadError, DvcException
from dvc.repo import Repo
from dvc_objects.fs.errors import RemoteMissingDepsError
from dvc_objects.fs.generic import copy
from dvc_objects.fs.local import localfs

from objectfolder.errors import ObjectFolderError

_log = logging.getLogger(__name__)


def fetch(repo: Repo, addresses: Sequence[str] | None = None) -> bool:
    """Fetch the run cache, and what the lock files refer to, into the local cache.

    Parameters
    ----------
    repo : Repo
        Open DVC repository.
    addresses : sequence of str, optional
        DVC's addresses of the stages whose outputs to fetch; default: all.

    Returns
    -------
    reached : bool
        Whether the remote answered; if not, a warning says why.

    Raises
    ------
    ObjectFolderError
        If there is no default remote, or what speaks to it is not installed.
    """
    remote = _default(repo)
    try:
        if not remote.fs.exists(remote.path):
            _log.warning("%s is empty or not there; going on with what is here", _name(remote))
            return False
        _fetch_runs(repo, remote)
        repo.fetch(addresses)
    except DownloadError as error:
        _log.warning(
            "%d files are not in %s or did not arrive; their stages are built here",
            error.amount,
            _name(remote),
        )
    except Exception as error:  # each kind of remote has its own
        _log.warning("cannot fetch from %s: %s; going on with what is here", _name(remote), error)
        return False
    return True


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
            f"{error}: pip install the package that it names (for S3: pip install 'objectfolder[s3]')"
        ) from error
    except DvcException as error:
        raise ObjectFolderError(f"DVC cannot use the default remote of {repo.root_dir}: {error}") from error


def _fetch_runs(repo: Repo, remote: Remote) -> None:
    """Copy the entries of the run cache that are not here; DVC copies all, one after another."""
    odb = remote.legacy_odb  # the run cache lies beside the objects of DVC 2
    runs = odb.fs.join(odb.path, "runs")
    if not odb.fs.exists(runs):
        return
    cache = Path(repo.stage_cache.cache_dir)
    wanted = {path: cache / odb.fs.relpath(path, runs) for path in odb.fs.find(runs)}
    # An entry is named by the hash of its content.
    missing = {path: str(local) for path, local in wanted.items() if not local.exists()}
    if missing:
        copy(odb.fs, list(missing), localfs, list(missing.values()), batch_size=odb.fs.jobs)


def _name(remote: Remote) -> str:
    return f"remote {remote.name} ({remote.fs.unstrip_protocol(remote.path)})"
