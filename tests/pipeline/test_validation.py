"""Artifacts of the real pipeline are read as their users read them; what is not valid is rebuilt."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stages
from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.engine.verify import verify
from objectfolder.workspace.layout import Build
from objectfolder.workspace.validate import find_problem, readers

pytestmark = pytest.mark.xdist_group("pipeline")


def test_every_artifact_has_a_check_and_passes_it(built):
    build = Build("bell", built.root)
    assert set(readers(build)) == {*build.artifacts(), build.metrics}
    assert {path.name: find_problem(check, path) for path, check in readers(build).items()} == {
        path.name: "" for path in readers(build)
    }


def test_a_stage_names_itself_in_its_errors(tmp_path):
    command = [sys.executable, "-m", "stages.pack", "bell"]
    env = os.environ | {"PYTHONPATH": str(Path(stages.__file__).parents[1])}
    stage = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert stage.returncode == 1
    assert stage.stderr.startswith("pack bell: build/bell/modal.json does not exist; ")


def test_empty_and_torn_artifacts_fail_their_check(built, tmp_path):
    for path, check in readers(Build("bell", built.root)).items():
        copy = tmp_path / path.name
        copy.write_bytes(b"")
        assert str(copy) in find_problem(check, copy)
        if path.suffix != ".csv":  # half a table may be a table
            copy.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
            assert find_problem(check, copy), path


@pytest.mark.parametrize("name", ["points", "shapes", "damping"])
def test_arrays_that_do_not_fit_together_are_named(built, tmp_path, name):
    build = Build("bell", tmp_path)
    arrays = read_npz(Build("bell", built.root).modes)
    write_npz(build.modes, **(arrays | {name: arrays[name][:-1]}))
    assert "has shape" in find_problem(readers(build)[build.modes], build.modes)
    write_npz(build.modes, **{key: value for key, value in arrays.items() if key != name})
    assert f"lacks {name}" in find_problem(readers(build)[build.modes], build.modes)


@pytest.mark.slow
def test_a_recorded_artifact_that_is_not_valid_is_rebuilt(built):
    """Its hash is right: a stage wrote it so."""
    build = Build("cube", built.root)
    whole, kept = build.sdf.read_bytes(), build.sdf.with_name("kept.npz")
    assert verify((), built.root).findings == ()
    shutil.copy(build.sdf, kept)
    try:
        build.sdf.unlink()
        write_npz(build.sdf, values=np.zeros((4, 4, 5), np.int8), band=0.1)
        built.run("-m", "dvc", "commit", "-f", "voxelize@cube")
        found = verify(["voxelize@cube"], built.root).findings
        assert [(one.address, one.path) for one in found] == [("voxelize@cube", "build/cube/sdf.npz")]
        assert "values has shape (4, 4, 5)" in found[0].problem
        report = verify(["voxelize@cube"], built.root, repair=True)
        assert report.findings == ()
        assert report.rebuilt is not None
        assert report.rebuilt.stages["voxelize@cube"].status == "ran"
        assert build.sdf.read_bytes() == whole
    finally:
        kept.replace(build.sdf)
    assert built.build() == set()
    assert verify((), built.root).findings == ()
