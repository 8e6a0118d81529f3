"""Downloads go on where they broke off, and end whole or with a reason."""

import io
import itertools
import socket
from threading import Event
from urllib.request import Request

import pytest
from refusals import refused

from objectfolder.base import download as module
from objectfolder.base.download import RESERVE, WAITS, UnreachableError, download

CONTENT = bytes(range(256)) * 1000


@pytest.fixture
def page(publisher):
    publisher.pages["/file"] = CONTENT
    return f"{publisher.url}/file"


@pytest.fixture
def file(tmp_path):
    return tmp_path / "file"


def downloaded(url, path, *report, **limits):
    download(url, path, *report, **limits)
    return path.read_bytes()


def test_a_dropped_connection_is_resumed_by_range(publisher, page, tmp_path, file, no_waits):
    publisher.drops["/file"] = [100_000, 50_000]
    seen = []
    assert downloaded(page, file, lambda done, total: seen.append((done, total))) == CONTENT
    assert [h.get("Range") for _, h in publisher.requests] == [None, "bytes=100000-", "bytes=150000-"]
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert {total for _, total in seen} == {len(CONTENT)}
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_attempts_that_bring_bytes_do_not_use_up_the_attempts(publisher, page, file, no_waits):
    publisher.drops["/file"] = [10_000] * 20
    assert downloaded(page, file) == CONTENT
    assert no_waits == [WAITS[0]] * 20
    assert all(headers["User-Agent"].startswith("objectfolder") for _, headers in publisher.requests)


@pytest.fixture
def broken_off(publisher, page, file, no_waits):
    """The message of a download of which 100,000 bytes have come."""
    publisher.drops["/file"] = [100_000, *[0] * len(WAITS)]
    return refused(r"broke off.*run it again.*100000 bytes", download, page, file)


def test_a_later_run_goes_on_with_what_an_earlier_left(publisher, page, file, no_waits, broken_off):
    assert page in broken_off
    assert no_waits == list(WAITS)
    assert file.read_bytes() == CONTENT[:100_000]
    assert downloaded(page, file) == CONTENT
    assert publisher.requests[-1][1]["Range"] == "bytes=100000-"


@pytest.mark.parametrize("planted", ["file", "file.tag"])
def test_links_are_neither_sent_nor_gone_on_with(publisher, page, tmp_path, file, planted):
    (tmp_path / "secret").write_text("a key")
    for name in ("file", "file.tag"):
        (tmp_path / name).write_text("left")
    (tmp_path / planted).unlink()
    (tmp_path / planted).symlink_to("secret")
    assert downloaded(page, file) == CONTENT
    assert not file.is_symlink()
    assert (tmp_path / "secret").read_text() == "a key"
    ((_, headers),) = publisher.requests
    assert "If-Range" not in headers


@pytest.mark.parametrize("missing", ["ranges", "validators"])
def test_a_server_that_cannot_resume_is_asked_for_all_of_it(publisher, page, file, no_waits, missing):
    setattr(publisher, missing, False)
    publisher.drops["/file"] = [100_000]
    assert downloaded(page, file) == CONTENT


@pytest.mark.usefixtures("broken_off")
def test_a_file_that_changed_in_between_is_not_spliced(publisher, page, file):
    publisher.pages["/file"] = CONTENT[::-1]
    assert downloaded(page, file) == CONTENT[::-1]


def test_a_file_that_shrank_is_fetched_anew(publisher, page, tmp_path, file, no_waits, broken_off):
    tag = (tmp_path / "file.tag").read_text()
    (tmp_path / "file.tag").unlink()
    file.write_bytes(CONTENT * 2)
    publisher.drops["/file"] = [0]
    assert downloaded(page, file) == CONTENT
    (tmp_path / "file.tag").write_text(tag)
    assert downloaded(page, file) == CONTENT  # as long as the file there: 416


def test_a_busy_server_is_asked_again_and_a_refusal_is_not(publisher, page, tmp_path, file, no_waits):
    publisher.refusals["/file"] = [503, 429]
    assert downloaded(page, file) == CONTENT
    assert no_waits == list(WAITS[:2])
    refused(
        "/gone answered 404 Not Found; check the address",
        download,
        f"{publisher.url}/gone",
        tmp_path / "gone",
    )
    assert len(no_waits) == 2
    assert not (tmp_path / "gone").exists()


def no_names(*_):
    raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")


@pytest.mark.parametrize(
    ("host", "reason"),
    [("127.0.0.1:1", "Connection refused"), ("mirror.example", "Temporary failure in name resolution")],
)
@pytest.mark.parametrize("kept", [b"", b"from an earlier run"])
def test_nobody_there_is_said_at_once(file, monkeypatch, no_waits, host, reason, kept):
    monkeypatch.setenv("no_proxy", "*")
    if "1" not in host:
        monkeypatch.setattr(socket, "getaddrinfo", no_names)
    file.write_bytes(kept)
    with pytest.raises(UnreachableError) as error:
        download(f"http://{host}/file", file)
    assert str(error.value) == (f"{host} cannot be reached ({reason}): check the network and the address")
    assert no_waits == []
    assert file.read_bytes() == kept


def test_a_host_that_goes_away_midway_is_asked_again(publisher, page, file, monkeypatch):
    waits = []
    monkeypatch.setattr(module.time, "sleep", lambda s: waits.append(s) or publisher.server.server_close())
    publisher.drops["/file"] = [100_000]
    refused(r"/file broke off \(Connection refused\).*100000 bytes", download, page, file)
    assert waits == list(WAITS)


def trickle(first, pause=0.01):
    """Sends ``first`` at once and then a byte at a time, without end."""

    def script(handler):
        handler.wfile.write(first)
        while True:
            handler.wfile.write(b"x")
            Event().wait(pause)

    return script


HEAD = b'HTTP/1.1 200 OK\r\nETag: "1"\r\n'


@pytest.mark.parametrize(
    ("first", "kept"),
    [
        (HEAD + b"Content-Length: 1000000\r\n\r\n" + bytes(1000), 1000),
        (HEAD + b"\r\n" + bytes(1000), 1000),  # ends when the connection does
        (HEAD + b"X-Long: ", 0),  # within the headers
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n3e8\r\n" + bytes(1000) + b"\r\n1;", 1000),
    ],
    ids=["length", "close", "headers", "chunks"],
)
def test_a_byte_at_a_time_ends_and_keeps_what_came(publisher, file, no_waits, monkeypatch, first, kept):
    monkeypatch.setattr(module, "PERIOD", 0.15)
    publisher.scripts["/file"] = trickle(first)
    slow = r"broke off \([0-9,]+ bytes in 0.15 s, expected 65,536"
    refused(slow, download, f"{publisher.url}/file", file, waits=(1,))
    assert no_waits == [1]  # bytes that come too slowly do not use up fewer attempts
    content = file.read_bytes() if kept else b""
    assert content[:kept] == bytes(kept)
    assert set(content[kept:]) <= {ord("x")}


def test_a_byte_for_each_attempt_ends(publisher, page, file, no_waits, monkeypatch):
    monkeypatch.setattr(module, "MIN_BYTES", 1 << 40)
    publisher.drops["/file"] = [1] * 1000
    refused("broke off", download, page, file)
    assert no_waits == list(WAITS)


def endless(*headers):
    """Answers with zeros until the other side hangs up; counts what it sends in ``sent``."""

    def script(handler):
        for line in headers:
            handler.wfile.write(line + b"\r\n")
        handler.wfile.write(b"\r\n")
        script.sent = 0
        while script.sent < 8 << 20:
            handler.wfile.write(bytes(1 << 16))
            script.sent += 1 << 16
        script.ended.set()

    script.ended = Event()
    return script


def test_a_file_without_end_is_cut_at_the_limit(publisher, tmp_path, file):
    publisher.scripts["/file"] = script = endless(b"HTTP/1.1 200 OK")
    large = r"/file is larger than 1\.0 MB.*check the address"
    refused(large, download, f"{publisher.url}/file", file, most=1_000_000)
    assert list(tmp_path.iterdir()) == []
    assert not script.ended.is_set()


def test_a_length_over_the_limit_is_refused_before_a_byte(publisher, page, tmp_path, file):
    seen, most = [], len(CONTENT) - 1
    refused("/file is larger than", download, page, file, lambda *done: seen.append(done), most=most)
    assert seen == []
    assert list(tmp_path.iterdir()) == []
    assert downloaded(page, file, most=len(CONTENT)) == CONTENT


@pytest.mark.parametrize("lengths", [True, False])
def test_a_download_leaves_space_on_the_disk(publisher, tmp_path, file, monkeypatch, lengths):
    monkeypatch.setattr(module, "free_bytes", lambda path: RESERVE + 500_000)
    length = [b"Content-Length: 67108864"] if lengths else []
    publisher.scripts["/file"] = endless(b"HTTP/1.1 200 OK", *length)
    refused(r"no space in .* make room", download, f"{publisher.url}/file", file)
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 500_000


@pytest.mark.parametrize("target", ["ftp://127.0.0.1/x", "file:///etc/passwd", "data:,x"])
def test_a_redirect_to_another_protocol_is_refused(publisher, tmp_path, file, no_waits, target):
    publisher.scripts["/file"] = moved(target)
    assert target in refused(r"redirect|not allowed", download, f"{publisher.url}/file", file)
    assert no_waits == []
    assert list(tmp_path.iterdir()) == []


def test_a_redirect_from_https_stays_with_it():
    answer = Request("https://a.test/x"), io.BytesIO(), 302, "Found", {}
    assert module._Redirects().redirect_request(*answer, "https://b.test/x").full_url == "https://b.test/x"
    plain = r"https://a\.test/x redirects to http://b\.test/x, expected https://; check"
    refused(plain, module._Redirects().redirect_request, *answer, "http://b.test/x")


def moved(target):
    return endless(b"HTTP/1.1 302 Found", b"Location: " + target.encode())


def test_a_redirect_is_followed_without_reading_its_body(publisher, page, file):
    publisher.scripts["/old"] = script = moved(page)
    assert downloaded(f"{publisher.url}/old", file) == CONTENT
    assert not script.ended.is_set()


FOLDED = 'ETag: "a\r\n b"\r\nContent-Length: 3'  # over two lines


@pytest.mark.parametrize("header", [f"Content-Length: {'9' * 5000}", "Content-Length: ²", FOLDED])
def test_odd_headers_are_no_crash(publisher, file, no_waits, header):
    lines = f"HTTP/1.1 200 OK\r\nConnection: close\r\n{header}\r\n\r\n".encode("latin-1")
    answers = itertools.chain([lines + b"ab"], itertools.repeat(lines + b"abc"))
    publisher.scripts["/file"] = lambda handler: handler.wfile.write(next(answers))
    for _ in range(2):
        found = downloaded(f"{publisher.url}/file", file)
    assert found == b"abc"


def test_a_redirect_to_an_impossible_host_is_no_crash(publisher, file, no_waits):
    publisher.scripts["/file"] = moved("http://a..b/file")
    refused("broke off", download, f"{publisher.url}/file", file)
