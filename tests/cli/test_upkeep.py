"""`status`, `verify` and `prune` where there is no workspace, or one that a build refuses."""

import json
import shutil

import pytest
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_json
from objectfolder.cli import app
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.engine.journal import JOURNAL


@pytest.mark.parametrize(
    "words",
    [
        *(("status",), ("verify",), ("prune",), ("build",), ("report",), ("preset", "quick")),
        *(("fetch", "--list"), ("add", "catalogs/starter.yaml")),
        ("add", "mesh.obj", "--name", "x", "--material", "wood"),
    ],
)
def test_outside_a_workspace_all_commands_say_the_same(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    message = (
        r"params\.yaml does not exist; run inside an objectfolder workspace, or make one: `.* init DIR`$"
    )
    refused(message, app, [*words], standalone_mode=False)


@pytest.mark.parametrize(
    "words",
    [
        *(("status",), ("verify",), ("prune",), ("build",), ("report",), ("preset", "quick"), ("upgrade",)),
        *(("inspect", "normalize@mug"), ("release", "out"), ("add", "catalogs/starter.yaml")),
    ],
)
def test_in_a_subfolder_all_commands_name_the_workspace(workspace, monkeypatch, words):
    (workspace / "data").mkdir(exist_ok=True)
    monkeypatch.chdir(workspace / "data")
    message = f"params.yaml does not exist; run this in the workspace's folder, {workspace.resolve()}"
    with pytest.raises(ObjectFolderError) as caught:
        app([*words], standalone_mode=False)
    assert message in str(caught.value)


def test_a_folder_without_git_says_what_to_do(workspace):
    """As unpacked from a ZIP."""
    shutil.rmtree(workspace / ".git", ignore_errors=True)
    (workspace / ".dvc").mkdir(exist_ok=True)
    (workspace / ".dvc" / "config").write_text("")
    with pytest.raises(ObjectFolderError, match=r"is not a git repository; run `git init` in it, or clone"):
        app(["status"], standalone_mode=False)


def test_a_link_in_place_of_a_folder_is_named(workspace, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (workspace / "build").symlink_to(tmp_path / "elsewhere")
    refused(
        "build is a link, which DVC does not follow; make it a folder", app, ["status"], standalone_mode=False
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\nseed: 0", "\nsed: 0", "'sed' is not a section; do you mean seed?"),
        ("material: ceramic", "material: cermic", "objects.mug: material: unknown material 'cermic'"),
    ],
)
def test_status_refuses_parameters_with_the_message_of_a_build(workspace, old, new, message):
    path = workspace / "params.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    found = []
    for words in (["status"], ["status", "--json"], ["build"], ["build", "--dry-run"]):
        with pytest.raises(ObjectFolderError) as caught:
            app(words, standalone_mode=False)
        found.append(str(caught.value))
    assert found == found[:1] * 4
    assert message in found[0]


def test_status_says_that_the_last_build_died(workspace, capsys):
    state = {"host": "node7", "pid": 1, "elapsed": 311, "left": None, "total": 9, "counts": {"ran": 4}}
    note = state | {"running": {"modal@mug": 5}, "failed": {}, "time": 0, "place": "", "start": ""}
    write_json(workspace / JOURNAL, note)
    app(["status"], standalone_mode=False)
    died = "the last build (process 1 on node7) died after 0:05:11 with modal@mug running; 4 of 9 stages done"
    assert died in capsys.readouterr().out
    app(["status", "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out)[0]["state"] == "never built"


def test_a_dry_run_waits_for_another_process_if_told_to(workspace, monkeypatch):
    told = []

    def opened(root, wait=False):
        told.append(wait)
        return open_repository(root)

    monkeypatch.setattr("objectfolder.engine.status.open_repository", opened)
    for words in (["build", "--dry-run", "--wait"], ["build", "--dry-run"], ["status"]):
        app(words, standalone_mode=False)
    assert told == [True, False, False]
