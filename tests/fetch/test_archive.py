"""Archives unpack into their folder or not at all."""

import gzip
import io
import stat
import tarfile
import zipfile

import pytest
from publisher import tgz, zipped

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.archive import extract

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


@pytest.mark.parametrize(
    "kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE]
)
def test_links_and_devices_in_a_tar_are_refused(tmp_path, kind):
    info = tarfile.TarInfo("way/out")
    info.type, info.linkname = kind, "/etc/passwd"
    refused(write(tmp_path, "link.tgz", tgz(GOOD, [info])), tmp_path, "'way/out' is a link or a device")


def test_a_folder_outside_is_refused_even_when_empty(tmp_path):
    info = tarfile.TarInfo("../aside")
    info.type = tarfile.DIRTYPE
    refused(write(tmp_path, "dir.tgz", tgz(GOOD, [info])), tmp_path, r"'\.\./aside' would be written outside")
    refused(write(tmp_path, "dir.zip", zipped({"../aside/": b""})), tmp_path, "outside the folder")


def test_a_symbolic_link_in_a_zip_is_refused(tmp_path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        info = zipfile.ZipInfo("way/out")
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    refused(write(tmp_path, "link.zip", stream.getvalue()), tmp_path, "'way/out' is a link or a device")


@pytest.mark.parametrize("pack", [tgz, zipped])
def test_bombs_are_refused(tmp_path, pack):
    archive = write(tmp_path, "bomb", pack({f"{i}": bytes(600_000) for i in range(4)}))
    assert len(archive.read_bytes()) < 20_000
    refused(archive, tmp_path, "unpacks to over 2 MB", max_bytes=2 << 20)
    refused(archive, tmp_path, "over 3 members", max_members=3)
    extract(archive, tmp_path / "room enough", max_bytes=2_400_000, max_members=4)


def test_a_zip_that_lies_about_its_size_is_refused(tmp_path):
    content = bytearray(zipped({"bomb": bytes(3 << 20)}))
    real = (3 << 20).to_bytes(4, "little")
    for _ in range(2):  # local and central header
        at = content.index(real)
        content[at : at + 4] = (10).to_bytes(4, "little")
    refused(write(tmp_path, "liar.zip", bytes(content)), tmp_path, "damaged|over 1 MB", max_bytes=1 << 20)


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


def test_a_tar_that_goes_on_without_end_is_refused(tmp_path):
    stream = gzip.compress(gzip.decompress(tgz(GOOD)) + bytes(65 << 20), 1)
    refused(write(tmp_path, "long.tgz", stream), tmp_path, "goes on after its end")


def test_an_encrypted_member_is_named(tmp_path):
    content = bytearray(zipped({"secret": b"1"}))
    content[6] |= 1  # flags of the local header
    content[content.index(b"PK\x01\x02") + 8] |= 1  # and of the central directory
    refused(write(tmp_path, "locked.zip", bytes(content)), tmp_path, "'secret' is encrypted")


def test_a_file_in_the_place_of_a_folder_is_not_called_damage(tmp_path):
    archive = write(tmp_path, "clash.zip", zipped({"a": b"1", "a/b": b"2"}))
    refused(archive, tmp_path, r"clash\.zip cannot be unpacked: .*(exists|Not a directory)")


def test_a_web_page_is_no_archive(tmp_path):
    page = write(tmp_path, "mug.tgz", b"<html>not found</html>")
    refused(page, tmp_path, "neither a zip nor a tar archive.*web page")
    refused(write(tmp_path, "empty.zip", b""), tmp_path, "neither a zip nor a tar archive")
