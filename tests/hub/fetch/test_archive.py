"""Archives unpack into their folder or not at all."""

import gzip
import io
import stat
import tarfile
import tracemalloc
import zipfile
from contextlib import suppress

import pytest
from folders import contents
from publisher import tgz, zipped
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.hub.fetch.archive import extract

GOOD = {"a/mesh.obj": b"v 0 0 0\n" * 1000, "a/b/texture.png": bytes(range(256))}


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    return path


def member(name, kind, link=""):
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, link
    return info


def check_refused(archive, tmp_path, match, **limits):
    before, into = contents(tmp_path), tmp_path / "deep" / "out"
    message = refused(match, extract, archive, into, **limits)
    assert archive.name in message
    assert not into.exists()
    assert contents(tmp_path) == before
    return message


PACKED = pytest.mark.parametrize("pack", [tgz, zipped])


@PACKED
def test_members_come_out_as_they_went_in(tmp_path, pack):
    extract(write(tmp_path, "good", pack(GOOD)), tmp_path / "out")
    assert contents(tmp_path / "out") == GOOD


def test_a_tar_of_the_current_directory_unpacks(tmp_path):
    content = tgz({"./mesh.obj": b"v"}, [member("./", tarfile.DIRTYPE)])
    extract(write(tmp_path, "dot.tgz", content), tmp_path / "out")
    assert contents(tmp_path / "out") == {"mesh.obj": b"v"}


@PACKED
@pytest.mark.parametrize(
    "name", ["../evil", "a/../../evil", "/evil", "..\\evil", "C:\\evil", "\\\\host\\share\\evil", "a/.."]
)
def test_a_member_outside_the_folder_is_refused_and_named(tmp_path, pack, name):
    archive = write(tmp_path, "evil.archive", pack({"good": b"1", name: b"2"}))
    assert repr(name) in check_refused(archive, tmp_path, "outside the folder")


def zipped_link():
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        info = zipfile.ZipInfo("way/out")
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    return stream.getvalue()


def zip_that_lies():
    content = bytearray(zipped({"bomb": bytes(3 << 20)}))
    real = (3 << 20).to_bytes(4, "little")
    for _ in range(2):  # local and central header
        at = content.index(real)
        content[at : at + 4] = (10).to_bytes(4, "little")
    return bytes(content)


def encrypted():
    content = bytearray(zipped({"secret": b"1"}))
    content[6] |= 1  # flags of the local header
    content[content.index(b"PK\x01\x02") + 8] |= 1  # and of the central directory
    return bytes(content)


@PACKED
def test_bombs_are_refused(tmp_path, pack):
    archive = write(tmp_path, "bomb", pack({f"{i}": bytes(600_000) for i in range(4)}))
    assert len(archive.read_bytes()) < 20_000
    check_refused(archive, tmp_path, "unpacks to over 2 MB", max_bytes=2 << 20)
    check_refused(archive, tmp_path, "over 3 members", max_members=3)
    extract(archive, tmp_path / "room enough", max_bytes=2_400_000, max_members=4)


@PACKED
@pytest.mark.parametrize("part", [0.3, 0.6, 0.95])
def test_a_truncated_archive_is_refused(tmp_path, pack, part, rng):
    content = pack({**GOOD, "noise": rng.bytes(50_000)})
    check_refused(write(tmp_path, "short", content[: int(len(content) * part)]), tmp_path, "damaged")


@PACKED
def test_a_flipped_byte_is_noticed(tmp_path, pack, rng):
    content = bytearray(pack({"noise": rng.bytes(50_000)}))
    for at in (20_000, 40_000):
        content[at] ^= 0xFF
        check_refused(write(tmp_path, "flipped", bytes(content)), tmp_path, "damaged")


def peak_of_refusal(archive, tmp_path, match):
    tracemalloc.start()
    try:
        check_refused(archive, tmp_path, match)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def extended(kind, content, count=1):
    """A tar whose one file has ``count`` extended headers of a kind before it."""
    stream = io.BytesIO()
    with gzip.open(stream, "wb", 1) as unpacked:
        for _ in range(count):
            header = member("x", kind)
            header.size = len(content)
            unpacked.write(header.tobuf() + content + bytes(-len(content) % 512))
        unpacked.write(gzip.decompress(tgz({"mesh.obj": b"v"})))
    return stream.getvalue()


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_long_extended_header_is_not_read(tmp_path, kind):
    archive = write(tmp_path, "long.tgz", extended(kind, b"20000000 comment=" + bytes(19_999_983)))
    assert len(archive.read_bytes()) < 200_000
    assert peak_of_refusal(archive, tmp_path, "extended header of 20,000,000 bytes") < 4 << 20


def test_extended_headers_are_limited_together(tmp_path, monkeypatch):
    monkeypatch.setattr("objectfolder.hub.fetch.archive.MAX_DIRECTORY", 10_000)
    header = b"120 comment=" + b"x" * 107 + b"\n"
    many = write(tmp_path, "many.tgz", extended(tarfile.XGLTYPE, header, 90))
    check_refused(many, tmp_path, "10,000 in all")
    extract(write(tmp_path, "few.tgz", extended(tarfile.XGLTYPE, header, 80)), tmp_path / "few")
    assert contents(tmp_path / "few") == {"mesh.obj": b"v"}


@pytest.mark.parametrize(
    "content",
    [
        zipped({f"{number}/": b"" for number in range(301)}),
        tgz({}, [member(str(number), tarfile.DIRTYPE) for number in range(301)]),
    ],
)
def test_folders_are_members(tmp_path, content):
    archive = write(tmp_path, "folders", content)
    check_refused(archive, tmp_path, "over 300 members", max_members=300)
    extract(archive, tmp_path / "out", max_members=301)


def test_a_long_directory_of_a_zip_is_not_read(tmp_path):
    content = zipped({"0/": b""})
    start, end = content.index(b"PK\1\2"), content.index(b"PK\5\6")
    directory = content[start:end] * 60_000
    size = len(directory).to_bytes(4, "little")
    content = content[:start] + directory + content[end : end + 12] + size + content[end + 16 :]
    archive = write(tmp_path, "folders.zip", content)
    assert peak_of_refusal(archive, tmp_path, "directory of over 2,097,152 bytes") < 8 << 20


@pytest.mark.parametrize(
    "changes",
    [
        {b"AA": b"\0x"},
        # Without a name: the two bytes are of the next field, in the local header and in the directory.
        {b"\2\0\0\0AA": b"\0\0\2\0AA", b"\2\0\0\0\0\0": b"\0\0\2\0\0\0"},
        {b"AA": b"./"},
        {b"AA": b"\xff\xff"},
    ],
)
def test_odd_names_in_a_zip_are_no_crash(tmp_path, changes):
    content = zipped({"AA": b"2"})
    for old, new in changes.items():
        assert old in content
        content = content.replace(old, new)
    with suppress(ObjectFolderError):
        extract(write(tmp_path, "odd.zip", content), tmp_path / "out")


LINK, SPARSE = "'way/out' is a link, a device", b"22 GNU.sparse.major=1\n22 GNU.sparse.minor=0\n"
#: Content and message by name of the archive.
REFUSED = {
    **{
        f"kind-{kind.decode()}.tgz": (tgz(GOOD, [member("way/out", kind, "/etc/passwd")]), LINK)
        for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE)
    },
    "link.zip": (zipped_link(), LINK),
    "dir.tgz": (tgz(GOOD, [member("../aside", tarfile.DIRTYPE)]), r"'\.\./aside' would be written outside"),
    "dir.zip": (zipped({"../aside/": b""}), "outside the folder"),
    "liar.zip": (zip_that_lies(), "damaged|over 1 MB"),
    "long.tgz": (gzip.compress(gzip.decompress(tgz(GOOD)) + bytes(65 << 20), 1), "continues after its end"),
    "locked.zip": (encrypted(), "'secret' is encrypted"),
    # Not called damage.
    "clash.zip": (zipped({"a": b"1", "a/b": b"2"}), r"clash\.zip cannot be unpacked: .*(exists|Not a dir)"),
    "page.tgz": (b"<html>not found</html>", "neither a zip nor a tar archive.*web page"),
    "empty.zip": (b"", "neither a zip nor a tar archive"),
    "chain.tgz": (extended(tarfile.XHDTYPE, b"", 5000), "chain.tgz is .*damaged"),
    "less.tgz": (extended(tarfile.XHDTYPE, b"19 size=-100000000\n"), "unpacks to over|damaged"),
    "hole.tar": (tgz(GOOD, [member("hole", tarfile.GNUTYPE_SPARSE)]), "'hole' is .* sparse"),
    "map.tgz": (extended(tarfile.XHDTYPE, SPARSE), "'mesh.obj' is .* sparse"),
    "nameless.tgz": (tgz({"good": b"1", "": b"2"}), "not trustworthy"),
    "deep.tgz": (tgz({"good": b"1", "a/" * 2000 + "b": b"2"}), "not trustworthy"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_trusted_is_refused(tmp_path, name):
    content, message = REFUSED[name]
    check_refused(write(tmp_path, name, content), tmp_path, message, max_bytes=1 << 20)
