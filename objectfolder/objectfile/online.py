"""Releases that others publish: each file comes from an address into a cache when it is first asked for."""

import hashlib
import logging
import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import quote, urlsplit

from objectfolder.base.checks import is_web_address
from objectfolder.base.download import (
    DownloadError,
    ProgressCallback,
    download,
    no_progress,
)
from objectfolder.base.errors import ObjectFolderError, quoted, shortened
from objectfolder.base.installation import install_command
from objectfolder.base.io import file_digest
from objectfolder.base.locks import exclusive

MAX_INDEX = 1 << 26  #: bytes
_HUB = re.compile(r"hf://(?:datasets/)?([\w.-]+/[\w.-]+)(?:@([\w./-]+))?", re.ASCII)
_THIS_COMPUTER = ("localhost", "127.0.0.1", "::1")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WebRelease:
    """A release on a web server."""

    address: str
    folder: Path  #: of the cache

    def fetch(self, name: str, most: int = MAX_INDEX, digest: str | None = None) -> None:
        """Download a file of the release, of at most ``most`` bytes, unless the folder holds it.

        Without a ``digest`` it may have changed: it is downloaded again, if that is possible. Raises
        ObjectFolderError if it does not come, has another digest, or cannot be written.
        """
        path, url = self.folder / name, f"{self.address}/{quote(name)}"
        part = self.folder / f".{digest or name}.part"
        try:
            if _holds(path, digest):
                return
            with exclusive(self.folder, lambda: _log.warning("waiting for another download of %s", url)):
                if _holds(path, digest):  # by now
                    return
                with _shown(name) as report:
                    download(url, part, report, most=most)
                if digest and (found := file_digest(part)) != digest:
                    part.unlink()
                    raise ObjectFolderError(_differs(url, found, digest, "try again"))
                path.parent.mkdir(parents=True, exist_ok=True)
                part.replace(path)
        except DownloadError as error:
            if not digest and path.is_file():
                _log.warning("%s; %s is that of the cache, %s", error, name, self.folder)
                return
            missing = f"{name} of {self.address} is not in the cache, {self.folder}: {error}"
            raise ObjectFolderError(missing) from error
        except OSError as error:
            raise ObjectFolderError(f"{self.address}: {_unusable(error, 'XDG_CACHE_HOME')}") from error


@dataclass(frozen=True)
class HubRelease:
    """A release in a dataset repository of the Hugging Face Hub, at a commit."""

    address: str
    repository: str
    folder: Path  #: of the commit, in the cache of the Hub

    def fetch(self, name: str, most: int, digest: str) -> None:
        """Download a file of the release unless the folder holds it; errors as those of `WebRelease`."""
        path = self.folder / name
        if not path.is_file():
            _from_hub(self.address, self.repository, self.folder.name, name)
        if (found := file_digest(path)) != digest:
            again = f"delete {os.path.realpath(path)} and try again"
            raise ObjectFolderError(_differs(f"{self.address}: {name}", found, digest, again))


def open_published(address: str, index: str) -> WebRelease | HubRelease:
    """Return the release of an address, with its index in its folder.

    ``address``: ``hf://OWNER/NAME``, ``hf://OWNER/NAME@REVISION`` or ``https://HOST/PATH``; ``http`` is for
    this computer. Raises ObjectFolderError if it is none of these, or the index cannot be had.
    """
    if match := _HUB.fullmatch(address):
        repository, revision = match.groups()
        return HubRelease(address, repository, _from_hub(address, repository, revision, index).parent)
    web = is_web_address(address) and "?" not in address and "#" not in address
    if not web or (address.startswith("http:") and urlsplit(address).hostname not in _THIS_COMPUTER):
        raise ObjectFolderError(
            f"{quoted(address)} is not the address of a release; expected hf://OWNER/NAME, "
            "hf://OWNER/NAME@REVISION, https://HOST/PATH or a folder"
        )
    address = address.rstrip("/")
    readable = re.sub(r"[^A-Za-z0-9.-]+", "_", address.partition("://")[2])[-60:]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "objectfolder" / "releases"
    release = WebRelease(address, cache / f"{readable}-{hashlib.sha256(address.encode()).hexdigest()[:16]}")
    release.fetch(index)
    return release


def _from_hub(address: str, repository: str, revision: str | None, name: str) -> Path:
    """Return the path of a file in the cache of the Hub, which resumes downloads and shows progress."""
    try:
        from huggingface_hub import constants, errors, hf_hub_download
    except ImportError as error:
        needed = f"{error.name} is not installed; {address} needs: {install_command('hub')}"
        raise ObjectFolderError(needed) from error
    try:
        return Path(hf_hub_download(repository, name, repo_type="dataset", revision=revision))
    except Exception as error:  # also those of its libraries, which change: requests, httpx, hf_xet
        # The first that it is: some are of several kinds.
        reasons = {
            errors.LocalEntryNotFoundError: "the Hub cannot be reached; check the network and HF_HUB_OFFLINE",
            errors.GatedRepoError: "accept its terms on its page of the Hub, and run `hf auth login`",
            errors.RepositoryNotFoundError: "there is no such dataset; if it is private, run `hf auth login`",
            errors.RevisionNotFoundError: "there is no such revision, which is a branch, a tag or a commit",
            errors.EntryNotFoundError: "the dataset has no such file; check the address",
        }
        reason = next((text for kind, text in reasons.items() if isinstance(error, kind)), str(error))
        if isinstance(error, OSError) and error.filename:
            reason = _unusable(error, "HF_HUB_CACHE")
        missing = f"{name} of {address} is not in the cache, {constants.HF_HUB_CACHE}: {reason}"
        raise ObjectFolderError(missing) from error


def _holds(path: Path, digest: str | None) -> bool:
    return digest is not None and path.is_file() and file_digest(path) == digest


def _unusable(error: OSError, variable: str) -> str:
    """Return what is wrong with a file of the cache, which a variable of the environment moves."""
    advice = f"make it writable, or set {variable} to another folder"
    return f"cannot use {error.filename}: {error.strerror}; {advice}"


def _differs(what: str, found: str, digest: str, again: str) -> str:
    expected = f"SHA-256 is {found}, expected {digest} as in the index"
    return f"{what}: {expected}; {again}, and if it stays so, tell the publisher"


@contextmanager
def _shown(name: str) -> Iterator[ProgressCallback]:
    """Show how far a download is, on a terminal only, in a line that goes when it ends."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield no_progress(name)
        return
    shown, write = 0.0, partial(print, end="", file=sys.stderr, flush=True)

    def report(done: int, total: int | None) -> None:
        nonlocal shown
        if (now := time.monotonic()) - shown > 0.1:
            shown = now
            size = f" of {total / 1e6:,.1f}" if total else ""
            write(f"\r{shortened(name)}: {done / 1e6:,.1f}{size} MB\x1b[K")

    try:
        yield report
    finally:
        write("\r\x1b[K")
