"""Workspaces of strangers: links in them are not followed, and code of their own is named."""

import shutil
from pathlib import Path

import pytest

from objectfolder.base.errors import ObjectFolderError
from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.dvc.lockfile import COPIES
from objectfolder.engine.verify import verify
from objectfolder.workspace.installed import INSTALLED
from objectfolder.workspace.template import foreign_code

MESSAGE = "this build runs code of the workspace that is not as objectfolder has it: "


def said(caplog):
    """What builds said of a workspace's own code since the last call."""
    found = [record.getMessage() for record in caplog.records if MESSAGE in record.getMessage()]
    caplog.clear()
    return [text.removeprefix(MESSAGE).partition(";")[0] for text in found]


def test_code_of_a_workspace_is_named_once_until_it_changes(workspace, caplog, tmp_path):
    def built(place):
        assert build(["prepare@mug"], root=place).ok
        return said(caplog)

    root = workspace.root
    (root / "stages").mkdir()
    (root / "stages/own.py").write_text("pass\n")
    shutil.copy(INSTALLED / "stages/modal.py", root / "stages")  # as the package has it
    (root / "stages/link.py").symlink_to("/etc/hostname")
    assert built(root) == ["dvc.yaml, stages/link.py, stages/own.py, steps.py"]
    assert built(root) == []
    (root / "numpy").mkdir()
    (root / "numpy/__init__.py").write_text("")  # Python would find it before the library
    assert built(root) == ["dvc.yaml, numpy/__init__.py, stages/link.py, stages/own.py, steps.py"]
    assert built(root) == []
    # A record that a clone brings along is not believed.
    shutil.copytree(root, tmp_path / "clone", symlinks=True)
    assert (tmp_path / "clone" / COPIES / "foreign_code.sha256").is_file()
    assert len(built(tmp_path / "clone")) == 1
    assert foreign_code(INSTALLED, [INSTALLED / "dvc.yaml"]) == {}


@pytest.mark.parametrize("place", ["build", "build/mug", "build/.logs", COPIES.as_posix()])
def test_folders_that_are_links_are_refused(workspace, place, tmp_path):
    (tmp_path / "home").mkdir()
    path = workspace.root / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(tmp_path / "home")
    with pytest.raises(ObjectFolderError, match=rf"{place} is a link, which DVC does not follow; make it a"):
        build(["prepare@mug"], root=workspace.root)
    assert list((tmp_path / "home").iterdir()) == []


def test_logs_and_records_that_are_links_are_replaced(workspace, tmp_path):
    names = ("build/.logs/prepare@mug.log", "build/.logs/prepare@mug.cost", f"{COPIES}/dvc.lock.json")
    for i, name in enumerate(names):
        path = workspace.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(tmp_path / str(i))
    assert build(["prepare@mug"], root=workspace.root).ok
    assert not any((workspace.root / name).is_symlink() for name in names)
    assert not any((tmp_path / str(i)).exists() for i in range(len(names)))


def test_a_remote_writes_nothing_but_saved_runs(workspace, tmp_path):
    remote = tmp_path / "remote"
    workspace.dvc("remote", "add", "-d", "store", str(remote))
    assert build(root=workspace.root).ok
    workspace.dvc("push", "--run-cache")
    (runs,) = [path for path in remote.rglob("runs") if path.is_dir()]
    (runs / "zz").mkdir()
    (runs / "zz/evil").write_text("cmd: evil\n")
    shutil.rmtree(workspace.root / ".dvc/cache")
    assert build(root=workspace.root, options=BuildOptions(pull=True)).ok
    held = workspace.root / ".dvc/cache/runs"
    assert len([path for path in held.glob("*/*/*") if path.is_file()]) >= 9
    assert not (held / "zz").exists()


def test_repair_writes_no_object_through_a_link(workspace, tmp_path):
    assert build(root=workspace.root).ok
    victim = tmp_path / "victim"
    victim.write_text("precious")
    bad = next(
        path
        for path in (workspace.root / ".dvc/cache/files").rglob("*")
        if path.is_file() and "." not in path.name
    )
    bad.unlink()
    bad.symlink_to(victim)
    verify(root=workspace.root, repair=True)
    assert victim.read_text() == "precious"
    assert not Path(bad).is_symlink()
