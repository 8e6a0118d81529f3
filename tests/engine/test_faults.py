"""What can go wrong under a build: nothing that had finished is lost, and the next build completes."""

import errno
import os
import random
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager, suppress

import psutil
import pytest
from disks import mounted, small_disk
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.locks import private_path
from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.dvc.repository import track
from objectfolder.engine.process import Children, open_log
from objectfolder.engine.records import LOGS, log_path
from objectfolder.engine.summary import Finished, StageOutcome
from objectfolder.engine.verify import verify

from .conftest import KEYS, everything, spoil
from .processes import DIE_AT_A_CHANGE, alive, meanwhile, start, started, wait_for

OTHERS = sorted(set(everything()) - {"solve@mug", "pack@mug"})


def names(results):
    return sorted(result.address for result in results)


def enlarge(path, size="16m"):
    subprocess.run(["mount", "-o", f"remount,size={size}", path], check=True)


def content(workspace):
    """Contents of all outputs."""
    files = [*(workspace.root / "build").rglob("*.txt"), *(workspace.root / "metrics").rglob("*.json")]
    return {path.relative_to(workspace.root).as_posix(): path.read_bytes() for path in files}


def half_copies(workspace):
    return [path for path in (workspace.root / ".dvc/cache/files").rglob("*") if path.name.endswith(".tmp")]


# Killed


@pytest.mark.parametrize("whom", [pytest.param("command", marks=pytest.mark.slow), "supervisor"])
def test_killed_stage_is_said_in_words_and_its_half_output_is_not_taken(workspace, whom):
    workspace.control("prepare@mug", "half")
    half = workspace.root / "build/mug/prepare.txt"

    def kill():
        wait_for(lambda: half.exists() and half.read_text())
        pid = started(workspace, "prepare@mug")
        os.kill(pid if whom == "command" else psutil.Process(pid).ppid(), signal.SIGKILL)

    with meanwhile(kill):
        summary = build(root=workspace.root)
    (failure,) = summary.failures
    assert (failure.stage, failure.key) == ("prepare", "mug")
    assert "was killed by SIGKILL" in failure.error
    assert names(summary.with_status(StageOutcome.BLOCKED)) == ["pack@mug", "solve@mug"]
    mug = {"pack@mug", "prepare@mug", "solve@mug"}
    assert workspace.locked() == set(everything()) - mug
    wait_for(lambda: not alive(started(workspace, "prepare@mug")))
    workspace.ran()

    workspace.control("prepare@mug", None)
    assert build(root=workspace.root).ok
    assert workspace.ran() == sorted(mug)
    assert half.read_text() == "1"
    workspace.check_clean()


def test_a_stage_does_not_start_beside_a_process_of_an_earlier_run(workspace, monkeypatch):
    monkeypatch.setattr("objectfolder.engine.process.END_TIMEOUT", 0.3)
    log = log_path(workspace.root / LOGS, "prepare@mug")
    log.parent.mkdir(parents=True)
    with open_log(log) as stream:
        left = subprocess.Popen(["sleep", "60"], stdout=stream)
    with left:
        (failure,) = build(["prepare@mug"], root=workspace.root).failures
        left.kill()
    assert f"processes {left.pid} of an earlier run of it still write to {log}" in failure.error
    assert not workspace.ran()
    assert build(["prepare@mug"], root=workspace.root).ok


CHAIN = """
stages:
  one:
    foreach: [a, b, c, d, e, f]
    do:
      cmd: echo one@${item} >> calls && mkdir -p build/${item} && echo ${item} > build/${item}/one
      deps: [seed]
      outs: ["build/${item}/one"]
  two:
    foreach: [a, b, c, d, e, f]
    do:
      cmd: >-
        echo two@${item} >> calls && mkdir build/${item}/two && cp build/${item}/one build/${item}/two/x &&
        echo y > build/${item}/two/y
      deps: ["build/${item}/one"]
      outs: ["build/${item}/two"]
"""

# Dies before its n-th change of a file of the workspace; `finished` names the stages that it has reported.
MORTAL = (
    DIE_AT_A_CHANGE
    + """
import os, signal, sys
from objectfolder.engine import build
from objectfolder.engine.dvc import lockfile
from objectfolder.engine.summary import Finished, StageOutcome

lockfile.PERIOD = lockfile.PERIOD_PER_WRITE = 0.0  # dvc.lock is written after every stage
report = os.open("finished", os.O_WRONLY | os.O_APPEND | os.O_CREAT)

def on_event(event):
    if isinstance(event, Finished) and event.result.status is not StageOutcome.FAILED:
        os.write(report, f"{event.result.address}\\n".encode())

die_at_a_change(int(sys.argv[1]), signal.SIGKILL, os.getcwd())
assert build.build(options=build.BuildOptions(jobs=2), on_event=on_event).ok
"""
)


def test_engine_killed_at_any_change_of_a_file_loses_nothing_that_has_finished(make_workspace):
    workspace = make_workspace(CHAIN)
    (workspace.root / "seed").write_text("x")
    calls, finished = workspace.root / "calls", workspace.root / "finished"
    moments = random.Random(7)
    kept = set()
    for turn in range(6):
        calls.unlink(missing_ok=True)
        engine = start(workspace, "-c", MORTAL, str(moments.randint(1, 250 * (turn + 1))))
        code = engine.wait(60)
        assert code in (0, -signal.SIGKILL), (workspace.root / "process.log").read_text()
        again = kept.intersection(calls.read_text().split() if calls.exists() else ())
        assert not again
        kept.update(finished.read_text().split())
        if code == 0:
            break
    assert len(kept) > 2  # it got somewhere before it was killed, and not only at the end
    calls.unlink(missing_ok=True)
    assert build(root=workspace.root).ok
    assert not kept.intersection(calls.read_text().split() if calls.exists() else ())
    for key in "abcdef":
        assert (workspace.root / f"build/{key}/two/x").read_text() == f"{key}\n"
        assert (workspace.root / f"build/{key}/two/y").read_text() == "y\n"
    workspace.check_clean()
    assert not half_copies(workspace)


HALF_FILES = (
    "build/.logs/cluster-0a1b.tmp",
    "build/.logs/.prepare@mug.tmp.failed",
    ".dvc/cache/files/md5/.0a1b.tmp",
    ".dvc/cache/files/md5/78/.0a1b.tmp",
    ".dvc/cache/files/md5/78/6783.dir.0a1b.tmp",
    ".dvc/cache/runs/78/6783/.0a1b.tmp",
    "build/mug/.VhHhvrvRl79uOAUOjhXoQg.tmp",
)


def test_half_files_of_a_killed_build_are_removed_though_nothing_runs(workspace):
    build(["prepare@mug"], root=workspace.root)
    left = [*(workspace.root / name for name in HALF_FILES), private_path(workspace.root / "dvc.lock")]
    own = workspace.root / "build/mug/.own.tmp"
    for path in (*left, own):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    assert not build(["prepare@mug"], root=workspace.root).with_status(StageOutcome.RAN)
    assert [path for path in left if path.exists()] == []
    assert own.exists()


# Disks

BULKY = """
stages:
  big:
    cmd: echo big >> calls && mkdir -p build && head -c 1500000 /dev/zero > build/big
    deps: [seed]
    outs: [build/big]
  a_small:
    cmd: echo a_small >> calls && mkdir -p build && echo small > build/small
    deps: [seed]
    outs: [build/small]
"""


@pytest.fixture
def bulky(make_workspace):
    workspace = make_workspace(BULKY)
    (workspace.root / "seed").write_text("x")
    return workspace


@pytest.mark.parametrize("place", ["build", ".dvc/cache"])
def test_full_disk_is_named_and_after_space_is_made_the_rest_is_built(bulky, place):
    with small_disk(bulky.root / place):
        summary = build(root=bulky.root, options=BuildOptions(jobs=1))
        (failure,) = summary.failures
        assert failure.address == "big"
        assert f"the disk of {bulky.root / place}/" in failure.error
        assert "full (0.0 of 1.0 MB free); make space and build again" in failure.error
        assert bulky.locked() == {"a_small"}
        assert not half_copies(bulky)

        enlarge(bulky.root / place)
        (bulky.root / "calls").unlink()
        assert build(root=bulky.root).ok
        assert (bulky.root / "calls").read_text() == "big\n"
        assert (bulky.root / "build/big").stat().st_size == 1_500_000
        bulky.check_clean()


def test_lock_file_that_does_not_fit_keeps_the_old_one_and_loses_nothing(make_workspace, tmp_path):
    workspace = make_workspace(BULKY)
    root = workspace.root
    shutil.move(root, tmp_path / "saved")
    with small_disk(root, "2m"):
        shutil.copytree(tmp_path / "saved", root, dirs_exist_ok=True)
        (root / "seed").write_text("x")
        with mounted("--bind", tmp_path / "saved/.dvc", root / ".dvc"):
            assert build(["a_small"], root=root).ok
            before = (root / "dvc.lock").read_bytes()
            (root / "dvc.yaml").write_text(BULKY.replace("1500000 /dev/zero", "9 /dev/zero"))

            def fill(event):
                if isinstance(event, Finished) and event.result.address == "big":
                    with suppress(OSError), (root / "ballast").open("wb", buffering=0) as stream:
                        while True:
                            stream.write(bytes(4096))

            refused(r"cannot write dvc\.lock: .*disk of .* is full", build, root=root, on_event=fill)
            assert (root / "dvc.lock").read_bytes() == before
            assert not list(root.glob(".*.tmp*"))

            (root / "ballast").unlink()
            (root / "calls").unlink()
            assert build(root=root).ok
            assert not (root / "calls").exists()
            assert workspace.locked() == {"a_small", "big"}
            workspace.check_clean()


@contextmanager
def read_only(place):
    with mounted("--bind", place, place):
        done = subprocess.run(["mount", "-o", "remount,ro,bind", place], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"cannot mount read-only here: {done.stderr}")
        yield


def test_read_only_build_directory_fails_its_stages_and_keeps_what_is_there(workspace):
    build(root=workspace.root)
    before = content(workspace)
    workspace.params(mug={"material": "glass"})
    with read_only(workspace.root / "build"):
        summary = build(root=workspace.root)
    (failure,) = summary.failures
    assert failure.address == "solve@mug"
    assert "Read-only file system" in failure.error
    assert "build/mug/solve" in failure.error
    assert content(workspace) == before
    workspace.ran()
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@mug", "solve@mug"]
    workspace.check_clean()


def test_read_only_cache_is_named_before_a_stage_runs(workspace):
    build(root=workspace.root)
    workspace.ran()
    place = workspace.root / ".dvc/cache"
    with read_only(place):
        assert not build(root=workspace.root).with_status(StageOutcome.RAN)
        workspace.params(mug={"material": "glass"})
        refused(rf"cannot write to {place}.*part of DVC's cache", build, root=workspace.root)
    assert not workspace.ran()
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@mug", "solve@mug"]
    workspace.check_clean()


def test_files_are_copied_where_links_are_refused(make_workspace, monkeypatch):
    """As Linux does with hard links to files of another user: DVC removed the file that it could not link."""
    workspace = make_workspace(
        "stages: {use: {cmd: cp data/mesh.txt copy.txt, deps: [data], outs: [copy.txt]}}\n"
    )
    workspace.dvc("config", "cache.type", "hardlink")
    data = workspace.root / "data/mesh.txt"
    data.parent.mkdir()
    data.write_text("precious\n")

    def link(*_, **__):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    track(data.parent, workspace.root)
    assert build(root=workspace.root).ok
    assert data.read_text() == (workspace.root / "copy.txt").read_text() == "precious\n"


def test_log_directory_that_cannot_be_made_fails_the_stages_with_its_name(workspace):
    (workspace.root / "build").mkdir()
    (workspace.root / "build/.logs").write_text("a file where the directory should be")
    summary = build(["prepare"], root=workspace.root)
    assert len(summary.failures) == len(KEYS)
    assert all("cannot run the command" in failure.error for failure in summary.failures)
    assert all(str(workspace.root / "build/.logs") in failure.error for failure in summary.failures)
    (workspace.root / "build/.logs").unlink()
    assert build(root=workspace.root).ok


# Damaged files


@pytest.mark.parametrize(
    ("stage", "out", "with_lock"),
    [
        ("prepare", "build/mug/prepare.txt", True),
        ("solve", "build/mug/solve/a.txt", False),
        pytest.param("solve", "build/mug/solve", True, marks=pytest.mark.slow),
        pytest.param("pack", "metrics/mug.json", True, marks=pytest.mark.slow),
    ],
)
def test_damaged_cached_object_is_not_delivered_but_built_again(workspace, stage, out, with_lock, caplog):
    build(["mug"], root=workspace.root)
    workspace.ran()
    before = content(workspace)
    spoil(workspace.cached(out))
    shutil.rmtree(workspace.root / "build/mug")
    shutil.rmtree(workspace.root / "metrics")
    if not with_lock:
        (workspace.root / "dvc.lock").unlink()
    assert build(["mug"], root=workspace.root).ok
    assert workspace.ran() == [f"{stage}@mug"]
    assert content(workspace) == before
    assert "is damaged and was removed" in caplog.text
    assert "up to date" in workspace.dvc("status", "prepare@mug", "solve@mug", "pack@mug")


def test_damaged_cached_object_does_not_replace_what_a_stage_wrote(workspace, caplog):
    build(["prepare@mug"], root=workspace.root)
    before = content(workspace)
    spoil(workspace.cached("build/mug/prepare.txt"))
    assert build(["prepare@mug"], BuildOptions(force=True), workspace.root).ok
    assert content(workspace) == before
    assert "is damaged and was removed" in caplog.text
    assert verify(["prepare@mug"], workspace.root, jobs=1).findings == ()


@pytest.mark.parametrize(
    "damaged",
    [
        lambda whole: b"",
        *(
            pytest.param(lambda whole, share=share: whole[: int(len(whole) * share)], marks=pytest.mark.slow)
            for share in (0.01, 0.5, 0.999)
        ),
        lambda whole: b"\x00" * 5000,
        lambda whole: b"\xff\xfe garbage",
        lambda whole: b"stages: 3\n",
    ],
    ids=["empty", "1 %", "half", "99.9 %", "zeros", "not UTF-8", "other YAML"],
)
def test_a_damaged_lock_file_is_restored(workspace, damaged, caplog):
    build(root=workspace.root)
    workspace.ran()
    path = workspace.root / "dvc.lock"
    whole = path.read_bytes()
    path.write_bytes(damaged(whole))
    assert build(root=workspace.root).ok
    assert workspace.ran() == []
    assert path.read_bytes() == whole
    assert "dvc.lock is damaged" in caplog.text
    workspace.check_clean()


@pytest.mark.parametrize(
    ("name", "old", "new"), [("steps.py", b"hello", b"Hello"), ("build/mug/prepare.txt", b"1", b"2")]
)
@pytest.mark.parametrize("years", [0, -50, 70])
def test_edit_shows_though_size_and_time_are_what_they_were(workspace, name, old, new, years):
    """As `cp -p` leaves them, or a clock that was set."""
    path = workspace.root / name
    when = time.time() + years * 365 * 86400
    for _ in range(2):  # the second records that time
        build(["mug"], root=workspace.root)
        os.utime(path, (when, when))
    build(["mug"], root=workspace.root)
    workspace.ran()
    text = path.read_bytes()
    path.chmod(0o644)
    path.write_bytes(text.replace(old, new))
    os.utime(path, (when, when))
    assert build(["mug"], root=workspace.root).ok
    is_source = name == "steps.py"
    assert ("prepare@mug" in workspace.ran()) == is_source
    assert path.read_bytes() == (text.replace(old, new) if is_source else text)


@pytest.mark.parametrize("garbage", ["", '{"write": {', '{"write": 3}', "\x00\x00"])
def test_torn_rwlock_file_is_replaced(workspace, garbage):
    (workspace.root / ".dvc/tmp").mkdir(exist_ok=True)
    (workspace.root / ".dvc/tmp/rwlock").write_text(garbage)
    assert build(["prepare@mug"], root=workspace.root).ok


@pytest.mark.parametrize(
    "broken",
    [
        b"objects: [",
        pytest.param(b"\xff\xfe\x00", marks=pytest.mark.slow),
        pytest.param(None, marks=pytest.mark.slow),
    ],
)
def test_params_broken_during_a_build_are_not_read(workspace, broken):
    path = workspace.root / "params.yaml"
    good = path.read_bytes()

    def break_it(event):
        if isinstance(event, Finished) and path.exists() and path.read_bytes() == good:
            path.unlink()
            if broken is not None:
                path.write_bytes(broken)

    summary = build(root=workspace.root, options=BuildOptions(jobs=1), on_event=break_it)
    assert not path.exists() or path.read_bytes() == broken
    assert names(summary.with_status(StageOutcome.RAN)) == everything()
    with pytest.raises(ObjectFolderError):
        build(root=workspace.root)
    path.write_bytes(good)
    assert build(root=workspace.root).counts()[StageOutcome.SKIPPED] == len(everything())
    workspace.check_clean()


# Stages that misbehave


@pytest.mark.slow
def test_hanging_stage_dies_with_its_children_and_the_rest_is_built(workspace):
    workspace.control("solve@mug", "600")
    path = workspace.root / "dvc.yaml"
    child = "sh -c 'echo $$ > child; exec sleep 600' & python -m steps solve ${key}"
    path.write_text(path.read_text().replace("python -m steps solve ${key}", child))
    summary = build(root=workspace.root, options=BuildOptions(jobs=2, timeout=5))
    (failure,) = summary.failures
    assert failure.address == "solve@mug"
    assert "time limit" in failure.error
    assert failure.seconds >= 5
    assert names(summary.with_status(StageOutcome.RAN)) == OTHERS
    assert not alive(started(workspace, "solve@mug"))
    wait_for(lambda: not alive(int((workspace.root / "child").read_text())))
    workspace.ran()
    workspace.control("solve@mug", None)
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@mug", "solve@mug"]


def test_exception_in_a_worker_fails_its_stage_only(workspace, monkeypatch):
    run = Children.run

    def broken(children, command):
        if "solve mug" in command.lines[0]:
            raise RuntimeError("no more threads")
        return run(children, command)

    monkeypatch.setattr(Children, "run", broken)
    summary = build(root=workspace.root)
    (failure,) = summary.failures
    assert (failure.address, failure.error) == ("solve@mug", "cannot run the command: no more threads")
    assert names(summary.with_status(StageOutcome.RAN)) == OTHERS
    monkeypatch.undo()
    workspace.ran()
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@mug", "solve@mug"]


# Two at once


@pytest.mark.slow
@pytest.mark.parametrize("other", ["build", "dvc repro"])
def test_second_build_can_wait_for_the_first(workspace, other, caplog):
    workspace.control("prepare@mug", "60")
    engine = "from objectfolder.engine.build import build; build()"
    command = ("-c", engine) if other == "build" else ("-m", "dvc", "repro", "prepare@mug")
    first = start(workspace, *command)
    wait_for(lambda: started(workspace, "prepare@mug"))

    def stop_first():
        wait_for(lambda: "waiting until it ends" in caplog.text)
        workspace.control("prepare@mug", None)
        pid = started(workspace, "prepare@mug")
        first.kill()
        first.wait()
        if alive(pid):
            os.kill(pid, signal.SIGKILL)  # dvc leaves its child running

    with meanwhile(stop_first):
        summary = build(root=workspace.root, options=BuildOptions(wait=True))
    assert summary.ok
    assert caplog.text.count("waiting until it ends") == 1
    assert f"process {first.pid}" in caplog.text
    workspace.check_clean()
