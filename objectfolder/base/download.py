"""Download files over HTTP, resuming interrupted downloads and retrying with growing waits.

pooch (1.9) would not do: it starts every attempt and every run from the first byte, its hashes must be known
beforehand, and its archive processors neither limit sizes nor, before Python 3.12, filter members.
"""

import errno
import io
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from pathlib import Path
from typing import Any, TypeGuard
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPHandler, HTTPRedirectHandler, HTTPSHandler, Request, build_opener

from objectfolder.base.disk import free_bytes
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import installed_version
from objectfolder.base.io import write_text

WAITS = (1.0, 2.0, 4.0, 8.0)  #: seconds between attempts that bring nothing
TIMEOUT = 30  #: seconds without an answer or a byte
MIN_BYTES, PERIOD = 1 << 16, 60  #: bytes that must arrive, in so many seconds
MAX_DOWNLOAD = 1 << 30  #: bytes of a file whose size is not known beforehand
RESERVE = 1 << 28  #: bytes that a download leaves free on the disk
BLOCK = 1 << 16
RETRYABLE = (408, 425, 429, 500, 502, 503, 504)  #: HTTP status codes
RANGE_NOT_SATISFIABLE = 416

ProgressCallback = Callable[[int, int | None], None]  #: takes bytes received, and bytes expected if known
ProgressFactory = Callable[[str], ProgressCallback]  #: takes the name of the file to download


class DownloadError(ObjectFolderError):
    """A server does not answer, refuses, breaks off or sends too much; the message ends with what to do."""


class UnreachableError(DownloadError):
    """No connection to a host, which is as in a URL, perhaps with a port, at the first attempt."""

    def __init__(self, host: str, reason: object):
        super().__init__(f"{host} cannot be reached ({reason}): check the network and the address")
        self.host = host


class _RetryableError(Exception):
    """A failed attempt that may succeed when repeated."""


class _NoConnectionError(_RetryableError):
    """An attempt that ended before the host answered: its name is unknown, or there is no way to it."""


def download(
    url: str,
    path: Path,
    report: ProgressCallback = lambda done, total: None,
    waits: Sequence[float] = WAITS,
    most: int = MAX_DOWNLOAD,
) -> None:
    """Download a file, resuming from the bytes that an earlier attempt left in ``path``.

    A download is resumed only if the server still has the same file, by its ETag or date (RFC 9110,
    If-Range), which is stored next to it in ``<name>.tag``. ``path``: partial after an error; its directory
    must exist. ``report``: called with the bytes received and the bytes expected, or None. ``waits``: seconds
    before each further attempt; those that bring bytes at the least rate restart the sequence. ``most``:
    maximum size, bytes. Raises `DownloadError` if the server cannot be reached (`UnreachableError`, after the
    first attempt), refuses, redirects to another protocol, keeps breaking off or is slower than `MIN_BYTES`
    in `PERIOD`, or the file is too large; ObjectFolderError if it cannot be written.
    """
    furthest, since, left = 0, time.monotonic(), list(waits)
    reached = False
    while True:
        try:
            _attempt(url, path, report, most)
            break
        except _RetryableError as error:
            if isinstance(error, _NoConnectionError) and not reached:
                raise UnreachableError(urlsplit(url).netloc, error) from error
            reached = True
            size = path.stat().st_size if path.exists() else 0
            now = time.monotonic()
            if size > furthest + (now - since) * MIN_BYTES / PERIOD:
                furthest, since, left = size, now, list(waits)
            if not left:
                kept = f" from the {size} bytes that are kept" if _tag(path).exists() else ""
                raise DownloadError(f"{url} broke off ({error}); run it again to go on{kept}") from error
            time.sleep(left.pop(0))
    _tag(path).unlink(missing_ok=True)


def download_to(
    path: Path, url: str, part: Path, progress: ProgressFactory, most: int = MAX_DOWNLOAD
) -> None:
    """Download to ``part``, resuming it, and move it to ``path`` when it is complete."""
    download(url, part, progress(path.name), most=most)
    path.parent.mkdir(parents=True, exist_ok=True)
    part.replace(path)


def no_progress(name: str) -> ProgressCallback:
    """Return a callback that ignores the progress."""
    return lambda done, total: None


class _PacedStream(io.RawIOBase):
    """The bytes of a connection, headers included; ends in TimeoutError when they come too slowly."""

    def __init__(self, raw: io.RawIOBase):
        self.raw, self.since, self.count = raw, time.monotonic(), 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        got = self.raw.readinto(buffer)
        self.count += got or 0
        if (now := time.monotonic()) - self.since > PERIOD:
            if self.count < MIN_BYTES:
                raise TimeoutError(f"{self.count:,} bytes in {PERIOD} s, expected {MIN_BYTES:,} or more")
            self.since, self.count = now, 0
        return got

    def close(self) -> None:
        self.raw.close()
        super().close()


class _Response(HTTPResponse):
    def __init__(self, sock: Any, *args: Any, **options: Any):
        super().__init__(sock, *args, **options)
        self.fp = io.BufferedReader(_PacedStream(self.fp.detach()))


class _Connection(HTTPConnection):
    response_class = _Response


class _SecureConnection(HTTPSConnection):
    response_class = _Response


class _Handler(HTTPHandler, HTTPSHandler):
    def http_open(self, request: Request) -> HTTPResponse:
        return self.do_open(_Connection, request)

    def https_open(self, request: Request) -> HTTPResponse:
        return self.do_open(_SecureConnection, request)


class _Redirects(HTTPRedirectHandler):
    def redirect_request(
        self, req: Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> Request | None:
        fp.close()  # or its body, which may be endless, is read to the end
        allowed = ("https://",) if req.type == "https" else ("http://", "https://")
        if not newurl.startswith(allowed):
            where = f"{req.full_url} redirects to {newurl}, expected {' or '.join(allowed)}"
            raise DownloadError(f"{where}; check the address")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _attempt(url: str, path: Path, report: ProgressCallback, most: int) -> None:
    tag = _tag(path)
    # Links are not followed: whatever a server is sent, or what is appended to, we have written.
    kept = all(file.is_file() and not file.is_symlink() for file in (path, tag))
    start = path.stat().st_size if kept else 0
    # The terms of Poly Haven require a name.
    headers = {"User-Agent": f"objectfolder/{installed_version()}", "Accept-Encoding": "identity"}
    if start:
        headers |= {"Range": f"bytes={start}-", "If-Range": tag.read_text()}
    try:
        opener = build_opener(_Handler, _Redirects)
        with opener.open(Request(url, headers=headers), timeout=TIMEOUT) as response:
            _receive(response, path, start, report, most)
    except HTTPError as error:
        with error:
            if error.code == RANGE_NOT_SATISFIABLE:
                _forget(path)  # the remote file is shorter now, or ours is complete: start again
            elif error.code not in RETRYABLE:
                answer = f"{url} answered {error.code} {error.reason}"
                raise DownloadError(f"{answer}; check the address") from error
            raise _RetryableError(f"{error.code} {error.reason}") from error
    except (OSError, HTTPException, UnicodeError) as error:  # UnicodeError: of a host's name
        reason = getattr(error, "reason", None) or error or type(error).__name__
        if _is_unconnected(reason):
            raise _NoConnectionError(reason.strerror or reason) from error
        raise _RetryableError(reason) from error


def _is_unconnected(reason: object) -> TypeGuard[OSError]:
    """Return whether no host of that name is known, none listens, or no way leads there."""
    return isinstance(reason, socket.gaierror | ConnectionRefusedError) or (
        isinstance(reason, OSError) and reason.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH)
    )


def _receive(response: HTTPResponse, path: Path, start: int, report: ProgressCallback, most: int) -> None:
    headers = response.headers
    resumed = response.status == 206
    if resumed and not (start and headers.get("Content-Range", "").startswith(f"bytes {start}-")):
        _forget(path)
        raise _RetryableError(f"it sent {headers.get('Content-Range')!r}, expected bytes from {start}")
    done = start if resumed else 0
    total = None if response.length is None else done + response.length
    etag = headers.get("ETag", "")
    # A weak ETag does not promise the same bytes.
    validator = etag if etag.startswith('"') else headers.get("Last-Modified", "")
    with _writing(path):
        if not resumed:
            _forget(path)
            if validator.isprintable() and validator:
                write_text(_tag(path), validator)
        stream = path.open("ab" if resumed else "xb")
    room = done + free_bytes(path) - RESERVE
    with stream:
        _check_size(response.url, path, total or done, most, room)
        report(done, total)
        while block := response.read1(BLOCK):  # what has come; `read` would wait for the whole block
            done += len(block)
            _check_size(response.url, path, done, most, room)
            with _writing(path):
                stream.write(block)
            report(done, total)
    if total is not None and done < total:
        raise _RetryableError(f"after {done} of {total} bytes")


def _check_size(url: str, path: Path, size: int, most: int, room: int) -> None:
    if size > most:
        _forget(path)
        large = f"{url} is larger than {most / 1e6:,.1f} MB, the most that is downloaded"
        raise DownloadError(f"{large}; check the address")
    if size > room:
        left = f"{size / 1e6:,.1f} MB would leave less than {RESERVE / 1e6:.0f} MB free"
        raise ObjectFolderError(f"{url}: no space in {path.parent}: {left}; make room and run it again")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        advice = "make room, or make the directory writable"
        raise ObjectFolderError(f"cannot write {path}: {error.strerror}; {advice}") from error


def _forget(path: Path) -> None:
    path.unlink(missing_ok=True)
    _tag(path).unlink(missing_ok=True)


def _tag(path: Path) -> Path:
    return path.with_name(path.name + ".tag")
