import fcntl
import json
import os
import time

import pytest

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.dvc.graph import stage_graph
from objectfolder.engine.dvc.recorded import other_files
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.engine.unchanged import CLOCK, MOST, NOTES, recall, remember

from .conftest import PIPELINE, everything, spoil


@pytest.fixture(scope="module")
def built(make, tmp_path_factory):
    workspace = make(tmp_path_factory.mktemp("built") / "workspace", PIPELINE)
    (workspace.root / "folder").mkdir()
    assert build(root=workspace.root).ok
    with open_repository(workspace.root) as repository:
        workspace.others = other_files(repository, stage_graph(repository).stages.values())
    return workspace


def settle():
    time.sleep(1.2 * CLOCK / 1e9)
    return time.time_ns()


def test_a_build_notes_that_nothing_is_to_do(workspace):
    for _ in range(2):
        assert recall(["mug"], workspace.root) is None
        summary = build(["mug"], BuildOptions(remember=settle()), workspace.root)
    assert {result.status for result in summary.stages.values()} == {"skipped"}
    events = []
    recalled = recall(["mug"], workspace.root, events.append)
    assert list(recalled.stages.items()) == list(summary.stages.items())
    assert len(events) == 4
    assert recall(root=workspace.root) is None
    workspace.dvc("status")
    assert recall(["mug"], workspace.root) is not None
    workspace.params(mug={"material": "glass"})
    build(["mug"], BuildOptions(remember=settle()), workspace.root)
    assert recall(["mug"], workspace.root) is None


def test_some_choices_of_targets_are_remembered(built):
    for number in range(MOST + 1):
        remember([f"{number}"], built.root, everything(), built.others, settle())
    assert [recall([f"{number}"], built.root) is None for number in range(MOST + 1)] == [True] + [
        False
    ] * MOST


def test_a_change_meanwhile_is_not_forgotten(built):
    since = settle()
    (built.root / "steps.py").touch()
    remember(["meanwhile"], built.root, everything(), built.others, since)
    assert recall(["meanwhile"], built.root) is None


def write_config(workspace):
    (workspace.root / ".dvc/config.local").write_text("[core]\n    autostage = false\n")


CHANGES = {
    "parameter": lambda w: w.params(mug={"size": 2}),
    "parameter, taken back": lambda w: (w.params(mug={"size": 2}), w.params()),
    "code": lambda w: (w.root / "steps.py").touch(),
    "pipeline": lambda w: (w.root / "dvc.yaml").touch(),
    "record": lambda w: (w.root / "dvc.lock").touch(),
    "output, of the same times and size": lambda w: spoil(w.root / "build/mug/pack.txt"),
    "missing output": lambda w: (w.root / "build/mug/prepare.txt").unlink(),
    "file among outputs": lambda w: (w.root / "build/mug/solve/b.txt").touch(),
    "mode": lambda w: (w.root / "build/bell/prepare.txt").chmod(0o600),
    "cached object": lambda w: spoil(w.cached("build/bell/solve/a.txt")),
    "missing cached object": lambda w: w.cached("build/bell/pack.txt").unlink(),
    "half copy in the cache": lambda w: (w.cached("build/mug/pack.txt").parent / "x.tmp").touch(),
    "stages of another folder": lambda w: (w.root / "folder/dvc.yaml").touch(),
    "settings of DVC": write_config,
    "link to a folder": lambda w: (w.root / "link").symlink_to("folder"),
    "note": lambda w: (w.root / NOTES).write_text("[1]"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_is_seen(built, change):
    remember([], built.root, everything(), built.others, settle())
    assert sorted(recall(root=built.root).stages) == everything()
    CHANGES[change](built)
    assert recall(root=built.root) is None
    (built.root / "link").unlink(missing_ok=True)


def test_a_file_that_came_and_went_is_no_change(built):
    remember([], built.root, everything(), built.others, settle())
    (built.root / "build/.writable").touch()
    (built.root / "build/.writable").unlink()
    assert recall(root=built.root) is not None
    since = settle()
    (built.root / "build/.writable").touch()
    (built.root / "build/.writable").unlink()
    remember(["other"], built.root, everything(), built.others, since)
    assert recall(["other"], built.root) is None


def test_a_workspace_in_use_is_left_to_the_build(built, monkeypatch):
    remember([], built.root, everything(), built.others, settle())
    with (built.root / ".dvc/tmp/lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert recall(root=built.root) is None
    busy = built.root / ".dvc/tmp/rwlock"
    busy.write_text(
        json.dumps({"write": {"build/mug/pack.txt": {"pid": os.getpid(), "cmd": "x"}}, "read": {}})
    )
    assert recall(root=built.root) is None
    busy.write_text("{}")
    assert recall(root=built.root) is not None
    monkeypatch.setenv("DVC_GLOBAL_CONFIG_DIR", "elsewhere")
    assert recall(root=built.root) is None


def test_a_change_of_the_package_is_seen(built, tmp_path, monkeypatch):
    monkeypatch.setattr("objectfolder.engine.unchanged.INSTALLED", tmp_path)
    (tmp_path / "objectfolder").mkdir()
    (tmp_path / "objectfolder/module.py").touch()
    remember([], built.root, everything(), built.others, settle())
    assert recall(root=built.root) is not None
    (tmp_path / "objectfolder/module.py").write_text("1")
    assert recall(root=built.root) is None


@pytest.mark.parametrize("dep", ["/etc/hostname", ".hidden", "../beside", "https://example.org/x"])
def test_what_is_elsewhere_is_asked_each_time(make_workspace, dep):
    workspace = make_workspace(f"stages: {{a: {{cmd: echo 1 > a, deps: ['{dep}'], outs: [a]}}}}")
    with open_repository(workspace.root) as repository:
        assert other_files(repository, stage_graph(repository).stages.values()) is None


def test_a_graph_in_a_hidden_folder_is_asked_each_time(make_workspace):
    workspace = make_workspace("stages: {a: {cmd: echo 1 > a, deps: [b], outs: [a]}}")
    (workspace.root / ".hidden").mkdir()
    text = "stages: {b: {cmd: echo 1 > ../b, deps: [../steps.py], outs: [../b]}}"
    (workspace.root / ".hidden/dvc.yaml").write_text(text)
    with open_repository(workspace.root) as repository:
        stages = stage_graph(repository).stages
        assert len(stages) == 2
        assert other_files(repository, stages.values()) is None
