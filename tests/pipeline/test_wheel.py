"""A wheel holds all that a workspace needs, and builds objects without the clone."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from conftest import TINY
from ruamel.yaml import YAML
from setuptools.command.egg_info import FileList

from objectfolder.shapes import generate
from objectfolder.workspace.installed import PIPELINE, package_digests, pipeline_files

ROOT = Path(__file__).parents[2]
BUILD = "import sys, setuptools.build_meta as backend; print(backend.build_wheel(sys.argv[1]))"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    before = {path.name for path in (ROOT / "build").glob("*")}
    command = [sys.executable, "-c", BUILD, str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (ROOT / "build").glob("*")} == before
    return next(folder.glob("*.whl"))


def test_a_wheel_holds_the_package_and_the_pipeline(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if name.startswith("objectfolder/")}
        assert held == set(package_digests())
        for name, path in pipeline_files().items():
            assert archive.read(f"{PIPELINE}/{name}") == path.read_bytes()
    pipeline = {name.removeprefix(f"{PIPELINE}/") for name in held if name.startswith(f"{PIPELINE}/")}
    assert {"dvc.yaml", ".dvcignore", "params/laptop.yaml", "stages/modal.py"} <= pipeline
    for name in (
        *("stored/objectfile.schema.json", "objectfile/samples/mug.safetensors", "py.typed"),
        *("touch/profiles/digit.yaml", "viewer/static/viewer.js", "benchmarks/data/objects.csv"),
        *("workspace/template/README.md", "workspace/template/gitignore", "workspace/template/objects.yml"),
    ):
        assert f"objectfolder/{name}" in held
    assert not [name for name in held if name.startswith(("objectfolder/stages", "objectfolder/tests"))]


def test_an_sdist_holds_what_its_wheel_needs_of_the_top_level(monkeypatch):
    """`make wheel` builds the wheel from the sdist, as pip does from PyPI."""
    monkeypatch.chdir(ROOT)
    files = FileList()
    for line in (ROOT / "MANIFEST.in").read_text().splitlines():
        files.process_template_line(line)
    assert {*pipeline_files()} - {*files.files} == set()


@pytest.mark.slow
def test_an_installed_wheel_makes_builds_and_upgrades_a_workspace(wheel, tmp_path):
    """The environment has this one's libraries, and no objectfolder but that of the wheel."""
    home = tmp_path / "venv"
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*command, cwd=tmp_path, ok=True):
        done = subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True)
        assert not ok or done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr

    run(sys.executable, "-m", "venv", "--without-pip", home)
    python = home / "bin" / "python"
    site = Path(run(python, "-c", "import site; print(site.getsitepackages()[0])").strip())
    pip = (sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index")
    run(*pip, wheel)
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    tool = str(home / "bin" / "objectfolder")
    found = run(python, "-c", "import objectfolder; print(objectfolder.__file__)")
    assert found.strip() == str(site / "objectfolder" / "__init__.py")
    run(tool, "init", "cups")
    root = tmp_path / "cups"
    generate("mug", texture_size=64).write_glb(tmp_path / "mug.glb")
    path = root / "params.yaml"
    values = YAML(typ="safe").load(path.read_text())
    for section, content in TINY.items():
        values[section] = {**values[section], **content}
    YAML().dump(values, path)
    run(tool, "add", "../mug.glb", "--name", "mug", "--material", "ceramic", "--scale", "0.112", cwd=root)
    run(tool, "build", "-j", "1", cwd=root)
    metrics = json.loads((root / "metrics/mug.json").read_text())
    assert metrics["touch"]["psnr"] > metrics["touch"]["baseline_mean_image"]
    assert "1 of 1 object complete" in run(tool, "status", "--check", cwd=root)
    assert "skipping" in run(python, "-m", "dvc", "repro", "modal@mug", cwd=root)
    run(tool, "info", "build/mug/ObjectFile.safetensors", cwd=root)

    module = site / "objectfolder/sound/fem/modal.py"
    module.write_text(module.read_text() + "\nNEWER = True\n")
    refused = "1 file differs (objectfolder/sound/fem/modal.py); run `objectfolder upgrade`"
    for command in (("build",), ("status",)):
        assert refused in run(tool, *command, cwd=root, ok=False)
    assert refused in run(python, "-m", "stages.pack", "mug", cwd=root, ok=False)
    said = run(tool, "upgrade", cwd=root)
    assert "changed in the package: objectfolder/sound/fem/modal.py" in said
    runs = {line.split()[1]: line for line in said.splitlines() if line.startswith("run ")}
    assert runs.keys() >= {"hash_code", "modal@mug"}
    assert "code changed: objectfolder/sound/fem/modal.py" in runs["modal@mug"]
    assert not [address for address in runs if address.startswith(("normalize", "render"))]
    ran = run(tool, "build", "-j", "1", cwd=root)
    assert "modal" in ran
    assert "1 of 1 object complete" in run(tool, "status", "--check", cwd=root)
