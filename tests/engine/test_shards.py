"""Many objects as several workspaces that share one cache (docs/pipeline.md)."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from dvc.repo import Repo

from objectfolder.engine.build import build
from objectfolder.engine.summary import StageOutcome

from .conftest import KEYS, Workspace, everything
from .processes import PATH
from .test_interruption import start

PAGE = Path(__file__).parents[2] / "docs" / "pipeline.md"
#: Runs the tasks of an array job one after another, here.
SBATCH = """#!/bin/bash
range=${1#--array=0-}
export SLURM_SUBMIT_DIR=$PWD SLURM_ARRAY_TASK_COUNT=$((range + 1))
for SLURM_ARRAY_TASK_ID in $(seq 0 $range); do
  export SLURM_ARRAY_TASK_ID
  bash "$2" || exit
done
"""
#: The real one refuses the parameters of these workspaces.
COMMAND = f"""#!{sys.executable}
import sys
from objectfolder.engine.build import build
sys.exit(sys.argv[1] != "build" or not build(sys.argv[2:]).ok)
"""

ENGINE = "from objectfolder.engine.build import build; assert build().ok"


def shard(whole: Workspace, root: Path, keys: list[str]) -> Workspace:
    """A workspace with the same pipeline and cache, and some of the objects."""
    subprocess.run(["git", "init", "-q", root], check=True)
    for name in ("dvc.yaml", "steps.py", ".gitignore"):
        shutil.copy(whole.root / name, root / name)
    with Repo.init(str(root)) as repo, repo.config.edit("repo") as config:
        config["core"].update({"analytics": False, "hardlink_lock": True})
        config["cache"].update({"dir": str(whole.root / ".dvc/cache"), "type": ["hardlink"]})
    lines = (whole.root / "params.yaml").read_text().splitlines()
    kept = [line for line in lines[1:] if line.split(":")[0].strip() in keys]
    (root / "params.yaml").write_text("\n".join(["objects:", *kept]) + "\n")
    return Workspace(root, whole.server)


@pytest.mark.slow
def test_shards_build_at_the_same_time_and_the_whole_takes_all_from_their_cache(workspace, tmp_path):
    shards = [shard(workspace, tmp_path / key, [key]) for key in KEYS]
    engines = [start(part, "-c", ENGINE) for part in shards]
    assert [engine.wait(60) for engine in engines] == [0, 0, 0]
    for key, part in zip(KEYS, shards, strict=True):
        assert part.ran() == [f"pack@{key}", f"prepare@{key}", f"solve@{key}"]
        # One copy of the bytes: in the cache.
        assert (part.root / f"build/{key}/pack.txt").stat().st_nlink >= 2

    summary = build(root=workspace.root)
    assert sorted(result.address for result in summary.with_status(StageOutcome.RESTORED)) == everything()
    assert workspace.ran() == []
    assert "up to date" in workspace.dvc("status")


@pytest.mark.slow
def test_the_array_job_of_the_docs_builds_a_share_in_each_task_and_the_workspace_takes_it(
    workspace, tmp_path
):
    recipe = re.search(r"```bash\n(#!/bin/bash\n#SBATCH .*?)```", PAGE.read_text(), re.DOTALL)[1]
    for name, text in {"sbatch": SBATCH, "objectfolder": COMMAND}.items():
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
    root = workspace.root
    with Repo(str(root)) as repo, repo.config.edit("repo") as config:
        config["cache"].update({"dir": str(tmp_path / "cache"), "type": ["hardlink"]})
    (root / "shard.sh").write_text(recipe)
    (root / "keys.txt").write_text("".join(f"{key}\n" for key in KEYS))
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    for command in (("add", "-A"), (*identity, "commit", "-qm", "Objects")):
        subprocess.run(["git", *command], cwd=root, check=True)

    environment = os.environ | {"PATH": f"{tmp_path / 'bin'}:{PATH}", "PYTHONPATH": str(PAGE.parents[1])}
    subprocess.run(["sbatch", "--array=0-1", "shard.sh"], cwd=root, env=environment, check=True)
    shares = [Workspace(Path(f"{root}.shards/{i}"), workspace.server).ran() for i in range(2)]
    keys = [{address.partition("@")[2] for address in share} for share in shares]
    assert keys == [{"bowl"}, {"bell", "mug"}]
    assert sorted(shares[0] + shares[1]) == everything()

    summary = build(root=root)
    assert [one.address for one in summary.stages.values() if one.status is not StageOutcome.RESTORED] == []
    assert workspace.ran() == []
    assert "up to date" in workspace.dvc("status")
