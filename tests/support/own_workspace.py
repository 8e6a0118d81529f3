"""A workspace with the project's own files and no objects built."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    root = tmp_path / "workspace"
    root.mkdir()
    for name in ("dvc.yaml", ".dvcignore", "params.yaml", ".gitignore"):
        shutil.copy(ROOT / name, root)
    for name in ("params", "catalogs", ".dvc"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("cache", "tmp"))
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    monkeypatch.chdir(root)
    return root
