"""`objectfolder add` and `preset`: all or nothing."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from objectfolder import catalog, params
from objectfolder.engine.local import build
from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.load import load_mesh

ROOT = Path(__file__).parents[1]
OBJECTS = ROOT.parent / "shared" / "objects"


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    root = tmp_path / "workspace"
    root.mkdir()
    for name in ("dvc.yaml", "params.yaml", ".gitignore"):
        shutil.copy(ROOT / name, root)
    for name in ("params", "catalogs", ".dvc"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("cache", "tmp"))
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def box(tmp_path):
    """An OBJ with its MTL and texture, 0.2 x 0.1 x 0.1 m."""
    source = tmp_path / "source"
    (source / "maps").mkdir(parents=True)
    mesh = trimesh.creation.box([0.2, 0.1, 0.1])
    lines = ["mtllib box.mtl", "usemtl m"]
    lines += [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + ["vt 0 0", "vt 1 0", "vt 1 1"]
    lines += [f"f {a}/1 {b}/2 {c}/3" for a, b, c in mesh.faces + 1]
    (source / "box.obj").write_text("\n".join(lines))
    (source / "box.mtl").write_text("newmtl m\nmap_Kd -s 1 1 1 maps/wood grain.png\n")
    Image.fromarray(np.full((8, 8, 3), 200, np.uint8)).save(source / "maps" / "wood grain.png")
    return source / "box.obj"


def snapshot(root):
    return {
        p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file() and ".dvc" not in p.parts
    }


def test_add_copies_what_the_mesh_refers_to_and_tracks_it(workspace, box):
    entry = catalog.add_mesh(box, "crate", "wood", None, None)
    assert entry == {
        "mesh": "data/objects/crate/mesh.obj",
        "material": "wood",
        "scale": pytest.approx(0.2),
        "up": "z",
    }
    home = workspace / "data/objects/crate"
    assert (home / "mesh.obj").read_bytes() == box.read_bytes()
    assert (home / "maps/wood grain.png").exists()
    assert (workspace / "data/objects/crate.dvc").exists()
    values = params.read()
    params.check_all(values)
    assert set(values["objects"]) == {"mug", "die", "bell", "crate"}
    assert "# mesh: under data/objects" in (workspace / "params.yaml").read_text()  # comments survive


def test_a_ply_brings_its_texture_and_deleted_data_comes_back(workspace, tmp_path):
    Image.fromarray(np.full((8, 8, 3), 200, np.uint8)).save(tmp_path / "skin.png")
    header = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 4\nproperty float x\n"
    header += "property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 4\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    body = "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n0 0 1 1 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    (tmp_path / "tetra.ply").write_text(header + body)
    catalog.add_mesh(tmp_path / "tetra.ply", "tetra", "wood", 0.1, None)
    home = workspace / "data/objects/tetra"
    assert load_mesh(home / "mesh.ply").texture.max() == 200
    shutil.rmtree(home)
    build(["normalize@tetra"])  # the stage itself cannot run here; its data comes first
    assert load_mesh(home / "mesh.ply").texture.max() == 200


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": "mug"}, "exists already"),
        ({"key": "Crate 1"}, "not a valid object key"),
        ({"material": "jelly"}, "unknown material 'jelly'"),
        ({"scale": 0.0}, "expected the longest side in metres"),
        ({"scale": -1.0}, "expected the longest side in metres"),
        ({"scale": 200.0}, "give it in metres"),
        ({"up": "x"}, "neither 'y' nor 'z'"),
        ({"mesh": Path("nothing.obj")}, "nothing.obj does not exist"),
    ],
)
def test_bad_arguments_change_nothing(workspace, box, change, message):
    before = snapshot(workspace)
    arguments = {"mesh": box, "key": "crate", "material": "wood", "scale": None, "up": None, **change}
    with pytest.raises(ObjectFolderError, match=message):
        catalog.add_mesh(**arguments)
    assert snapshot(workspace) == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "NaN"),
        ("mtllib ../else.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "outside its folder"),
        ("mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "gone.mtl, which does not exist"),
    ],
)
def test_bad_meshes_change_nothing(workspace, tmp_path, text, message):
    mesh = tmp_path / "bad.obj"
    mesh.write_text(text)
    before = snapshot(workspace)
    with pytest.raises(ObjectFolderError, match=message):
        catalog.add_mesh(mesh, "bad", "wood", None, None)
    assert snapshot(workspace) == before


def test_catalogue_adds_what_is_missing_and_refuses_what_differs(workspace):
    assert catalog.add_catalogue(Path("catalogs/starter.yaml")) == []
    text = (
        Path("params.yaml")
        .read_text()
        .replace("  die: {mesh: data/objects/die/mesh.glb, material: wood, scale: 0.16, up: y}\n", "")
    )
    Path("params.yaml").write_text(text)
    assert catalog.add_catalogue(Path("catalogs/starter.yaml")) == ["die"]
    Path("params.yaml").write_text(text.replace("material: ceramic", "material: glass"))
    with pytest.raises(ObjectFolderError, match=r"objects\.mug differs"):
        catalog.add_catalogue(Path("catalogs/starter.yaml"))


def test_preset_changes_sections_only(workspace):
    before = params.read()
    assert "render_views" in catalog.apply_preset("paper")
    after = params.read()
    assert after["render_views"]["train"] == 500
    assert after["objects"] == before["objects"]
    assert catalog.apply_preset("paper") == []
    catalog.apply_preset("quick")
    assert params.read() == before
    with pytest.raises(ObjectFolderError, match=r"no preset 'fast'.*paper, quick, standard"):
        catalog.apply_preset("fast")


@pytest.mark.parametrize(
    "name", ["ycb_mug/mesh.obj", "gso_school_bell/mesh.obj", "polyhaven_teapot/mesh.gltf"]
)
def test_real_meshes_go_through(workspace, name):
    if not (OBJECTS / name).exists():
        pytest.skip("the development set of real objects is not here")
    entry = catalog.add_mesh(OBJECTS / name, "real", "steel", None, None)
    assert entry["up"] == ("y" if name.endswith("gltf") else "z")
    copied = [p.name for p in (workspace / "data/objects/real").rglob("*") if p.is_file()]
    assert len(copied) == len([p for p in (OBJECTS / name).parent.rglob("*") if p.is_file()])
