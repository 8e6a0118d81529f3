"""`prune` removes what was built of removed objects, and not a byte of anything else."""

import json
import re
import shutil
import signal
import subprocess
import sys

import pytest
from refusals import refused
from ruamel.yaml import YAML
from typer.testing import CliRunner

from objectfolder.cli import app
from objectfolder.engine.build import build
from objectfolder.engine.prune import prune, survey
from objectfolder.engine.verify import verify

from .conftest import PIPELINE

SIZES = {"bell": {"size": 1}, "bowl": {"size": 1}, "mug": {"size": 2}}


@pytest.fixture(scope="module")
def built(tmp_path_factory, make):
    """Bell and bowl have one file in common, and so one cached object."""
    workspace = make(tmp_path_factory.mktemp("built") / "workspace", PIPELINE)
    workspace.params(**SIZES)
    assert build(root=workspace.root).ok
    workspace.params(bell={"size": 1, "material": "old"})
    assert build(root=workspace.root).ok
    workspace.params(**SIZES)
    assert build(root=workspace.root).ok
    workspace.ran()
    return workspace


@pytest.fixture
def workspace(built, tmp_path):
    return built.copy(tmp_path / "workspace")


def remove(workspace, key):
    path = workspace.root / "params.yaml"
    path.write_text(re.sub(rf"  {key}: .*\n", "", path.read_text()))


def files(workspace):
    found = (path for path in workspace.root.rglob("*") if path.is_file())
    return {
        str(path.relative_to(workspace.root))
        for path in found
        if not {".git", "tmp"} & set(path.relative_to(workspace.root).parts)
    }


def test_what_is_still_in_params_stays(workspace):
    waste = survey(workspace.root)
    assert (waste.keys, waste.bytes, waste.left) == ((), 0, ())
    before = files(workspace)
    prune(waste, workspace.root)
    assert files(workspace) == before


def test_everything_of_a_removed_object_goes_and_nothing_else(workspace):
    before, lock = files(workspace), YAML(typ="safe").load(workspace.root / "dvc.lock")["stages"]
    foreign = workspace.root / "build/bell/notes.txt"
    foreign.write_text("mine")
    other = workspace.root / "build/perf/modal.json"
    other.parent.mkdir()
    other.write_text("{}")
    source = workspace.root / "data/objects/bell/mesh.obj"
    source.parent.mkdir(parents=True)
    source.write_text("v 0 0 0")
    shared = lock["prepare@bell"]["outs"][0]["md5"]
    assert shared == lock["prepare@bowl"]["outs"][0]["md5"]
    remove(workspace, "bell")

    waste = survey(workspace.root)
    assert waste.keys == ("bell",)
    assert set(waste.addresses) == {"prepare@bell", "solve@bell", "pack@bell"}
    assert {path.name for path in waste.files["bell"]} >= {"prepare.txt", "a.txt", "pack.txt", "bell.json"}
    assert any("build/bell/notes.txt: not written by the pipeline" in note for note in waste.left)
    assert any("data/objects/bell: its source" in note for note in waste.left)
    prune(waste, workspace.root)

    gone = before - files(workspace)
    assert {path for path in gone if not path.startswith(".dvc")} == {
        "build/bell/prepare.txt",
        "build/bell/solve/a.txt",
        "build/bell/pack.txt",
        "metrics/bell.json",
        *(f"build/.logs/{stage}@bell.log" for stage in ("prepare", "solve", "pack")),
        "build/.logs/prepare@bell.cost",  # the others were restored
    }
    assert not (workspace.root / "build/bell/solve").exists()
    assert [path.read_text() for path in (foreign, other, source)] == ["mine", "{}", "v 0 0 0"]
    # Its present and its earlier state: a list and a file (solve and pack write the same) each.
    assert len([path for path in gone if "cache/files" in path]) == 4
    assert f".dvc/cache/files/md5/{shared[:2]}/{shared[2:]}" not in gone
    kept = {address: entry for address, entry in lock.items() if not address.endswith("@bell")}
    assert YAML(typ="safe").load(workspace.root / "dvc.lock")["stages"] == kept

    assert survey(workspace.root).keys == ()
    assert verify((), workspace.root).findings == ()
    assert build(root=workspace.root).counts()["skipped"] == 6
    for key in ("bowl", "mug"):
        shutil.rmtree(workspace.root / "build" / key)
        (workspace.root / f"metrics/{key}.json").unlink()
    (workspace.root / "dvc.lock").unlink()
    assert build(root=workspace.root).counts()["restored"] == 6
    assert workspace.ran() == []


def test_grasps_and_results_of_robots_go_too_and_those_of_all_objects_stay(workspace):
    """Stages of benchmarks that are no longer in the pipeline, as after the removal of their last object."""
    outs = {
        "grasp_data@bell": ["benchmarks/grasps/bell/record.json"],
        "grasp_policy@bell": [f"benchmarks/grasp_policy_bell.{end}" for end in ("json", "gif")],
        "reach@mug": ["benchmarks/reach_mug.json"],
        "recognize@seen": ["benchmarks/recognize_seen.json"],
    }
    lock = YAML(typ="safe").load(workspace.root / "dvc.lock")
    for address, paths in outs.items():
        for path in paths:
            (workspace.root / path).parent.mkdir(parents=True, exist_ok=True)
            (workspace.root / path).write_text(path)
        lock["stages"][address] = {"cmd": "x", "outs": [{"path": path} for path in paths]}
    (workspace.root / "build/.logs/recognize@seen.log").write_text("")
    (workspace.root / "benchmarks/grasp_policy_bell_machine.json").write_text("{}")
    YAML().dump(lock, workspace.root / "dvc.lock")
    remove(workspace, "bell")
    waste = survey(workspace.root)
    assert waste.keys == ("bell",)
    assert {"grasp_data@bell", "grasp_policy@bell"} < set(waste.addresses)
    prune(waste, workspace.root)
    assert sorted(path.name for path in (workspace.root / "benchmarks").rglob("*")) == [
        "grasps",
        "reach_mug.json",
        "recognize_seen.json",
    ]
    assert {"reach@mug", "recognize@seen"} < workspace.locked()
    assert survey(workspace.root).keys == ()


def test_an_object_that_comes_back_is_built_again(workspace):
    remove(workspace, "mug")
    prune(survey(workspace.root), workspace.root)
    workspace.params(**SIZES)
    assert build(root=workspace.root).ok
    assert workspace.ran() == ["pack@mug", "prepare@mug", "solve@mug"]


def test_what_a_dvc_file_names_stays(workspace):
    """A tracked file with the very bytes of an artifact."""
    (workspace.root / "copy.txt").write_bytes((workspace.root / "build/mug/pack.txt").read_bytes())
    workspace.dvc("add", "-q", "copy.txt")
    remove(workspace, "mug")
    prune(survey(workspace.root), workspace.root)
    (workspace.root / "copy.txt").unlink()
    workspace.dvc("checkout", "copy.txt.dvc")
    assert "mug" in (workspace.root / "copy.txt").read_text()


@pytest.mark.parametrize("inside", [False, True])
def test_a_cache_that_others_may_use_is_left(workspace, tmp_path, inside):
    cache = (workspace.root if inside else tmp_path) / "shared_cache"
    shutil.move(workspace.root / ".dvc/cache", cache)
    workspace.dvc("config", "cache.dir", str(cache))
    before = sorted(cache.rglob("*"))
    remove(workspace, "mug")
    waste = survey(workspace.root)
    assert any("other workspaces may use it" in note for note in waste.left)
    prune(waste, workspace.root)
    assert sorted(cache.rglob("*")) == before
    assert not (workspace.root / "build/mug").exists()
    assert not [address for address in workspace.locked() if address.endswith("@mug")]


def test_a_workspace_that_has_changed_since_is_not_touched(workspace):
    remove(workspace, "mug")
    waste = survey(workspace.root)
    workspace.params(**SIZES)
    before = files(workspace)
    refused("changed since", prune, waste, workspace.root)
    assert files(workspace) == before


def test_a_killed_prune_is_finished_by_the_next(workspace):
    remove(workspace, "mug")
    script = (
        "import os, signal, sys\n"
        "from objectfolder.engine.prune import prune, survey\n"
        "waste = survey()\n"
        "left = len(waste.files['mug']) + 1\n"
        "def hook(event, arguments):\n"
        "    global left\n"
        "    if event == 'os.remove' and '.dvc/tmp' not in str(arguments[0]):\n"
        "        left -= 1\n"
        "        if not left:\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "sys.addaudithook(hook)\n"
        "prune(waste)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=workspace.root)
    assert done.returncode == -signal.SIGKILL
    assert not (workspace.root / "build/mug/pack.txt").exists()
    waste = survey(workspace.root)
    assert waste.keys == ("mug",)
    assert waste.cached["mug"]
    prune(waste, workspace.root)
    assert survey(workspace.root).keys == ()
    assert not [address for address in workspace.locked() if address.endswith("@mug")]
    assert verify((), workspace.root).findings == ()


def test_commands(workspace, monkeypatch):
    """One workspace through the commands; nobody is there to be asked."""
    monkeypatch.chdir(workspace.root)

    def run(*arguments):
        return CliRunner().invoke(app, arguments)

    remove(workspace, "bell")
    before = files(workspace)
    shown = run("prune", "--dry-run")
    assert shown.exit_code == 0
    assert re.search(r"bell\s+8\s", shown.stdout)
    assert "would be removed" in shown.stdout
    assert "--yes" in str(run("prune").exception)
    assert files(workspace) == before
    assert run("prune", "--yes").exit_code == 0
    assert not (workspace.root / "build/bell").exists()
    assert "nothing to remove" in run("prune").stdout

    (workspace.root / "build/mug/pack.txt").write_text("other")
    # Its params.yaml is not one that `objectfolder build` would accept.
    monkeypatch.setattr("objectfolder.workspace.params.read", dict)
    monkeypatch.setattr("objectfolder.workspace.check.check_entries", lambda values: None)
    status = run("status", "mug")
    assert status.exit_code == 0
    assert "build/mug/pack.txt changed" in status.stdout
    assert run("status", "--check").exit_code == 1
    assert {entry["state"] for entry in json.loads(run("status", "--json").stdout)} == {"fresh", "stale"}
    bad = run("verify")
    assert bad.exit_code == 1
    assert "differs from what was recorded" in bad.stdout
    assert run("verify", "--repair").exit_code == 0
    assert run("status", "--check").exit_code == 0
