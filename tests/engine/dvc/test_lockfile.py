"""What is written is what DVC writes, and what is read is what is on disk."""

import json

from refusals import refused

from objectfolder.engine.build import build
from objectfolder.engine.dvc.lockfile import COPIES

from ..conftest import everything


def test_copy_is_only_trusted_for_the_file_that_it_was_made_from(workspace):
    build(root=workspace.root)
    workspace.ran()
    older = (workspace.root / "dvc.lock").read_text()
    workspace.params(mug={"material": "glass"})
    build(root=workspace.root)
    workspace.ran()
    (workspace.root / "dvc.lock").write_text(older)  # as `git checkout` would
    workspace.params()
    summary = build(root=workspace.root)
    assert workspace.ran() == []
    assert summary.ok
    assert "steel" in (workspace.root / "build/mug/pack.txt").read_text()
    assert "up to date" in workspace.dvc("status")


def test_stages_that_did_not_change_keep_their_text(workspace):
    build(root=workspace.root)
    lock = workspace.root / "dvc.lock"
    lines = lock.read_text().splitlines()
    place = lines.index("  prepare@bell:") + 1
    lines[place] = lines[place].replace("python -m", '"python -m') + '"'  # the same YAML, written otherwise
    lock.write_text("\n".join(lines) + "\n")
    workspace.params(mug={"material": "glass"})
    build(root=workspace.root)
    assert lines[place] in lock.read_text()
    assert "up to date" in workspace.dvc("status")


def test_parameters_that_json_does_not_keep_are_read_from_yaml(make_workspace):
    workspace = make_workspace(
        "stages:\n  keyed: {cmd: 'echo > a.txt', deps: [steps.py], params: [table], outs: [a.txt]}\n"
    )
    (workspace.root / "params.yaml").write_text("table: {1: one}\n")
    assert build(root=workspace.root).ok
    assert not list((workspace.root / COPIES).glob("*.json"))
    assert str(build(root=workspace.root).stages["keyed"].status) == "skipped"
    assert "up to date" in workspace.dvc("status")


def test_merge_conflict_is_left_to_the_user(workspace):
    build(root=workspace.root)
    lock = workspace.root / "dvc.lock"
    conflict = "<<<<<<< HEAD\n" + lock.read_text()
    lock.write_text(conflict)
    refused(r"dvc\.lock", build, root=workspace.root)
    assert lock.read_text() == conflict


def test_a_torn_copy_is_not_needed(workspace):
    build(root=workspace.root)
    workspace.ran()
    (copy,) = (workspace.root / COPIES).glob("*.json")
    copy.write_text(copy.read_text()[:100])
    assert build(root=workspace.root).ok
    assert workspace.ran() == []
    assert set(json.loads(copy.read_text())["contents"]["stages"]) == set(everything())
