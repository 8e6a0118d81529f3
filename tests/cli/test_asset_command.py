"""The command asset: one mesh, folders, tables."""

import csv
import json
import re

import pytest
import trimesh
from typer.testing import CliRunner

from objectfolder.cli import app
from objectfolder.sim import asset as module
from objectfolder.sound.fem.settings import VoxelizeConfig


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(module, "VoxelizeConfig", lambda: VoxelizeConfig(sdf_resolution=48))


def run(*words, rc=0):
    done = CliRunner().invoke(app, ["asset", *map(str, words)], env={"TERMINAL_WIDTH": "200"})
    assert done.exit_code == rc, (done.output, done.exception)
    return done.output if done.exception is None or isinstance(done.exception, SystemExit) else done.exception


@pytest.fixture
def folder(tmp_path):
    """Two boxes, one of them in a subfolder, and a triangle."""
    made = tmp_path / "meshes"
    (made / "009_tin").mkdir(parents=True)
    trimesh.creation.box([0.1, 0.05, 0.03]).export(made / "block.ply")
    trimesh.creation.box([0.08, 0.08, 0.1]).export(made / "009_tin" / "mesh.obj")
    (made / "scrap.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    return made


def test_one_mesh(folder, tmp_path):
    out = tmp_path / "out"
    tin = folder / "009_tin" / "mesh.obj"
    text = run(
        tin, "--material", "steel", "--scale", "0.2", "--shell", "1mm", "--out", out, "--format", "urdf"
    )
    assert "1 asset in" in text
    report = json.loads((out / "tin" / "asset.json").read_text())
    assert report["size"] == 0.2
    assert report["weight"]["shell"] == 0.001
    assert (out / "tin" / "tin.urdf").is_file()
    assert not (out / "tin" / "tin.xml").exists()
    text = run(tin, "--material", "plastic", "--name", "can", "--out", out, "--format", "mjcf")
    thick = r"warning can: it is (79\.\d|80) mm thick, and plastic is seldom solid beyond 15 mm"
    assert re.search(thick, text), text


def test_a_folder_goes_on_where_it_was(folder, tmp_path):
    out = tmp_path / "out"
    (folder / "materials.csv").write_text("name,material,shell\n009_tin,steel,0.0005\n")
    words = (folder, "--material", "wood", "--out", out, "--format", "mjcf", "-j", "1")
    text = run(*words, rc=1)
    assert "refused scrap: " in text
    assert "2 assets in" in text
    assert "1 refused" in text
    lines = (out / "assets.csv").read_text().splitlines()
    rows = {row["object"]: row for row in csv.DictReader(lines)}
    assert rows["tin"]["mass_from"] == "shell"
    assert rows["block"]["mass_from"] == "solid"
    assert "without any area" in rows["scrap"]["refusal"]
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.xml")}
    assert len(before) == 2
    assert run(*words, rc=1).count("there") == 2
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.xml")} == before
    text = run(*words, "--hulls", "3", rc=1)
    assert "block exists already, made from another mesh, with other options" in text


@pytest.mark.slow  # each process starts for seconds
def test_assets_made_at_a_time_are_the_same(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "VoxelizeConfig", VoxelizeConfig)  # processes do not know the coarse one
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    (folder / "scrap.obj").unlink()
    made = {}
    for jobs in (1, 2):
        out = tmp_path / f"out{jobs}"
        run(folder, "--material", "wood", "--out", out, "--format", "mjcf", "-j", jobs)
        files = sorted(path for path in out.rglob("*") if path.is_file())
        made[jobs] = {path.relative_to(out): path.read_bytes() for path in files}
    assert {path.parts[0] for path in made[1]} == {"assets.csv", "block", "tin"}
    assert made[1] == made[2]


def test_a_table_lists_objects(folder, tmp_path):
    table = folder / "objects.csv"
    table.write_text(
        "key,name,material,longest_side_m,note\nbrick,x,wood,0.2,\nlost,y,steel,1,\n009_tin,z,,,\n"
    )
    (folder / "block.ply").rename(folder / "brick.ply")
    out = tmp_path / "out"
    text = run(table, "--out", out, "--format", "glb", "-j", "1", rc=1)
    assert json.loads((out / "brick" / "asset.json").read_text())["size"] == 0.2
    assert "refused lost: " in text
    assert "give its path in a column `mesh` of objects.csv" in text
    assert "refused tin_009: tin_009 has no material; give --material" in text.replace(
        "refused tin_009: has", "refused tin_009: tin_009 has"
    )


def test_bad_input(folder, tmp_path):
    out = tmp_path / "out"
    assert "block.ply: a mesh needs --material" in str(run(folder / "block.ply", "--out", out, rc=1))
    for words in (["--mass", "1"], ["--shell", "1"], ["--name", "x"], ["--scale", "1"]):
        text = str(run(folder, "--material", "wood", "--out", out, *words, rc=1))
        assert f"is of several objects; for one mesh alone: {words[0]}; use columns of materials.csv" in text
    assert "does not exist" in str(run(tmp_path / "no.obj", "--material", "wood", "--out", out, rc=1))
    assert "'stl' is not one of mjcf, urdf, usd, glb" in str(
        run(folder, "--out", out, "--format", "stl", rc=2)
    )
    assert not out.exists()
