"""Edits while real stages run."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from ruamel.yaml import YAML

from objectfolder.mesh.reading.load import load_mesh

#: Begins a stage script: wait for a first edit before anything is read, and for a second one at the end.
WAIT = """
import atexit, pathlib, time

def wait(name):
    while not pathlib.Path(name).exists():
        time.sleep(0.02)

pathlib.Path("started").touch()
wait("edited")
atexit.register(wait, "reverted")
"""


def measured(workspace):
    lower, upper = load_mesh(workspace.root / "data/objects/cube/mesh.glb", "y").bounds
    return (upper - lower).round(3).tolist()


@pytest.mark.parametrize(
    "name", ["edge", pytest.param("size", marks=pytest.mark.slow)]
)  # the second: as before
def test_a_generated_object_has_the_size_that_is_asked(workspace, name):
    seen = []
    for value in (0.16, 0.30, 0.22, 0.16, 0.30):
        with workspace.edit() as values:
            entry = values["procedural"]["cube"]
            entry.pop("edge", None)
            entry[name] = value
        seen.append(bool(workspace.build("generate@cube")))
        assert measured(workspace) == [value] * 3
        assert "all good" in workspace.cli("verify", "generate@cube").stdout
    assert seen == [True, True, True, False, False]
    done = workspace.run("-m", "stages.generate", "cube", ok=False)  # as `dvc repro` does
    assert done.returncode == (0 if name == "edge" else 1)
    assert ("procedural.cube.size: DVC ignores" in done.stderr) == (name == "size")


@pytest.mark.slow
def test_size_that_is_edited_and_edited_back_while_an_object_is_generated_is_not_taken(workspace):
    script = workspace.root / "stages/generate.py"
    script.write_text(WAIT + script.read_text())
    mesh = workspace.root / "data/objects/cube/mesh.glb"

    def wait_for(path):
        while not path.exists():
            assert building.running(), building.result().stderr
            time.sleep(0.02)

    with ThreadPoolExecutor(1) as pool:
        building = pool.submit(workspace.build, "generate@cube")
        try:
            wait_for(workspace.root / "started")
            with workspace.edit() as values:
                values["procedural"]["cube"]["edge"] = 0.30
            (workspace.root / "edited").touch()
            wait_for(mesh)
            with workspace.edit() as values:
                values["procedural"]["cube"]["edge"] = 0.16
        finally:
            for name in ("edited", "reverted"):
                (workspace.root / name).touch()
        assert building.result() == {"hash_code", "generate@cube"}
    assert measured(workspace) == [0.16] * 3
    lock = YAML(typ="safe").load(workspace.root / "dvc.lock")["stages"]
    assert lock["generate@cube"]["params"]["params.yaml"]["procedural.cube"]["edge"] == 0.16
    assert workspace.build("generate@cube") == set()
