"""Messages name a command that installs this package from where it is, since no package index has it."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import distribution, version
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from PIL import Image
from typer.testing import CliRunner

import objectfolder
from objectfolder.base import installation
from objectfolder.base.installation import extra_with, install_command, installed_version, requirement
from objectfolder.base.seeding import seeded
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.models.shape_model import Setup, ShapeModel, new_net, save_model
from objectfolder.cli import app

ROOT = Path(__file__).parents[1]
GIT = {"url": "https://example.org/o.git", "vcs_info": {"vcs": "git", "commit_id": "abc123"}}
WEB = {"url": "https://example.org/o-1.0-py3-none-any.whl", "archive_info": {}}


def test_in_a_clone_it_is_the_clone():
    assert install_command("usd") == f"pip install -e '{ROOT}[usd]'"
    assert install_command() == f"pip install -e {ROOT}"
    assert requirement("build") == f"objectfolder[build] @ file://{ROOT}"


@pytest.fixture
def recorded(monkeypatch, tmp_path):
    """An installation elsewhere, of which pip has recorded this."""

    def record(found):
        monkeypatch.setattr(installation, "_HOME", tmp_path / "site-packages")
        monkeypatch.setattr(installation, "_recorded", lambda: found)

    return record


@pytest.mark.parametrize(
    ("found", "source"),
    [(GIT, "git+https://example.org/o.git@abc123"), (WEB, "https://example.org/o-1.0-py3-none-any.whl")],
)
def test_a_commit_or_wheel_on_a_server_is_its_url(recorded, found, source):
    recorded(found)
    assert install_command("rl") == f"pip install 'objectfolder[rl] @ {source}'"
    assert requirement("rl") == f"objectfolder[rl] @ {source}"


def test_a_clone_or_wheel_on_this_machine_is_named_while_it_is_there(recorded, tmp_path):
    clone, wheel = tmp_path / "my clone", tmp_path / "o-1.0-py3-none-any.whl"
    clone.mkdir()
    wheel.touch()
    recorded({"url": clone.as_uri(), "dir_info": {}})
    assert install_command("rl") == f"pip install '{clone}[rl]'"
    assert requirement("rl") == f"objectfolder[rl] @ {clone.as_uri()}"
    recorded({"url": wheel.as_uri(), "archive_info": {}})
    assert install_command("rl") == f"pip install 'objectfolder[rl] @ {wheel.as_uri()}'"
    wheel.unlink()
    assert install_command("rl").startswith("pip install 'CLONE[rl]' (CLONE: a clone of the repository")


def test_without_a_record_the_clone_is_left_to_the_reader(recorded):
    recorded({})
    unknown = "pip install 'CLONE[rl]' (CLONE: a clone of the repository of objectfolder)"
    assert install_command("rl") == unknown
    assert requirement("build") == f"objectfolder[build]=={version('objectfolder')}"


def test_no_message_names_a_package_that_no_index_has():
    named = re.compile(r"pip install (-\S+ )*['\"]?objectfolder")
    assert [path for path in ROOT.glob("objectfolder/**/*.py") if named.search(path.read_text())] == []


def test_the_version_is_at_hand_without_imports_that_take_time():
    assert objectfolder.__version__ == installed_version() == version("objectfolder")
    assert CliRunner().invoke(app, ["--version"]).output == f"objectfolder {version('objectfolder')}\n"
    code = "import sys, objectfolder as o; print(o.__version__, *dir(o)); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (found, *names), modules = (line.split() for line in ran.stdout.splitlines())
    assert found == version("objectfolder")
    assert {"ObjectFile", "Dataset", "__version__"} < set(names)
    assert {"torch", "numpy", "objectfolder.objectfile"}.isdisjoint(modules)


def test_a_missing_module_has_the_extra_that_brings_it():
    found = {
        name: extra_with(name) for name in ("igl", "dvc_data.index", "mujoco", "sklearn", "ray", "numpy")
    }
    assert list(found.values()) == ["build", "build", "rl", "bench", "ray", ""]


@pytest.fixture(scope="module")
def base_only(tmp_path_factory):
    """A folder to import from: the package and what it needs without an extra, down to the last package."""
    site, todo, found = tmp_path_factory.mktemp("site"), ["objectfolder"], set()
    (site / "objectfolder").symlink_to(ROOT / "objectfolder")
    while todo:
        if (name := canonicalize_name(todo.pop())) in found:
            continue
        found.add(name)
        held = distribution(name)
        for top in {path.parts[0] for path in held.files} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(held.locate_file(top))
        asked = map(Requirement, held.requires or ())
        todo += [one.name for one in asked if one.marker is None or one.marker.evaluate({"extra": ""})]
    return site


IN_TURN = """
import json, sys
from objectfolder.cli import main
ended = []
for line in sys.stdin.read().splitlines():
    sys.argv = ["objectfolder", *line.split()]
    try:
        main()
    except SystemExit as end:
        ended.append(end.code)
print(json.dumps(ended))
"""
ENCODER = "#!/bin/sh\ncat > /dev/null\nfor out; do :; done\necho film > $out\n"
#: Commands of README for who only queries, and those that need an extra, with its name.
QUERIES = """info mug
view mug --no-open --out page.html
sample vision v.npy -n 1
sample audio mug a.npy -n 1
sample touch mug t.npy -n 1
query vision mug v.npy views --resolution 8
query audio mug a.npy sounds --duration 0.1
query touch mug t.npy touches
report mug --no-open
video mug --duration 0.04 --resolution 16 --contacts 1
reconstruct photo.png mesh.glb --model model.safetensors --background 255,255,255
export nerfstudio mug nerf -n 1 --resolution 8
bench --help
preset laptop
sensor list
doctor"""
NEEDY = {
    "bench recognize mug bell --preset quick": "build",
    "bench reach mug --preset quick": "build",
    "add photo.png": "build",
    "build": "build",
    "fit sound mug sounds/1.wav": "build",
    "init new": "build",
    "inspect modal@mug": "build",
    "export mjcf mug bodies": "rl",
    "simulate scene.xml": "rl",
    "export lerobot mug episodes": "hub",
}


def test_the_base_install_runs_what_queries_and_else_names_the_extra(base_only, tmp_path):
    setup = Setup(("vision",), "resnet18_quarter", InputSizes(16, (8, 8), (8, 8)), 16, 4, 1, 0, 8, ("mug",))
    with seeded(0, "untrained"):
        save_model(tmp_path / "model.safetensors", ShapeModel(setup, new_net(setup)))
    photo = np.full((24, 24, 3), 255, np.uint8)
    photo[6:18, 6:18] = 90
    Image.fromarray(photo).save(tmp_path / "photo.png")
    shutil.copy(ROOT / "params.yaml", tmp_path)
    shutil.copytree(ROOT / "params", tmp_path / "params")
    (tmp_path / "ffmpeg").write_text(ENCODER)
    (tmp_path / "ffmpeg").chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    variables = os.environ | {"PYTHONPATH": str(base_only), "PATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    lines = [*QUERIES.splitlines(), *NEEDY]
    done = subprocess.run(
        [sys.executable, "-S", "-c", IN_TURN],  # without the packages of its environment
        **{"input": "\n".join(lines), "cwd": tmp_path, "env": variables},
        **{"capture_output": True, "text": True},
    )
    assert done.returncode == 0, done.stderr
    codes = dict(zip(lines, json.loads(done.stdout.splitlines()[-1]), strict=True))
    assert {line: codes[line] for line in QUERIES.splitlines() if codes[line]} == {}, done.stderr
    for line, extra in NEEDY.items():
        said = done.stderr if codes[line] == 1 else codes[line]
        assert re.search(f"is not installed; .*{re.escape(install_command(extra))}", said), line
