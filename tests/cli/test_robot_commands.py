import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from ruamel.yaml import YAML
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import read_json
from objectfolder.benchmarks.datasets.grasps import Grasps
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile
from objectfolder.workspace.layout import Benchmarks

ROOT = Path(__file__).parents[2]
TINY = {
    "seed": 0,
    "sensor": "digit",
    "objects": {},
    "procedural": {},
    "decompose": {"hulls": 2},
    "encode": {
        **{"encoder": "resnet18", "image": 16, "spectrogram": [8, 8], "touch": [8, 8]},
        **{"subtract": False, "shift": 0, "flip": False, "precision": "float32"},
    },
    "grasp_data": {"grasps": 10, "perturbations": 0, "image": 16, "touch": [8, 8], "timestep": 0.002},
    "grasp_stability": {
        **{"seeds": 1, "epochs": 1, "batch": 8, "learning_rate": 0.001, "weight_decay": 0.01, "patience": 1},
        **{"sizes": [8], "epoch_grasps": 8, "fusion_epochs": 1, "hidden": 4, "touch": [8, 8]},
    },
}


@pytest.fixture
def workspace(brick, tmp_path, monkeypatch):
    """Two bricks, one of them on a diet."""
    YAML().dump(TINY, tmp_path / "params.yaml")
    for key, material in (("brick", "plastic"), ("block", "wood")):
        header = brick.header | {"key": key, "material": material}
        ObjectFile(header, brick.tensors).save(tmp_path / "build" / key / "ObjectFile.safetensors")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bench(*arguments):
    return CliRunner().invoke(app, ["bench", *arguments], catch_exceptions=False)


@pytest.mark.slow
def test_stability_collects_grasps_and_prints_its_table(workspace):
    told = bench(
        "stability", "build", "--out", "here", "--split", "seen", "--threads", "1", "--device", "cpu"
    )
    assert told.exit_code == 0
    assert "2 objects, 10 grasps of each" in told.output
    assert "without explicit ones" in told.output
    assert "vision + touch" in told.output
    folder = Benchmarks("here")
    grasps = Grasps({key: folder.grasps(key) for key in ("brick", "block")})
    assert not grasps.has_explicit
    assert np.isin(grasps.success, [True, False]).all()
    assert read_json(folder.result("grasp_stability", "seen"))["objects"] == 2
    again = bench(
        "stability", "build", "--out", "here", "--split", "seen", "--threads", "1", "--device", "cpu"
    )
    assert "grasps in" not in again.output  # they are there


def test_an_object_that_no_jaw_holds_is_named_before_any_grasp(workspace, brick):
    big = ObjectFile(brick.header | {"key": "crate", "scale": 0.9}, brick.tensors)
    big.save(workspace / "build" / "crate" / "ObjectFile.safetensors")
    shutil.copytree(ROOT / "params", workspace / "params")
    with pytest.raises(ObjectFolderError, match="crate is too large for the gripper"):
        bench("grasp-policy", "build/crate", "--preset", "quick", "--out", "here", "--threads", "1")
    assert not list((workspace / "here").glob("*.json"))


def test_a_missing_section_says_which_preset_has_it(workspace):
    refused("lacks section 'grasp_policy'; run `objectfolder preset quick`", bench, "grasping", "build/brick")


def test_reach_without_metaworld_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "metaworld", None)
    with pytest.raises(ObjectFolderError, match="is not installed; this needs metaworld"):
        bench("reach", "--metaworld", "mug", "--preset", "quick", "--out", "new")
    assert list(tmp_path.iterdir()) == []
