"""Folders that are complete or absent, and full disks."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from disks import no_space, small_disk
from folders import contents
from refusals import refused

from objectfolder.base.disk import new_folder, refuse_links


def folder(out, needed=1):
    return new_folder("a release", out, needed, ", or release fewer objects")


def test_a_folder_appears_at_once_as_others_are(tmp_path):
    with folder(tmp_path / "sub" / "out") as new:
        (new / "a").write_text("a")
        assert not (tmp_path / "sub/out").exists()
        assert new.parent == tmp_path / "sub"
    assert contents(tmp_path) == {"sub/out/a": b"a"}
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "sub/out").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_a_failure_leaves_nothing(tmp_path, error):
    def failing():
        with folder(tmp_path / "out") as new:
            (new / "a").write_text("half")
            raise error

    with pytest.raises(error):
        failing()
    assert list(tmp_path.iterdir()) == []


#: What may be at OUT, before or when it is to be placed.
IN_THE_WAY = {
    "folder": Path.mkdir,
    "file": lambda out: out.write_text("mine"),
    "dangling link": lambda out: out.symlink_to("nowhere"),
    "link to a folder": lambda out: out.symlink_to(out.parent / "theirs"),
}


@pytest.mark.parametrize("late", [False, True], ids=["before", "meanwhile"])
@pytest.mark.parametrize("what", IN_THE_WAY)
def test_what_is_there_stays(tmp_path, what, late):
    (tmp_path / "theirs").mkdir()
    out = tmp_path / "out"

    def write():
        with folder(out) as new:
            assert late
            (new / "a").write_text("a")
            IN_THE_WAY[what](out)

    if not late:
        IN_THE_WAY[what](out)
    refused("out exists already: choose another name, or delete it", write)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "theirs"]
    assert contents(tmp_path) == ({"out": b"mine"} if what == "file" else {})


def test_folders_of_others_beside_it_stay_and_what_a_killed_run_left_is_named(tmp_path, caplog):
    for name in (".out.tmp", ".out.tmp-notes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "thesis").write_text("mine")
    command = "import os, sys\nfrom pathlib import Path\nfrom objectfolder.base.disk import new_folder\n"
    command += "with new_folder('x', Path(sys.argv[1]), 1, ''): os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", command, tmp_path / "out"], check=False)
    with folder(tmp_path / "out") as new:
        (new / "a").write_text("a")
    (record,) = caplog.records
    left = [path for path in tmp_path.iterdir() if str(path) in record.getMessage().split(":")]
    assert len(left) == 1
    assert contents(tmp_path) == {".out.tmp/thesis": b"mine", ".out.tmp-notes/thesis": b"mine", "out/a": b"a"}


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_of_two_writers_one_wins_and_nothing_is_mixed(tmp_path, order):
    """Their steps alternate; the order is that in which they end."""

    @contextmanager
    def writer(name):
        with folder(tmp_path / "out") as new:
            (new / "1").write_text(name)
            yield
            (new / "2").write_text(name)

    writers = {name: writer(name) for name in "ab"}
    for name in "ab":
        writers[name].__enter__()
    assert not writers[order[0]].__exit__(None, None, None)
    refused("out exists already", writers[order[1]].__exit__, None, None, None)
    assert contents(tmp_path) == dict.fromkeys(("out/1", "out/2"), order[0].encode())


RACER = """
import sys
from pathlib import Path
from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError

print("ready", flush=True)
for round in map(int, sys.stdin):
    try:
        with new_folder("x", Path(f"out{round}"), 1, "") as new:
            for i in range(5):
                (new / str(i)).write_text(sys.argv[1])
        print("won", flush=True)
    except ObjectFolderError as error:
        print(error, flush=True)
"""


def test_of_four_processes_one_wins_each_time(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    commands = [[sys.executable, "-c", RACER, str(i)] for i in range(4)]
    racers = [subprocess.Popen(each, cwd=tmp_path, **pipes, text=True, bufsize=1) for each in commands]
    assert [racer.stdout.readline() for racer in racers] == ["ready\n"] * 4
    for number in range(50):
        for racer in racers:
            racer.stdin.write(f"{number}\n")
        said = [racer.stdout.readline().strip() for racer in racers]
        assert said.count("won") == 1
        lost = f"out{number} exists already: choose another name, or delete it"
        assert said.count(lost) == 3
        winner = str(said.index("won")).encode()
        assert contents(tmp_path / f"out{number}") == dict.fromkeys("01234", winner)
    for racer in racers:
        racer.communicate()
    assert len(list(tmp_path.iterdir())) == 50


def fail_unnamed(new):
    (new / "first").write_text("whole")
    os.utime(new / "first", (1, 1))
    (new / "sub").mkdir()
    (new / "sub/second").write_text("half")
    raise no_space()


def fail_copying(new):
    raise no_space("source", None, str(new / "sub/second"))


@pytest.mark.parametrize("fail", [fail_unnamed, fail_copying])
def test_a_disk_that_fills_up_names_the_file(tmp_path, fail):
    def failing():
        with folder(tmp_path / "out") as new:
            fail(new)

    words = rf"a release: no space in {tmp_path}/out to write {tmp_path}/out/sub/second: at least 1 bytes"
    refused(rf"^{words} needed, .* make room, or release fewer objects$", failing)
    assert list(tmp_path.iterdir()) == []


def test_a_small_disk_names_the_file(tmp_path):
    place = tmp_path / "disk"
    (tmp_path / "big").write_bytes(bytes(200_000))

    def failing():
        with folder(place / "out") as new:
            (new / "small").write_text("x")
            shutil.copyfile(tmp_path / "big", new / "large")

    with small_disk(place, "100k"):
        refused(rf"no space in {place}/out to write {place}/out/large: ", failing)
        assert list(place.iterdir()) == []


def test_links_below_a_folder_are_refused(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "top").symlink_to("real")  # of the user
    refuse_links(tmp_path / "top/a/b", tmp_path / "top")
    (tmp_path / "real/a").symlink_to("/tmp")
    refused("top/a is a link, expected a folder", refuse_links, tmp_path / "top/a/b", tmp_path / "top")
