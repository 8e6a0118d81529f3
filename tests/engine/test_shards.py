"""Many objects as several workspaces that share one cache (docs/pipeline.md)."""

import shutil
import subprocess
from pathlib import Path

import pytest
from dvc.repo import Repo

from objectfolder.engine.build import build
from objectfolder.engine.summary import StageOutcome

from .conftest import KEYS, Workspace, everything
from .test_interruption import start

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
