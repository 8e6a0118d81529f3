"""Download files over HTTP, resuming interrupted downloads and retrying with growing waits.

pooch (1.9) would not do: it starts every attempt and every run from the first byte, its hashes must be known
beforehand, and its archive processors neither limit sizes nor, before Python 3.12, filter members.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from http.client import HTTPException, HTTPResponse
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from objectfolder.errors import ObjectFolderError

WAITS = (1.0, 2.0, 4.0, 8.0)  #: seconds between attempts that received no new bytes
TIMEOUT = 30  #: seconds without an answer or a byte
BLOCK = 1 << 16
RETRYABLE = (408, 425, 429, 500, 502, 503, 504)  #: HTTP status codes
RANGE_NOT_SATISFIABLE = 416

ProgressCallback = Callable[[int, int | None], None]  #: takes bytes received, and bytes expected if known
ProgressFactory = Callable[[str], ProgressCallback]  #: takes the name of the file to download


class _RetryableError(Exception):
    """A failed attempt that may succeed when repeated."""


def download(
    url: str, path: Path, report: ProgressCallback = lambda done, total: None, waits: Sequence[float] = WAITS
) -> None:
    """Download a file, resuming from the bytes that an earlier attempt left in ``path``.

    A download is resumed only if the server still has the same file, by its ETag or date (RFC 9110,
    If-Range), which is stored next to it in ``<name>.tag``.

    Parameters
    ----------
    url : str
        ``http`` or ``https``.
    path : Path
        Destination, partial after an error. Its directory must exist.
    report : callable
        Called with the bytes received and the bytes expected, or None.
    waits : sequence of float
        Seconds before each further attempt. An attempt that receives new bytes restarts the sequence.

    Raises
    ------
    ObjectFolderError
        If the server refuses, the connection keeps breaking, or the file cannot be written.
    """
    furthest, left = 0, list(waits)
    while True:
        try:
            _attempt(url, path, report)
            break
        except _RetryableError as error:
            size = path.stat().st_size if path.exists() else 0
            if size > furthest:
                furthest, left = size, list(waits)
            if not left:
                kept = f" from the {size} bytes that are kept" if _tag(path).exists() else ""
                raise ObjectFolderError(
                    f"{url} broke off ({error}); run the same command again to go on{kept}, "
                    "or download it yourself and use --from DIR"
                ) from error
            time.sleep(left.pop(0))
    _tag(path).unlink(missing_ok=True)


def download_to(path: Path, url: str, part: Path, progress: ProgressFactory) -> None:
    """Download to ``part``, resuming it, and move it to ``path`` when it is complete."""
    download(url, part, progress(path.name))
    path.parent.mkdir(parents=True, exist_ok=True)
    part.replace(path)


def no_progress(name: str) -> ProgressCallback:
    """Return a callback that ignores the progress."""
    return lambda done, total: None


def _attempt(url: str, path: Path, report: ProgressCallback) -> None:
    tag = _tag(path)
    start = path.stat().st_size if path.exists() and tag.exists() else 0
    headers = {"User-Agent": _user_agent(), "Accept-Encoding": "identity"}
    if start:
        headers |= {"Range": f"bytes={start}-", "If-Range": tag.read_text()}
    try:
        with urlopen(Request(url, headers=headers), timeout=TIMEOUT) as response:
            _receive(response, path, start, report)
    except HTTPError as error:
        with error:
            if error.code == RANGE_NOT_SATISFIABLE:
                _forget(path)  # the remote file is shorter now, or ours is complete: start again
            elif error.code not in RETRYABLE:
                raise ObjectFolderError(
                    f"{url} answered {error.code} {error.reason}; if the source has moved, give its address "
                    "with --url SOURCE=TEMPLATE, or download the object yourself and use --from DIR"
                ) from error
            raise _RetryableError(f"{error.code} {error.reason}") from error
    except (OSError, HTTPException) as error:
        raise _RetryableError(getattr(error, "reason", None) or error or type(error).__name__) from error


def _receive(response: HTTPResponse, path: Path, start: int, report: ProgressCallback) -> None:
    headers = response.headers
    resumed = response.status == 206
    if resumed and not (start and headers.get("Content-Range", "").startswith(f"bytes {start}-")):
        _forget(path)
        raise _RetryableError(f"it sent {headers.get('Content-Range')!r}, expected bytes from {start}")
    done = start if resumed else 0
    length = headers.get("Content-Length", "")
    total = done + int(length) if length.isdigit() else None
    etag = headers.get("ETag", "")
    # A weak ETag does not promise the same bytes.
    validator = etag if etag.startswith('"') else headers.get("Last-Modified", "")
    try:
        if not resumed:
            _forget(path)
            if validator:
                _tag(path).write_text(validator)
        stream = path.open("ab")
    except OSError as error:
        raise _cannot_write(path, error) from error
    with stream:
        report(done, total)
        while block := response.read(BLOCK):
            try:
                stream.write(block)
            except OSError as error:
                raise _cannot_write(path, error) from error
            done += len(block)
            report(done, total)
    if total is not None and done < total:
        raise _RetryableError(f"after {done} of {total} bytes")


def _cannot_write(path: Path, error: OSError) -> ObjectFolderError:
    return ObjectFolderError(
        f"cannot write {path}: {error.strerror}; make room, or make the directory writable"
    )


def _forget(path: Path) -> None:
    path.unlink(missing_ok=True)
    _tag(path).unlink(missing_ok=True)


def _tag(path: Path) -> Path:
    return path.with_name(path.name + ".tag")


def _user_agent() -> str:
    # Required by the terms of Poly Haven.
    with suppress(PackageNotFoundError):
        return f"objectfolder/{version('objectfolder')}"
    return "objectfolder"
