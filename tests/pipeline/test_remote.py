"""The real DAG, shared through a remote: a fresh clone of what git has, and `objectfolder build --pull`."""

import subprocess

import pytest
from conftest import Workspace

pytestmark = pytest.mark.xdist_group("pipeline")


def git(root, *arguments):
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    subprocess.run(["git", *identity, *arguments], cwd=root, check=True, capture_output=True)


@pytest.mark.slow  # tests/engine/test_remotes.py has it of stages that cost nothing
def test_fresh_clone_of_a_built_workspace_runs_nothing(built, tmp_path):
    built.run("-m", "dvc", "remote", "add", "--local", "-d", "store", str(tmp_path / "store"))
    try:
        built.run("-m", "dvc", "push", "--run-cache")
        git(built.root, "add", "-A")
        git(built.root, "commit", "-q", "--allow-empty", "-m", "Built")
    finally:
        built.run("-m", "dvc", "remote", "remove", "--local", "store")
    committed = subprocess.run(
        ["git", "ls-files"], cwd=built.root, check=True, capture_output=True, text=True
    )
    assert {"dvc.yaml", "dvc.lock", "params.yaml", ".dvc/config"} <= set(committed.stdout.split())
    git(tmp_path, "clone", "-q", str(built.root), "clone")
    fresh = Workspace(tmp_path / "clone", built.server)
    fresh.run("-m", "dvc", "remote", "add", "-d", "store", str(tmp_path / "store"))
    done = fresh.cli("build", "--pull", "-j", "2")
    stages = built.run("-m", "dvc", "stage", "list", "--name-only").stdout.split()
    wanted = [address for address in stages if not address.startswith(("observe@", "close_ups@"))]
    assert f"{len(wanted)} restored in" in done.stdout
    artifacts = fresh.artifacts()
    assert {f"build/{key}/ObjectFile.safetensors" for key in ("bell", "cube")} <= set(artifacts)
    assert artifacts.items() <= built.artifacts().items()
    assert fresh.cli("status", "--check").stdout.endswith("; 2 of 2 objects complete\n")
