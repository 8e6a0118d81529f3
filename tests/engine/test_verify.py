"""`verify` finds every way in which bytes can go bad, and `--repair` brings them back and loses nothing."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from objectfolder.engine.build import build
from objectfolder.engine.verify import verify

from .conftest import KEYS, PIPELINE, spoil

SIZES = {key: {"size": size} for size, key in enumerate(KEYS)}


@pytest.fixture(scope="module")
def built(tmp_path_factory, make):
    """Objects of different sizes: equal files are one object in the cache."""
    workspace = make(tmp_path_factory.mktemp("built") / "workspace", PIPELINE)
    workspace.params(**SIZES)
    assert build(root=workspace.root).ok
    workspace.ran()
    return workspace


@pytest.fixture
def workspace(built, tmp_path):
    return built.copy(tmp_path / "workspace")


def outputs(workspace):
    files = (path for folder in ("build", "metrics") for path in (workspace.root / folder).rglob("*"))
    return {
        path: path.read_bytes()
        for path in files
        if path.is_file() and ".logs" not in path.parts and path.suffix != ".tmp"
    }


def objects(workspace):
    folder = workspace.root / ".dvc/cache/files/md5"
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.suffix != ".tmp"}


def found(workspace, *targets, **options):
    report = verify(targets, workspace.root, **options)
    return {(one.address, one.path) for one in report.findings}


def check_repaired(workspace, before, ran=()):
    """Repair; everything is as it was, and only these stages ran."""
    report = verify((), workspace.root, repair=True)
    assert report.findings == ()
    assert workspace.ran() == sorted(ran)
    assert outputs(workspace) == before[0]
    assert objects(workspace) == before[1]
    assert build(root=workspace.root).counts()["skipped"] == 9


def test_a_sound_workspace_is_read_once_and_not_changed(workspace):
    before = outputs(workspace), objects(workspace)
    report = verify((), workspace.root, repair=True)
    assert report.findings == ()
    # 4 outputs of each object (metrics are not in the lock's cache, but in that of the run cache), 3 lists.
    assert report.files == len(before[0]) + len(before[1])
    assert report.bytes_read == sum(map(len, (*before[0].values(), *before[1].values())))
    assert (outputs(workspace), objects(workspace)) == before
    assert verify(["solve@mug"], workspace.root).files == 5


def test_dvc_does_not_see_what_verify_finds_and_repairs(workspace):
    before = outputs(workspace), objects(workspace)
    workspace.dvc("status")  # notes times and sizes
    spoil(workspace.cached("build/mug/prepare.txt"))
    spoil(workspace.root / "build/bowl/prepare.txt")
    assert "up to date" in workspace.dvc("status")
    report = verify((), workspace.root)
    said = {one.path: (one.key, one.stage, one.problem, one.remedy) for one in report.findings}
    assert said == {
        "build/mug/prepare.txt": (
            "mug",
            "prepare",
            "its object in the cache is damaged (1 saved runs would restore it)",
            "--repair copies the checked-out file there",
        ),
        "build/bowl/prepare.txt": (
            "bowl",
            "prepare",
            "differs from what was recorded",
            "--repair takes it from the cache",
        ),
    }
    assert found(workspace, "bell") == set()
    check_repaired(workspace, before)


@pytest.mark.parametrize("how", [spoil, Path.unlink])
@pytest.mark.parametrize(
    "path",
    [
        "build/mug/prepare.txt",
        *(
            pytest.param(path, marks=pytest.mark.slow)
            for path in ("build/mug/solve/a.txt", "metrics/mug.json")
        ),
    ],
)
def test_a_bad_or_missing_file_comes_back(workspace, path, how):
    before = outputs(workspace), objects(workspace)
    how(workspace.root / path)
    address = {"p": "prepare@mug", "s": "solve@mug"}.get(
        path.split("/")[2][0] if "build" in path else "", "pack@mug"
    )
    assert found(workspace) == {(address, path)}
    check_repaired(workspace, before)


@pytest.mark.parametrize("how", [spoil, Path.unlink])
def test_what_is_bad_in_both_places_is_rebuilt(workspace, how):
    before = outputs(workspace), objects(workspace)
    for path in ("build/mug/prepare.txt", "build/bell/prepare.txt"):
        how(workspace.cached(path))
        how(workspace.root / path)
    check_repaired(workspace, before, ran=["prepare@bell", "prepare@mug"])


def test_hardlinked_copies_go_bad_together_and_are_rebuilt(workspace):
    workspace.dvc("config", "cache.type", "hardlink")
    workspace.dvc("checkout", "--relink")
    path = workspace.root / "build/mug/prepare.txt"
    assert path.stat().st_ino == workspace.cached("build/mug/prepare.txt").stat().st_ino
    before = outputs(workspace), objects(workspace)
    spoil(path)
    assert len(verify(("prepare@mug",), workspace.root).findings) == 2
    assert verify(("prepare@mug",), workspace.root).files == 1
    check_repaired(workspace, before, ran=["prepare@mug"])


@pytest.mark.parametrize("how", [spoil, Path.unlink])
def test_a_bad_list_of_a_directory_is_written_again_or_the_directory_rebuilt(workspace, how):
    before = outputs(workspace), objects(workspace)
    how(workspace.cached("build/mug/solve"))
    assert found(workspace) == {("solve@mug", "build/mug/solve")}
    check_repaired(workspace, before)
    how(workspace.cached("build/mug/solve"))
    spoil(workspace.root / "build/mug/solve/a.txt")
    check_repaired(workspace, before, ran=["solve@mug"])


def test_a_stray_file_in_an_output_is_found_and_removed(workspace):
    before = outputs(workspace), objects(workspace)
    (workspace.root / "build/mug/solve/stray.txt").write_text("stray")
    assert found(workspace) == {("solve@mug", "build/mug/solve/stray.txt")}
    check_repaired(workspace, before)


def test_what_only_earlier_states_refer_to_is_read_too_and_not_brought_back_bad(workspace):
    old = workspace.cached("build/mug/prepare.txt")
    workspace.params(mug={"size": 7})
    build(root=workspace.root)
    workspace.ran()
    assert workspace.cached("build/mug/prepare.txt") != old
    spoil(old)
    (finding,) = verify((), workspace.root).findings
    assert (finding.address, finding.path) == ("", str(old.relative_to(workspace.root)))
    assert "saved runs would restore it" in finding.problem
    assert found(workspace, "mug") == set()
    assert verify((), workspace.root, repair=True).findings == ()
    assert not old.exists()
    workspace.params(**SIZES)
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["prepare@mug"]
    assert workspace.cached("build/mug/prepare.txt") == old
    assert found(workspace) == set()


@pytest.fixture
def sources(make_workspace):
    """A workspace with a tracked source, and a stage that copies it."""
    workspace = make_workspace(
        "stages:\n  copy: {cmd: cp data/x.txt out.txt, deps: [data], outs: [out.txt]}\n"
    )
    (workspace.root / "data").mkdir()
    (workspace.root / "data/x.txt").write_text("one")
    workspace.dvc("add", "-q", "data")
    assert build(root=workspace.root).ok
    return workspace


def test_a_changed_source_is_told_but_never_overwritten(sources):
    source = sources.root / "data/x.txt"
    (sources.root / "out.txt").unlink()
    source.unlink()
    assert verify((), sources.root, repair=True).findings == ()
    assert source.read_text() == "one"
    source.unlink()
    source.write_text("my edit")
    (finding,) = verify((), sources.root, repair=True).findings
    assert (finding.address, finding.path) == ("data.dvc", "data/x.txt")
    assert "`dvc commit data.dvc`" in finding.remedy
    assert source.read_text() == "my edit"


def test_a_source_that_is_gone_everywhere_is_said_not_to_be_rebuildable(sources):
    for path in (*sources.root.glob("data/*"), *sources.root.glob("out.txt")):
        path.unlink()
    for path in (sources.root / ".dvc/cache/files").rglob("*"):
        if path.is_file() and not path.name.endswith(".dir"):
            path.unlink()
    report = verify((), sources.root, repair=True)
    assert {one.path for one in report.findings} == {"data/x.txt", "out.txt"}
    assert any("`dvc pull data.dvc`" in one.remedy for one in report.findings)


KILLED = """
import os, signal, sys
from objectfolder.engine.verify import verify

left = int(sys.argv[1])

def hook(event, arguments):
    global left
    if event in ("os.remove", "os.rename", "os.chmod") and os.path.abspath("") in str(arguments[0]):
        left -= ".dvc/tmp" not in str(arguments[0])
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(hook)
sys.exit(bool(verify((), ".", repair=True).findings))
"""


def kill_repair(workspace, steps):
    """Kill a repair before it removes, renames or protects its n-th file; whether it got that far."""
    before = outputs(workspace), objects(workspace)
    spoil(workspace.cached("build/mug/prepare.txt"))
    spoil(workspace.root / "build/bowl/pack.txt")
    workspace.cached("build/bell/solve").unlink()
    done = subprocess.run([sys.executable, "-c", KILLED, str(steps)], cwd=workspace.root)
    assert verify((), workspace.root, repair=True).findings == ()
    assert workspace.ran() == []  # all that is good was still somewhere
    assert (outputs(workspace), objects(workspace)) == before
    assert done.returncode in (0, -signal.SIGKILL)
    return done.returncode != 0


@pytest.mark.slow
def test_a_repair_killed_at_any_point_loses_nothing(workspace):
    steps = 0
    while kill_repair(workspace, steps):
        steps += 1
    assert steps > 7
