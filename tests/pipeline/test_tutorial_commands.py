"""The commands of the tutorials run in their order, from an empty folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from conftest import ROOT, TINY
from markdown_it import MarkdownIt
from ruamel.yaml import YAML

from objectfolder import ObjectFile
from objectfolder.shapes import generate

PAGES = ("scan.md", "sounds.md")
FILE = "build/red_mug/ObjectFile.safetensors"
TOOL = f"#!{sys.executable}\nfrom objectfolder.cli import main\nmain()\n"


def commands():
    """All lines of commands, but what installs the package."""
    for page in PAGES:
        tokens = MarkdownIt().parse((ROOT / "docs" / "tutorials" / page).read_text())
        for line in "".join(t.content for t in tokens if t.type == "fence" and t.info == "bash").splitlines():
            if not line.startswith("pip "):
                yield line.replace("CLONE", str(ROOT))


@pytest.mark.slow
def test_the_commands_run_in_their_order(tmp_path):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "objectfolder").write_text(TOOL)
    (tmp_path / "bin" / "objectfolder").chmod(0o755)
    generate("mug", texture_size=64).write_glb(tmp_path / "mug.glb")
    (tmp_path / "scan").mkdir()
    trimesh.load(tmp_path / "mug.glb", force="mesh").export(tmp_path / "scan" / "red_mug.obj")
    path = f"{tmp_path / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    variables = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT), "BROWSER": "true"}
    folder, built = tmp_path, None
    for command in commands():
        if command.startswith("cd "):
            folder /= command.removeprefix("cd ")
            values = YAML(typ="safe").load((folder / "params.yaml").read_text())
            values |= {section: values[section] | content for section, content in TINY.items()}
            YAML().dump(values, folder / "params.yaml")
            continue
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=variables, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        built = built or (command == "objectfolder build -j 2" and ObjectFile.load(folder / FILE))
    assert (folder / "out" / "drop" / "drop.wav").stat().st_size > 100_000
    assert len([*(folder / "out" / "tap").iterdir()]) == 100
    fitted = ObjectFile.load(folder / FILE)
    assert fitted.frequencies / built.frequencies == pytest.approx(1.015**0.5, rel=1e-3)
