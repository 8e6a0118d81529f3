"""Downloads go on where they broke off, and end whole or with a reason."""

import pytest

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.download import WAITS, download

CONTENT = bytes(range(256)) * 1000


@pytest.fixture
def page(publisher):
    publisher.pages["/file"] = CONTENT
    return f"{publisher.url}/file"


def test_a_dropped_connection_is_resumed_by_range(publisher, page, tmp_path, no_waits):
    publisher.drops["/file"] = [100_000, 50_000]
    seen = []
    download(page, tmp_path / "file", lambda done, total: seen.append((done, total)))
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert [h.get("Range") for _, h in publisher.requests] == [None, "bytes=100000-", "bytes=150000-"]
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert {total for _, total in seen} == {len(CONTENT)}
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_attempts_that_bring_bytes_do_not_use_up_the_attempts(publisher, page, tmp_path, no_waits):
    publisher.drops["/file"] = [10_000] * 20
    download(page, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert no_waits == [WAITS[0]] * 20


def test_a_later_run_goes_on_with_what_an_earlier_left(publisher, page, tmp_path, no_waits):
    publisher.drops["/file"] = [100_000, *[0] * len(WAITS)]
    with pytest.raises(
        ObjectFolderError, match=r"broke off.*run the same command again.*100000 bytes"
    ) as error:
        download(page, tmp_path / "file")
    assert page in str(error.value)
    assert no_waits == list(WAITS)
    assert (tmp_path / "file").read_bytes() == CONTENT[:100_000]
    download(page, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert publisher.requests[-1][1]["Range"] == "bytes=100000-"


@pytest.mark.parametrize("missing", ["ranges", "validators"])
def test_a_server_that_cannot_resume_is_asked_for_all_of_it(publisher, page, tmp_path, no_waits, missing):
    setattr(publisher, missing, False)
    publisher.drops["/file"] = [100_000]
    download(page, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT


def test_a_file_that_changed_in_between_is_not_spliced(publisher, page, tmp_path, no_waits):
    publisher.drops["/file"] = [100_000, *[0] * len(WAITS)]
    with pytest.raises(ObjectFolderError):
        download(page, tmp_path / "file")
    publisher.pages["/file"] = CONTENT[::-1]
    download(page, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT[::-1]


def test_a_file_that_shrank_is_fetched_anew(publisher, page, tmp_path, no_waits):
    (tmp_path / "file").write_bytes(CONTENT * 2)
    publisher.drops["/file"] = [0]
    download(page, tmp_path / "file")  # leaves no tag
    assert (tmp_path / "file").read_bytes() == CONTENT
    (tmp_path / "file.tag").write_text(_tag(publisher, page, tmp_path))
    download(page, tmp_path / "file")  # as long as the file there: 416
    assert (tmp_path / "file").read_bytes() == CONTENT


def _tag(publisher, page, tmp_path):
    publisher.drops["/file"] = [1, *[0] * len(WAITS)]
    with pytest.raises(ObjectFolderError):
        download(page, tmp_path / "other")
    return (tmp_path / "other.tag").read_text()


def test_a_busy_server_is_asked_again_and_a_refusal_is_not(publisher, page, tmp_path, no_waits):
    publisher.refusals["/file"] = [503, 429]
    download(page, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert no_waits == list(WAITS[:2])
    with pytest.raises(ObjectFolderError, match=r"/gone answered 404.*--url SOURCE=TEMPLATE.*--from DIR"):
        download(f"{publisher.url}/gone", tmp_path / "gone")
    assert len(no_waits) == 2
    assert not (tmp_path / "gone").exists()


def test_nobody_there_is_said_after_the_waits(publisher, tmp_path, no_waits):
    with pytest.raises(ObjectFolderError, match=r"127\.0\.0\.1:1/file broke off \(.*refused"):
        download("http://127.0.0.1:1/file", tmp_path / "file")
    assert no_waits == list(WAITS)


def test_it_says_who_asks(publisher, page, tmp_path):
    download(page, tmp_path / "file")
    assert publisher.requests[0][1]["User-Agent"].startswith("objectfolder")
