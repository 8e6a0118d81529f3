import os
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from disks import no_space, small_disk
from PIL import Image
from refusals import refused

from objectfolder.base.arrays import (
    read_npz,
    read_safetensors,
    write_npy,
    write_npz,
    write_png,
    write_safetensors,
)
from objectfolder.base.io import (
    atomic,
    check_output,
    file_digest,
    keep,
    read_json,
    write_bytes,
    write_curve,
    write_json,
)
from objectfolder.base.locks import private_path, remove_abandoned
from objectfolder.hub.importer.checkpoint import read_released
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.nets.fit import CurvePoint
from objectfolder.sound.recordings import read_recording
from objectfolder.workspace.layout import Build

ARRAYS = {"a": np.arange(12.0).reshape(3, 4), "b": np.int8([1, 2]), "c": np.float64(0.5)}


def names(folder):
    return sorted(p.name for p in folder.iterdir())


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xef\xbb\xbf\n<!DOCTYPE html>\n<html>", "XML or HTML"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a Git LFS pointer, not the file itself"),
        (b"\x1f\x8b" + bytes(99), "a .gz archive"),
    ],
)
@pytest.mark.parametrize(
    ("read", "name"),
    [
        (read_released, "a.pth"),
        (read_safetensors, "a.safetensors"),
        (load_mesh, "a.ply"),
        (read_recording, "a.wav"),
    ],
)
def test_what_servers_leave_in_place_of_a_file_is_named(tmp_path, read, name, content, words):
    (tmp_path / name).write_bytes(content)
    refused(words, read, tmp_path / name)


@pytest.mark.parametrize("before", [None, "old"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_a_failure_leaves_what_was_there(tmp_path, error, before):
    file = tmp_path / "deep" / "a.txt"
    if before is not None:
        file.parent.mkdir()
        file.write_text(before)

    def failing():
        with atomic(file) as path:
            path.write_text("half")
            raise error

    with pytest.raises(error):
        failing()
    assert [path.read_text() for path in file.parent.iterdir()] == [before] * (before is not None)


def test_the_file_appears_at_once_and_complete(tmp_path):
    (tmp_path / "a.npz").write_text("old")
    with atomic(tmp_path / "a.npz") as path:
        assert path.suffix == ".npz"
        assert path.parent == tmp_path
        path.write_text("new")
        assert (tmp_path / "a.npz").read_text() == "old"
    assert (tmp_path / "a.npz").read_text() == "new"
    assert names(tmp_path) == ["a.npz"]


def test_a_directory_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    message = r"cannot write .*file/sub/a\.txt.*make the directory .* writable"
    refused(message, write_bytes, tmp_path / "file" / "sub" / "a.txt", b"")


def test_npz_round_trip_and_same_bytes_at_any_time(tmp_path, monkeypatch):
    write_npz(tmp_path / "a.npz", **ARRAYS)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    monkeypatch.setattr(time, "localtime", lambda *_: time.gmtime(2_000_000_000))
    write_npz(tmp_path / "b.npz", **ARRAYS)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = read_npz(tmp_path / "a.npz", *ARRAYS)
    assert back.keys() == ARRAYS.keys()
    for name, value in ARRAYS.items():
        np.testing.assert_array_equal(back[name], value)
        assert back[name].dtype == np.asarray(value).dtype


def test_npy_round_trip_and_nothing_pickled(tmp_path):
    write_npy(tmp_path / "a.npy", ARRAYS["a"].T)
    with pytest.raises(ValueError, match="pickle"):
        write_npy(tmp_path / "a.npy", np.array([{}], object))
    assert names(tmp_path) == ["a.npy"]
    back = np.load(tmp_path / "a.npy", allow_pickle=False)
    np.testing.assert_array_equal(back, ARRAYS["a"].T)
    assert back.dtype == ARRAYS["a"].dtype


def test_safetensors_round_trip_with_same_bytes_and_rights_as_other_files(tmp_path):
    header = {"kind": "gains", "net": {"width": 3, "a": 1.5}}
    tensors = {"x": np.arange(6, dtype=np.float16).reshape(2, 3), "y": np.int8([1]), "t": ARRAYS["a"].T}
    write_safetensors(tmp_path / "a.safetensors", tensors, header)
    turned = (dict(reversed(values.items())) for values in (tensors, header))
    write_safetensors(tmp_path / "b.safetensors", *turned)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    back, back_header = read_safetensors(tmp_path / "a.safetensors")
    assert back_header == header
    for name, value in tensors.items():
        np.testing.assert_array_equal(back[name], value)
    write_json(tmp_path / "a.json", {})
    assert len({path.stat().st_mode for path in tmp_path.iterdir()}) == 1


def test_objects_are_neither_written_nor_read(tmp_path):
    with pytest.raises(TypeError, match="a would be pickled"):
        write_npz(tmp_path / "a.npz", a=np.array([{}], object))
    assert names(tmp_path) == []
    np.savez(tmp_path / "a.npz", a=np.array([{}], object))
    refused(r"a\.npz is damaged .*delete it and rebuild", read_npz, tmp_path / "a.npz")


def test_damage_and_missing_arrays_are_named(tmp_path):
    path = tmp_path / "a.npz"
    write_npz(path, **ARRAYS)
    refused(r"a\.npz lacks x, y \(it holds a, b, c\)", read_npz, path, "a", "y", "x")
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        middle = archive.infolist()[0].header_offset + 60
    changed = whole[:middle] + b"XXXX" + whole[middle + 4 :]
    for content in (b"", whole[:-40], whole[:20], b"\x80garbage", changed):
        path.write_bytes(content)
        refused(r"a\.npz is damaged", read_npz, path, "a")


@pytest.mark.parametrize("reader", [read_npz, read_json, read_safetensors, file_digest])
def test_a_missing_file_says_how_to_build_it_and_a_folder_that_it_is_one(tmp_path, reader):
    refused("does not exist; build it", reader, tmp_path / "none.npz")
    refused("is a folder; expected a file", reader, tmp_path)
    refused("/dev/null is a device; expected a file", reader, "/dev/null")


def test_json(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": 1, "a": [1.5, None]})
    assert read_json(path) == {"b": 1, "a": [1.5, None]}
    assert path.read_text().index('"a"') < path.read_text().index('"b"')
    for content in (b"{", b"", b"\xff\xfe\x00"):
        path.write_bytes(content)
        refused(r"a\.json is damaged", read_json, path)
    with pytest.raises(TypeError):
        write_json(tmp_path / "b.json", {"a": object()})
    assert names(tmp_path) == ["a.json"]
    name = "x" * 245 + ".json"
    write_json(tmp_path / name, 1)
    assert names(tmp_path) == ["a.json", name]


def test_a_curve_leaves_the_clock_out(tmp_path):
    for name, seconds in (("a", 1.0), ("b", 2.0)):
        write_curve(tmp_path / name, [CurvePoint(10, 0.5, 0.25, seconds)])
    texts = {path.read_text() for path in tmp_path.iterdir()}
    assert texts == {"step,train_loss,val_loss\n10,0.5,0.25\n"}


def test_png_and_digest(tmp_path, rng):
    (tmp_path / "a").write_bytes(b"abc")
    assert file_digest(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    image = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", image)
    with Image.open(tmp_path / "a.png") as back:
        np.testing.assert_array_equal(np.asarray(back), image)


def test_every_path_lies_in_the_workspace(tmp_path):
    build = Build("mug", tmp_path)
    paths = [v for v in vars(build).values() if hasattr(v, "parts")]
    paths += [build.views("train"), build.touch("val"), build.net("audio"), build.curve("audio")]
    assert len(set(paths)) == len(paths)
    for path in paths:
        assert path.is_relative_to(tmp_path)
    assert build.metrics == tmp_path / "metrics" / "mug.json"
    assert build.views("train") == tmp_path / "build/mug/views/train.npz"


@pytest.mark.parametrize("links", [True, False])
def test_what_is_kept_outlives_the_file(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr("os.link", Mock(side_effect=OSError("no links on this filesystem")))
    for text in ("one", "two"):  # the second replaces the first
        (tmp_path / "a").write_text(text)
        for _ in range(2):
            keep(tmp_path / "a", tmp_path / "kept")
            assert names(tmp_path) == ["a", "kept"]
        assert (tmp_path / "a").samefile(tmp_path / "kept") == links
        (tmp_path / "a").unlink()
        assert (tmp_path / "kept").read_text() == text


def test_two_writers_at_once_leave_one_whole_file(tmp_path):
    path = tmp_path / "a.txt"
    with atomic(path) as first:
        first.write_text("first")
        with atomic(path) as second:
            assert second != first
            assert second.suffix == ".txt"
            second.write_text("second, longer")
        assert path.read_text() == "second, longer"
        assert first.read_text() == "first"
    assert path.read_text() == "first"
    assert names(tmp_path) == ["a.txt"]

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda number: write_json(path, [number] * 1000), range(200)))
    assert read_json(path) == read_json(path)[:1] * 1000
    assert names(tmp_path) == ["a.txt"]


KILLED = """
import os, sys
from objectfolder.base.io import atomic
with atomic(sys.argv[1]) as path:
    path.write_text("half")
    os.kill(os.getpid(), 9)
"""


def test_what_killed_writers_left_goes_with_the_next_that_writes_there_and_nothing_else(tmp_path):
    for _ in range(2):
        subprocess.run([sys.executable, "-c", KILLED, tmp_path / "a.txt"], check=False)
    left = [name for name in names(tmp_path) if ".tmp" in name]
    assert len(left) == 1  # the second has removed that of the first
    lent = private_path(tmp_path / "linked.txt")
    others = {
        ".a.tmp.txt": lambda path: path.write_text("of the user"),
        private_path(tmp_path / "folder.d").name: Path.mkdir,
        private_path(tmp_path / "link.txt").name: lambda path: path.symlink_to("/etc/hostname"),
        private_path(tmp_path / "pipe.txt").name: os.mkfifo,
        lent.name: lambda path: (path.write_text("kept"), (tmp_path / "kept").hardlink_to(path)),
    }
    for name, make in others.items():
        make(tmp_path / name)
    with atomic(tmp_path / "b.txt") as path:  # of a writer that lives
        remove_abandoned(tmp_path)
        path.write_text("whole")
    assert names(tmp_path) == sorted({*others, "b.txt", "kept"})


def test_a_place_is_tested_before_the_work_and_nothing_is_left(tmp_path):
    check_output(tmp_path / "new" / "a.txt")
    assert names(tmp_path / "new") == []
    (tmp_path / "file").write_text("old")
    check_output(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "old"
    for bad in (tmp_path / "file" / "a.txt", tmp_path, Path("/proc/a.txt")):
        refused("cannot write", check_output, bad)


def full(*_, **__):
    raise no_space()


def copied_to_full(source, target):
    raise no_space(str(source), None, str(target))


WRITERS = {
    "fsync": ("os.fsync", full, lambda path: write_json(path, 1)),
    "arrays": ("numpy.savez_compressed", full, lambda path: write_npz(path, **ARRAYS)),
    "picture": ("PIL.Image.Image.save", full, lambda path: write_png(path, np.zeros((2, 2), np.uint8))),
    "copy": ("shutil.copyfile", copied_to_full, lambda path: keep(path.with_name("source"), path)),
}


@pytest.mark.parametrize("how", WRITERS)
def test_a_full_disk_names_the_file_that_was_being_written(tmp_path, monkeypatch, how):
    (tmp_path / "source").write_text("x")
    name, failure, write = WRITERS[how]
    monkeypatch.setattr("os.link", full)
    monkeypatch.setattr(name, failure)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.out'$") as found:
        write(tmp_path / "a.out")
    assert found.value.filename == str(tmp_path / "a.out")
    assert names(tmp_path) == ["source"]


NOISE = np.random.default_rng(0).integers(0, 256, (300, 300), np.uint8)
LARGE = {
    "bytes": lambda path: write_bytes(path, NOISE.tobytes()),
    "json": lambda path: write_json(path, NOISE.tolist()),
    "npz": lambda path: write_npz(path, a=NOISE),
    "npy": lambda path: write_npy(path, NOISE),
    "png": lambda path: write_png(path, NOISE),
    "safetensors": lambda path: write_safetensors(path, {"a": NOISE}, {}),
}


@pytest.mark.parametrize("how", LARGE)
def test_a_small_disk_names_the_file_and_keeps_the_old_one(tmp_path, how):
    path = tmp_path / "disk" / f"a.{how}"
    with small_disk(path.parent, "48k"):
        path.write_text("old")
        with pytest.raises(OSError, match=rf"No space left on device: '{path}'$"):
            LARGE[how](path)
        assert path.read_text() == "old"
        assert names(path.parent) == [path.name]


@pytest.mark.parametrize("error", [RuntimeError("enforce fail"), OSError("9 requested and 4 written")])
def test_a_library_that_hides_a_full_disk_is_understood(tmp_path, monkeypatch, error):
    def failing():
        with atomic(tmp_path / "a.pt"):
            raise error

    with pytest.raises(type(error)) as found:
        failing()
    assert found.value is error
    monkeypatch.setattr("objectfolder.base.io.free_bytes", lambda path: 100)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.pt'"):
        failing()


@pytest.mark.parametrize("name", ["", ".", "/"])
def test_a_path_without_a_name_is_refused(name):
    refused("expected a file's name", write_json, name, 1)
