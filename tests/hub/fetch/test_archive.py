"""Archives unpack into their folder or not at all."""

import gzip
import io
import stat
import tarfile
import tracemalloc
import zipfile
from contextlib import suppress

import pytest
from publisher import tgz, zipped

from objectfolder.base.errors import ObjectFolderError
from objectfolder.hub.fetch.archive import extract

GOOD = {"a/mesh.obj": b"v 0 0 0\n" * 1000, "a/b/texture.png": bytes(range(256))}


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    return path


def refused(archive, tmp_path, match, **limits):
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    into = tmp_path / "deep" / "out"
    with pytest.raises(ObjectFolderError, match=match) as error:
        extract(archive, into, **limits)
    assert archive.name in str(error.value)
    assert not into.exists()
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    return str(error.value)


@pytest.mark.parametrize("pack", [tgz, zipped])
def test_members_come_out_as_they_went_in(tmp_path, pack):
    extract(write(tmp_path, "good", pack(GOOD)), tmp_path / "out")
    out = {
        p.relative_to(tmp_path / "out").as_posix(): p.read_bytes()
        for p in (tmp_path / "out").rglob("*")
        if p.is_file()
    }
    assert out == GOOD


def test_a_tar_of_the_current_directory_unpacks(tmp_path):
    root = tarfile.TarInfo("./")
    root.type = tarfile.DIRTYPE
    extract(write(tmp_path, "dot.tgz", tgz({"./mesh.obj": b"v"}, [root])), tmp_path / "out")
    assert (tmp_path / "out" / "mesh.obj").read_bytes() == b"v"


@pytest.mark.parametrize("pack", [tgz, zipped])
@pytest.mark.parametrize(
    "name", ["../evil", "a/../../evil", "/evil", "..\\evil", "C:\\evil", "\\\\host\\share\\evil", "a/.."]
)
def test_a_member_outside_the_folder_is_refused_and_named(tmp_path, pack, name):
    archive = write(tmp_path, "evil.archive", pack({"good": b"1", name: b"2"}))
    message = refused(archive, tmp_path, "outside the folder")
    assert repr(name) in message


def member(name, kind, link=""):
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, link
    return info


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


@pytest.mark.parametrize("pack", [tgz, zipped])
def test_bombs_are_refused(tmp_path, pack):
    archive = write(tmp_path, "bomb", pack({f"{i}": bytes(600_000) for i in range(4)}))
    assert len(archive.read_bytes()) < 20_000
    refused(archive, tmp_path, "unpacks to over 2 MB", max_bytes=2 << 20)
    refused(archive, tmp_path, "over 3 members", max_members=3)
    extract(archive, tmp_path / "room enough", max_bytes=2_400_000, max_members=4)


@pytest.mark.parametrize("pack", [tgz, zipped])
@pytest.mark.parametrize("part", [0.3, 0.6, 0.95])
def test_a_truncated_archive_is_refused(tmp_path, pack, part, rng):
    content = pack({**GOOD, "noise": rng.bytes(50_000)})
    archive = write(tmp_path, "short", content[: int(len(content) * part)])
    refused(archive, tmp_path, "damaged")


@pytest.mark.parametrize("pack", [tgz, zipped])
def test_a_flipped_byte_is_noticed(tmp_path, pack, rng):
    content = bytearray(pack({"noise": rng.bytes(50_000)}))
    for at in (20_000, 40_000):
        content[at] ^= 0xFF
        refused(write(tmp_path, "flipped", bytes(content)), tmp_path, "damaged")


def peak_of_refusal(archive, tmp_path, match, **limits):
    tracemalloc.start()
    try:
        refused(archive, tmp_path, match, **limits)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def extended(kind, content, count=1):
    """A tar whose one file has ``count`` extended headers of a kind before it."""
    stream = io.BytesIO()
    with gzip.open(stream, "wb", 1) as unpacked:
        for _ in range(count):
            header = tarfile.TarInfo("x")
            header.type, header.size = kind, len(content)
            unpacked.write(header.tobuf() + content + bytes(-len(content) % 512))
        with tarfile.open(fileobj=unpacked, mode="w|") as archive:
            info = tarfile.TarInfo("mesh.obj")
            info.size = 1
            archive.addfile(info, io.BytesIO(b"v"))
    return stream.getvalue()


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_long_extended_header_is_not_read(tmp_path, kind):
    archive = write(tmp_path, "long.tgz", extended(kind, b"20000000 comment=" + bytes(19_999_983)))
    assert len(archive.read_bytes()) < 200_000
    assert peak_of_refusal(archive, tmp_path, "extended header of 20,000,000 bytes") < 4 << 20


def test_extended_headers_are_limited_together(tmp_path, monkeypatch):
    monkeypatch.setattr("objectfolder.hub.fetch.archive.MAX_DIRECTORY", 10_000)
    header = b"120 comment=" + b"x" * 107 + b"\n"
    extract(write(tmp_path, "few.tgz", extended(tarfile.XGLTYPE, header, 80)), tmp_path / "few")
    assert (tmp_path / "few" / "mesh.obj").read_bytes() == b"v"
    refused(write(tmp_path, "many.tgz", extended(tarfile.XGLTYPE, header, 90)), tmp_path, "10,000 in all")


def folders(count, pack):
    stream = io.BytesIO()
    if pack is zipped:
        with zipfile.ZipFile(stream, "w") as archive:
            for number in range(count):
                archive.writestr(f"{number}/", b"")
        return stream.getvalue()
    with gzip.open(stream, "wb", 1) as unpacked:
        for number in range(count):
            info = tarfile.TarInfo(str(number))
            info.type = tarfile.DIRTYPE
            unpacked.write(info.tobuf())
        unpacked.write(bytes(1024))
    return stream.getvalue()


@pytest.mark.parametrize("pack", [tgz, zipped])
def test_folders_are_members(tmp_path, pack):
    archive = write(tmp_path, "folders", folders(301, pack))
    refused(archive, tmp_path, "over 300 members", max_members=300)
    extract(archive, tmp_path / "out", max_members=301)


def test_a_long_directory_of_a_zip_is_not_read(tmp_path):
    content, count = folders(1, zipped), 60_000
    start, end = content.index(b"PK\1\2"), content.index(b"PK\5\6")
    directory = content[start:end] * count
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
    archive = write(tmp_path, "odd.zip", content)
    with suppress(ObjectFolderError):
        extract(archive, tmp_path / "out")


LINK = "'way/out' is a link, a device"
#: Content and message by name of the archive.
REFUSED = {
    **{
        f"kind-{kind.decode()}.tgz": (tgz(GOOD, [member("way/out", kind, "/etc/passwd")]), LINK)
        for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE)
    },
    "link.zip": (zipped_link(), LINK),
    "dir.tgz": (
        tgz(GOOD, [member("../aside", tarfile.DIRTYPE)]),
        r"'\.\./aside' would be written outside the folder",
    ),
    "dir.zip": (zipped({"../aside/": b""}), "outside the folder"),
    "liar.zip": (zip_that_lies(), "damaged|over 1 MB"),
    "long.tgz": (gzip.compress(gzip.decompress(tgz(GOOD)) + bytes(65 << 20), 1), "goes on after its end"),
    "locked.zip": (encrypted(), "'secret' is encrypted"),
    "clash.zip": (
        zipped({"a": b"1", "a/b": b"2"}),
        r"clash\.zip cannot be unpacked: .*(exists|Not a directory)",  # not called damage
    ),
    "page.tgz": (b"<html>not found</html>", "neither a zip nor a tar archive.*web page"),
    "empty.zip": (b"", "neither a zip nor a tar archive"),
    "chain.tgz": (extended(tarfile.XHDTYPE, b"", 5000), "chain.tgz is .*damaged"),
    "less.tgz": (extended(tarfile.XHDTYPE, b"19 size=-100000000\n"), "unpacks to over|damaged"),
    "hole.tar": (tgz(GOOD, [member("hole", tarfile.GNUTYPE_SPARSE)]), "'hole' is .* sparse"),
    "map.tgz": (
        extended(tarfile.XHDTYPE, b"22 GNU.sparse.major=1\n22 GNU.sparse.minor=0\n"),
        "'mesh.obj' is .* sparse",
    ),
    "nameless.tgz": (tgz({"good": b"1", "": b"2"}), "not trustworthy"),
    "deep.tgz": (tgz({"good": b"1", "a/" * 2000 + "b": b"2"}), "not trustworthy"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_trusted_is_refused(tmp_path, name):
    content, message = REFUSED[name]
    refused(write(tmp_path, name, content), tmp_path, message, max_bytes=1 << 20)
