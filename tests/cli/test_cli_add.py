"""`objectfolder add` and `preset`: all or nothing."""

import io
import os
import re
import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from refusals import refused
from rich.console import Console
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.engine.build import build
from objectfolder.engine.dvc.repository import track
from objectfolder.hub.release.notices import read_notice
from objectfolder.mesh.normalize import Normalized
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.workspace import examine as examination
from objectfolder.workspace import objects as catalog
from objectfolder.workspace import params, stages
from objectfolder.workspace.check import check_all
from objectfolder.workspace.discover import discover, slug
from objectfolder.workspace.examine import Candidate, Examination, examination_table
from objectfolder.workspace.presets import apply_preset

ROOT = Path(__file__).parents[2]
OBJECTS = ROOT.parent / "shared" / "objects"


@pytest.fixture
def coarse(workspace):
    """Meshes are examined on coarse grids, which takes a tenth of the time."""
    file = workspace / "params.yaml"
    text = file.read_text()
    for fine, few in (
        ("sdf_resolution: 192", "sdf_resolution: 48"),
        ("resolutions: [32,", "resolutions: [12,"),
    ):
        assert fine in text
        text = text.replace(fine, few)
    file.write_text(text)


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
    entry = catalog.add_mesh(box, "crate", "wood", None, None, track=track)
    assert entry == {
        "mesh": "data/objects/crate/mesh.obj",
        "material": "wood",
        "scale": pytest.approx(0.2),
        "up": "z",
        "wall": None,
        "bridge": "all",
    }
    home = workspace / "data/objects/crate"
    assert (home / "mesh.obj").read_bytes() == box.read_bytes()
    assert (home / "maps/wood grain.png").exists()
    assert (workspace / "data/objects/crate.dvc").exists()
    values = params.read()
    check_all(values)
    assert set(values["objects"]) == {"mug", "die", "bell", "crate"}
    assert "# mesh: path under data/objects" in (workspace / "params.yaml").read_text()  # comments survive


def test_a_ply_brings_its_texture_and_deleted_data_comes_back(workspace, tmp_path):
    Image.fromarray(np.full((8, 8, 3), 200, np.uint8)).save(tmp_path / "skin.png")
    header = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 4\nproperty float x\n"
    header += "property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 4\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    body = "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n0 0 1 1 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    (tmp_path / "tetra.ply").write_text(header + body)
    catalog.add_mesh(tmp_path / "tetra.ply", "tetra", "wood", 0.1, None, track=track)
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
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "NaN"),
        ("mtllib ../else.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "outside its folder"),
        ("mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "gone.mtl, which does not exist"),
    ],
)
def test_bad_arguments_and_meshes_change_nothing(workspace, box, change, message):
    before = snapshot(workspace)
    if isinstance(change, str):
        box.write_text(change)
        change = {}
    arguments = {"mesh": box, "key": "crate", "material": "wood", "scale": None, "up": None, **change}
    refused(message, catalog.add_mesh, **arguments, track=track)
    assert snapshot(workspace) == before


def test_a_list_of_published_objects_is_for_fetch(workspace):
    refused("objectfolder fetch --catalogue", catalog.add_catalogue, ROOT / "catalogs/objectfolder1.yaml")


def test_catalogue_adds_what_is_missing_and_refuses_what_differs(workspace):
    assert catalog.add_catalogue(Path("catalogs/starter.yaml")) == []
    text = re.sub(r"\n  die: {mesh.*", "", Path("params.yaml").read_text())
    Path("params.yaml").write_text(text)
    assert catalog.add_catalogue(Path("catalogs/starter.yaml")) == ["die"]
    Path("params.yaml").write_text(text.replace("material: ceramic", "material: glass"))
    refused(r"objects\.mug differs", catalog.add_catalogue, Path("catalogs/starter.yaml"))


def test_preset_changes_sections_only(workspace):
    before = params.read()
    changes = apply_preset("faithful", dry_run=True)
    assert "render_views.train: 1200 -> 500" in changes
    assert params.read() == before
    assert apply_preset("faithful") == changes
    after = params.read()
    assert after["render_views"]["train"] == 500
    assert after["objects"] == before["objects"]
    assert apply_preset("faithful") == []
    apply_preset("quick")
    assert params.read() == before
    refused(r"no preset 'fast'.*quick, faithful, faithful-small, laptop, standard", apply_preset, "fast")


@pytest.mark.parametrize(
    ("file", "text", "wrong", "message"),
    [
        ("params.yaml", "material: steel", "material: mithril", r"^params\.yaml: objects\.bell: material"),
        ("params.yaml", "reach: []", "reach: [spoon]", r"^params\.yaml: benchmarks\.reach: spoon"),
        ("params.yaml", "seed: 0", "seed: 0\nsmell: 1", r"^params\.yaml: 'smell' is not a section"),
        ("params/laptop.yaml", "epochs: 16", "epochs: many", r"^params/laptop\.yaml: recognize"),
        (
            "params/laptop.yaml",
            "epochs: 16",
            "epoch: 16",
            r"^params/laptop\.yaml: recognize: epoch: .*epochs",
        ),
        (
            "params/laptop.yaml",
            "recognize:",
            "recognise:",
            r"'recognise' is not a section; do you mean recog",
        ),
    ],
)
def test_preset_blames_the_file_that_is_wrong(workspace, file, text, wrong, message):
    Path(file).write_text(Path(file).read_text().replace(text, wrong, 1))
    refused(message, apply_preset, "laptop")


def test_a_preset_gives_the_same_settings_whatever_was_before(workspace):
    Path("params/own.yaml").write_text("evaluate: {impacts: 10}\n")
    apply_preset("laptop")
    apply_preset("own")
    found = params.read()
    assert apply_preset("quick") == ["evaluate.impacts: 10 -> 200"]
    assert found | {"evaluate": {"impacts": 200}} == params.read()


@pytest.mark.parametrize(
    "name",
    [
        "gso_school_bell/mesh.obj",
        *(
            pytest.param(n, marks=pytest.mark.slow)
            for n in ("ycb_mug/mesh.obj", "polyhaven_teapot/mesh.gltf")
        ),
    ],
)
def test_real_meshes_go_through(workspace, name):
    if not (OBJECTS / name).exists():
        pytest.skip("the development set of real objects is not here")
    entry = catalog.add_mesh(OBJECTS / name, "real", "steel", None, None, track=track)
    assert entry["up"] == ("y" if name.endswith("gltf") else "z")
    copied = [p.name for p in (workspace / "data/objects/real").rglob("*") if p.is_file()]
    assert len(copied) == len([p for p in (OBJECTS / name).parent.rglob("*") if p.is_file()])


def run(*arguments):
    return CliRunner().invoke(app, ["add", *map(str, arguments)])


def row(result, key):
    """Cells of one object's line of the table."""
    return next(line.split() for line in result.output.splitlines() if line.split()[:1] == [key])


@pytest.fixture
def collection(tmp_path):
    """A folder of meshes, some of which cannot be added; sizes in metres."""
    folder = tmp_path / "my objects"
    for name in ("025_Mug (blue)", "open", "both", "textures", ".hidden"):
        (folder / name).mkdir(parents=True)
    cube = trimesh.creation.box([0.2, 0.1, 0.1])
    cube.export(folder / "025_Mug (blue)" / "textured.glb")
    cube.export(folder / "Brick.stl")
    (folder / "Brick.stl").rename(folder / "Brick.STL")
    cube.export(folder / "both" / "a.ply")
    cube.export(folder / "both" / "b.off")
    cube.export(folder / ".hidden" / "a.ply")
    pair = trimesh.util.concatenate([cube, cube.copy().apply_translation([1, 0, 0])])
    pair.export(folder / "open" / "mesh.ply")
    (folder / "textures" / "skin.png").write_bytes(b"")
    return folder


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("025_Mug (blue)", "mug_blue"),
        ("Tasse à café", "tasse_a_cafe"),
        ("065-a_cups", "a_cups"),
        ("-- 42 --", "object_42"),
        ("---", "object"),
        ("a__b", "a_b"),
    ],
)
def test_names_become_keys(name, key):
    assert slug(name) == key
    stages.check_key(key)


@pytest.mark.usefixtures("coarse")
def test_a_folder_shows_what_it_understood_and_adds_what_it_can(workspace, collection):
    result = run(collection, "--material", "wood")
    assert result.exit_code == 1
    assert row(result, "mug_blue") == ["mug_blue", "wood", "0.2", "y?", "1", "closed", "already", "2,000"]
    assert row(result, "brick") == ["brick", "wood", "0.2", "z?", "1", "closed", "already", "2,000"]
    assert row(result, "open") == ["open", "wood", "refused"]
    assert row(result, "both") == ["both", "wood", "refused"]
    assert "refused open: 2 separate pieces" in result.output
    assert re.search(r"refused both: .*both holds 2 meshes \(both/a\.ply, both/b\.off\)", result.output)
    assert "2 added, 2 refused" in result.output
    objects = params.read()["objects"]
    assert set(objects) == {"mug", "die", "bell", "mug_blue", "brick"}
    assert objects["mug_blue"] == {
        "mesh": "data/objects/mug_blue/mesh.glb",
        "material": "wood",
        "scale": pytest.approx(0.2),
        "up": "y",
        "wall": None,
        "bridge": "all",
    }
    assert objects["brick"]["mesh"] == "data/objects/brick/mesh.stl"
    left = {p.name for p in (workspace / "data/objects").iterdir()} - {".gitignore"}
    assert left == {"mug_blue", "mug_blue.dvc", "brick", "brick.dvc"}


@pytest.mark.usefixtures("coarse")
def test_a_dry_run_changes_nothing(workspace, collection):
    before = snapshot(workspace)
    result = run(collection, "--material", "wood", "--dry-run")
    assert result.exit_code == 1
    assert "2 can be added, 2 refused" in result.output
    (collection / "both" / "b.off").unlink()
    shutil.rmtree(collection / "open")
    result = run(collection, "--material", "wood", "--dry-run", "--up", "y")
    assert result.exit_code == 0
    assert "3 can be added" in result.output
    assert row(result, "brick")[3] == "y"
    assert snapshot(workspace) == before


@pytest.mark.usefixtures("coarse")
def test_an_object_that_is_there_is_refused_and_the_others_are_added(workspace, collection):
    (collection / "025_Mug (blue)").rename(collection / "mug")
    result = run(collection, "--material", "wood")
    remedy = "delete objects.mug and procedural.mug from params.yaml"
    message = f"refused mug: object 'mug' exists already; choose another name, or remove it: {remedy}\n"
    assert message in result.output
    assert "brick" in params.read()["objects"]
    assert run(collection, "--material", "wood").exit_code == 1  # and again: nothing new, nothing lost
    assert set(params.read()["objects"]) == {"mug", "die", "bell", "brick"}


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("materials.csv", "name,material\n025_Mug (blue),ceramic\nbrick,iron\n"),
        ("materials.csv", "Name,Material\n025_Mug (blue),ceramic\nbrick,iron\n"),
        ("materials.csv", "\ufeffname,material\n025_Mug (blue),ceramic\nbrick,iron\n"),  # Excel's UTF-8
        ("materials.yaml", "025_Mug (blue): ceramic\nBrick.STL: iron\n"),
    ],
)
@pytest.mark.usefixtures("coarse")
def test_a_list_names_materials(workspace, collection, file, text):
    (collection / file).write_text(text)
    by_key = {c.key: c.material for c in discover(collection, "wood")}
    assert by_key == {"mug_blue": "ceramic", "brick": "iron", "open": "wood", "both": "wood"}
    result = run(collection, "--dry-run")
    assert row(result, "mug_blue")[1] == "ceramic"
    assert "refused open: open has no material; give --material, or list it in materials.csv" in result.output


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("materials.csv", "name,material\nbrik,iron\n", "names brik, which it does not contain"),
        ("materials.csv", "brick\n", r"line 1 is 'brick', expected `name,material` or `name,material,mass`$"),
        ("materials.csv", "brick,a,1,b\n", r"line 1 is 'brick,a,1,b', expected `name,material` or `name,mat"),
        *(
            ("materials.csv", f"name,{column}\nBrick,{text}\n", rf"line 2: {column} of 'Brick'.* {expected}")
            for column, text, expected in (
                ("size", "112 mm", r"is '112 mm', expected metres above 0, such as 0\.112"),
                ("size", "0", "is '0', expected metres"),
                ("wall", "-0.002", r"is '-0\.002', expected metres above 0, such as 0\.002"),
                ("up", "x", "is 'x', expected y, z or nothing"),
                ("licence", "a\x1bb", r"'a\\x1bb', expected a line of 1 to 1000 characters"),
                ("author", "a" * 1001, "expected a line of 1 to 1000 characters"),
            )
        ),
        (
            "materials.csv",
            "name,colour\nBrick,red\n",
            "line 1: column 'colour' is unknown; .* name, material, ",
        ),
        (
            "materials.csv",
            "name,License,licence\nBrick,a,b\n",
            "line 1: column 'License' is there twice; expected",
        ),
        ("materials.csv", "name,size\nBrick,1,iron\n", "line 2 is 'Brick,1,iron', expected `name,size`"),
        *(
            (
                "materials.csv",
                f"name,material,mass\nBrick,iron,{mass}\n",
                f"line 2: mass of 'Brick' is '{mass}'",
            )
            for mass in ("0", "-0.1", "nan", "inf", "118 g", "red")
        ),
        ("materials.csv", "Brick,iron\n\nopen;steel\n", r"materials\.csv, line 3 is 'open;steel', expected"),
        (
            "materials.csv",
            "Brick,iron,red\n",
            r"'red', expected kilograms above 0, such as 0\.118, or nothing",
        ),
        ("materials.yaml", "- brick\n", r"materials\.yaml holds list; expected"),
        ("materials.yaml", "{", r"materials\.yaml, line [12] is not valid YAML"),
    ],
)
def test_a_bad_list_of_materials_is_refused(collection, file, text, message):
    (collection / file).write_text(text)
    refused(r"(?s)" + message, discover, collection)
    (collection / "materials.yml").write_text("brick: iron\n")
    refused("both assign materials", discover, collection)


@pytest.mark.usefixtures("coarse")
def test_masses_of_a_list_are_entered_and_impossible_ones_refused(workspace, collection):
    lines = "name,material,mass\n025_Mug (blue),ceramic,0.35\nbrick,iron,\nopen,wood\nboth,wood,3\n"
    (collection / "materials.csv").write_text(lines)
    found = {one.key: one.mass for one in discover(collection)}
    assert found == {"mug_blue": 0.35, "brick": None, "open": None, "both": 3}
    run(collection)
    objects = params.read()["objects"]
    assert objects["mug_blue"]["mass"] == 0.35
    assert "mass" not in objects["brick"]
    (collection / "materials.csv").write_text(lines.replace("0.35", "350").replace("_Mug", "_Cup"))
    (collection / "025_Mug (blue)").rename(collection / "025_Cup (blue)")
    said = re.search(r"refused cup_blue: (.*)", run(collection).output)[1]
    assert re.match(r"mass is 350 kg, in its volume of .* for 350 g, or check the scale, in metres", said)


@pytest.mark.usefixtures("coarse")
def test_a_table_gives_each_object_its_size_up_axis_wall_licence_and_author(workspace, collection):
    lines = [
        "Author, LICENSE, name, up, wall, size, mass, material",
        '"Smith, A.", CC-BY-4.0, 025_Mug (blue), z, 0.004, 0.15, 0.35, ceramic',
        ",,Brick",
        ",,,,,,,",
        ",CC0-1.0,open,,,0.3",
    ]
    (collection / "materials.csv").write_text("\n".join(lines))
    result = run(collection, "--material", "wood", "--wall", "0.01")
    assert row(result, "mug_blue")[:4] == ["mug_blue", "ceramic", "0.15", "z"]
    assert row(result, "brick")[:4] == ["brick", "wood", "0.2", "z?"]
    objects = params.read()["objects"]
    mug = {name: objects["mug_blue"][name] for name in ("material", "scale", "up", "wall", "mass")}
    assert mug == {"material": "ceramic", "scale": 0.15, "up": "z", "wall": 0.004, "mass": 0.35}
    assert objects["brick"]["wall"] == 0.01
    notice = read_notice(Path(objects["mug_blue"]["mesh"]))
    assert (notice.licence, notice.attribution, notice.title) == ("CC-BY-4.0", "Smith, A.", "")
    assert notice.path.read_text() == "Licence: CC-BY-4.0\nAttribution: Smith, A.\n"
    assert read_notice(Path(objects["brick"]["mesh"])) is None
    assert {one.key: one.size for one in discover(collection)}["open"] == 0.3


@pytest.mark.usefixtures("coarse")
def test_a_notice_beside_a_mesh_is_kept_and_a_table_comes_first(workspace, collection):
    beside = "Blue Mug\n  Licence: CC-BY-4.0\n  Attribution: Smith, A.\n"
    (collection / "025_Mug (blue)" / "SOURCE.txt").write_text(beside)
    address = "Blue Mug, https://example.org/mug"
    table = f'name,material,source,author\n025_Mug (blue),ceramic,"{address}",Jones\nbrick,iron\n'
    (collection / "materials.csv").write_text(table)
    run(collection, "--material", "wood")
    notice = read_notice(Path(params.read()["objects"]["mug_blue"]["mesh"]))
    assert (notice.licence, notice.attribution, notice.source) == ("CC-BY-4.0", "Jones", address)
    assert notice.path.read_text().endswith(beside)


@pytest.mark.usefixtures("coarse")
def test_a_mass_is_entered_with_the_mesh(workspace, box):
    crate = (box, "--name", "crate", "--material", "wood", "--mass")
    before = snapshot(workspace)
    for mass, said in (
        ("0", "mass is 0, expected kilograms above 0; leave it out if it is not known"),
        ("-0.1", "mass is -0.1, expected kilograms"),
        ("nan", "mass is nan, expected kilograms"),
        (
            "800",
            "crate: mass is 800 kg, in its volume of 2000 cm³ a density of 4e+05 kg/m³, expected 1 to 25,000",
        ),
    ):
        assert said in str(run(*crate, mass).exception)
    for mass, example in (("118 g", "0.118"), ("2kg", "2"), ("heavy", "0.118")):
        said = re.sub(r"[│\s]+", " ", run(*crate, mass).output)
        assert f"'{mass}' is not a number of kilograms, such as {example}" in said
    assert snapshot(workspace) == before
    assert "added crate: wood, 0.8 kg, longest side 0.2 m" in run(*crate, "0.8").output
    assert params.read()["objects"]["crate"]["mass"] == 0.8
    check_all(params.read())


@pytest.mark.usefixtures("coarse")
def test_an_unknown_material_refuses_that_object_alone(workspace, collection):
    (collection / "materials.csv").write_text("brick,jelly\n")
    result = run(collection, "--material", "wood", "--dry-run")
    assert "refused brick: unknown material 'jelly'" in result.output
    assert "1 can be added, 3 refused" in result.output


def test_folders_whose_names_give_one_key_are_both_refused(collection):
    shutil.copytree(collection / "025_Mug (blue)", collection / "025-mug-blue")
    refused = [c for c in discover(collection) if c.key == "mug_blue_025"]
    assert len(refused) == 2
    names = "025-mug-blue/ and 025_Mug (blue)/"
    message = f"{names} in {collection} would both be named 'mug_blue_025'; rename all but one"
    assert all(c.refusal.startswith(message) for c in refused)


@pytest.mark.usefixtures("coarse")
def test_files_whose_names_give_one_key_are_named(workspace, tmp_path):
    folder = tmp_path / "set"
    folder.mkdir()
    for suffix in ("off", "ply", "stl", "glb", "obj"):
        trimesh.creation.box([0.2, 0.1, 0.1]).export(folder / f"box.{suffix}")
    result = run(folder, "--material", "wood", "--dry-run")
    assert result.exit_code == 1
    said = [line for line in result.output.splitlines() if line.startswith("refused")]
    (message,) = said
    assert f"box.glb, box.obj, box.off and 2 more in {folder} would all be named 'box'; rename" in message
    assert "0 can be added, 5 refused" in result.output


@pytest.mark.usefixtures("coarse", "workspace")
def test_files_that_are_no_mesh_but_a_shape_are_said_to_be_skipped(tmp_path):
    """Those beside a mesh of their name are copies; a texture or a text is no shape."""
    folder = tmp_path / "set"
    (folder / "cup").mkdir(parents=True)
    trimesh.creation.box([1, 1, 1]).export(folder / "box.obj")
    for name in ("box.blend", "ball.FBX", "cup/cup.usdz", "wood.png", "readme.txt", ".old.fbx"):
        (folder / name).write_bytes(b"")
    (folder / "away.glb").symlink_to(tmp_path / "nothing.glb")
    result = run(folder, "--material", "wood", "--dry-run")
    assert "3 files skipped: away.glb, ball.FBX, cup/cup.usdz; expected .obj, " in result.output
    assert "1 can be added" in result.output


def test_names_keep_their_numbers_where_others_have_the_same_words(tmp_path):
    for name in ("obj_000001", "obj_000003", "002_apple", "001_apple", "007_pear", "02876657", "02876658"):
        trimesh.creation.box([1, 1, 1]).export(tmp_path / f"{name}.ply")
    keys = [
        "apple_001",
        "apple_002",
        "pear",
        "object_02876657",
        "object_02876658",
        "obj_000001",
        "obj_000003",
    ]
    assert [candidate.key for candidate in discover(tmp_path)] == keys
    assert not any(candidate.refusal for candidate in discover(tmp_path))


def test_a_list_of_materials_names_files_in_either_form_of_unicode(tmp_path):
    for form, name in (("NFC", "Tasse à café"), ("NFD", "Schüssel")):
        trimesh.creation.box([1, 1, 1]).export(tmp_path / f"{unicodedata.normalize(form, name)}.ply")
    lines = [unicodedata.normalize("NFD", "Tasse à café") + ",ceramic", "Schüssel,steel"]
    (tmp_path / "materials.csv").write_text("\n".join(lines))
    assert {c.key: c.material for c in discover(tmp_path)} == {"tasse_a_cafe": "ceramic", "schussel": "steel"}


def test_numbered_meshes_in_the_folder_of_a_collection_are_objects(tmp_path):
    (tmp_path / "lm" / "models").mkdir(parents=True)
    for number in (1, 2):
        trimesh.creation.box([1, 1, 1]).export(tmp_path / "lm" / "models" / f"obj_{number:06}.ply")
    for folder in (tmp_path / "lm", tmp_path / "lm" / "models"):
        assert [candidate.key for candidate in discover(folder)] == ["obj_000001", "obj_000002"]


def write_textured(folder, picture, names):
    """Write an OBJ of a box with a texture of one colour, which its library names in the given words."""
    box = trimesh.creation.box([0.1, 0.06, 0.04])
    faces = [f"f {a}/1 {b}/1 {c}/1" for a, b, c in box.faces + 1]
    folder.mkdir(parents=True)
    lines = ["mtllib model.mtl", *(f"v {x} {y} {z}" for x, y, z in box.vertices), "vt 0.5 0.5", "usemtl m"]
    (folder / "model.obj").write_text("\n".join([*lines, *faces]))
    (folder / "model.mtl").write_text(f"newmtl m\nmap_Kd {names}\n")
    picture.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (4, 4), (10, 200, 30)).save(picture)


@pytest.mark.parametrize(
    ("inside", "picture", "names", "note"),
    [
        ("meshes", "materials/textures/skin.png", "skin.png", "../materials/textures"),
        ("models", "images/skin.png", "../images/skin.png", "../images"),
        ("visual", "textures/skin.png", "C:\\scans\\skin.png", "../textures"),
        ("", "materials/textures/skin.png", "skin.png", ""),
    ],
    ids=["Gazebo Fuel", "ShapeNet", "a path of Windows", "below"],
)
@pytest.mark.usefixtures("coarse")
def test_a_texture_in_another_folder_of_the_object_is_copied_and_noted(
    workspace, tmp_path, inside, picture, names, note
):
    home = tmp_path / "set" / "Tumbler"
    write_textured(home / inside, home / picture, names)
    result = run(tmp_path / "set", "--material", "ceramic")
    assert "1 added" in result.output, result.output
    assert (f"tumbler: skin.png is taken from {note}" in result.output) == bool(note)
    copy = load_mesh(workspace / "data" / "objects" / "tumbler" / "mesh.obj")
    assert (copy.texture == (10, 200, 30)).all()


@pytest.mark.usefixtures("coarse")
def test_of_several_meshes_of_one_object_the_textured_one_is_taken(workspace, tmp_path):
    inside = tmp_path / "set" / "025_tumbler" / "google_16k"
    write_textured(inside, inside / "skin.png", "skin.png")
    for name in ("a_plain.ply", "z_plain.stl", "broken.glb"):
        trimesh.creation.box([0.1, 0.06, 0.04]).export(inside / name)
    (inside / "broken.glb").write_bytes(b"glTF")
    result = run(tmp_path / "set", "--material", "ceramic")
    assert "tumbler: of the 4 meshes in its folder, model.obj alone has a texture or colours" in result.output
    assert params.read()["objects"]["tumbler"]["mesh"] == "data/objects/tumbler/mesh.obj"
    shutil.copytree(inside, inside.parent.parent / "cup" / "poisson")
    shutil.copytree(inside, inside.parent.parent / "cup" / "tsdf")
    for folder in (inside, inside.parent):
        assert [(candidate.key, len(candidate.others)) for candidate in discover(folder)] == [("tumbler", 3)]
    result = run(inside.parent.parent / "cup", "--material", "ceramic", "--dry-run")
    assert "poisson/model.obj" in result.output
    assert "of which 2 have a texture or colours" in result.output


@pytest.mark.parametrize("error", [ValueError("odd"), MemoryError(), RecursionError()])
def test_whatever_one_mesh_raises_the_others_are_examined(workspace, tmp_path, monkeypatch, error):
    def examine(candidate, *_):
        if candidate.key == "a":
            raise error
        return Examination(candidate)

    monkeypatch.setattr(examination, "examine", examine)
    first, second = examination.examine_all(
        [Candidate("a", Path("a.obj")), Candidate("b", Path("b.obj"))], {}
    )
    assert first.refusal.startswith(f"a.obj cannot be examined ({type(error).__name__}")
    assert second.refusal is None


@pytest.mark.parametrize(
    ("case", "keys"),
    [
        ("13_gazebo_fuel_layout", ["tumbler"]),
        ("14_shapenet_layout", ["object_02876657"]),
        ("30_numbered_instances/bop", ["obj_000001", "obj_000002", "obj_000003"]),
    ],
)
@pytest.mark.usefixtures("coarse")
def test_folders_from_the_field_are_understood(workspace, tmp_path, case, keys):
    source, folder = OBJECTS.parent / "cases" / case, tmp_path / "set"
    if not source.is_dir():
        pytest.skip("shared/cases is not here")
    shutil.copytree(source, folder)
    if (folder / "Mug").is_dir():
        (folder / "Mug").rename(folder / "Tumbler")  # the workspace has a mug
    assert f"{len(keys)} added" in run(folder, "--material", "ceramic").output
    assert set(params.read()["objects"]) == {"mug", "die", "bell", *keys}


def test_deeper_folders_and_the_folder_of_one_mesh(tmp_path):
    deep = tmp_path / "set" / "024_bowl" / "google_16k"
    deep.mkdir(parents=True)
    trimesh.creation.box([1, 1, 1]).export(deep / "textured.ply")
    assert [(c.key, c.mesh) for c in discover(tmp_path / "set")] == [("bowl", deep / "textured.ply")]
    for folder in (deep, deep.parent):
        assert [(c.key, c.mesh) for c in discover(folder)] == [("bowl", deep / "textured.ply")]
    for name in ("google_16k", "textured", "textured.ply"):
        (deep / "materials.csv").write_text(f"{name},ceramic\n")
        assert [c.material for c in discover(deep)] == ["ceramic"]
    deep.joinpath("textured.ply").unlink()
    refused("hold no mesh", discover, tmp_path / "set")


@pytest.mark.parametrize(
    ("size", "unit", "code", "message"),
    [
        (117.0, "m", 1, r"117 m, expected .* perhaps it is 117 cm or 117 mm; give --unit or --scale"),
        (117.0, "mm", 0, "1 can be added"),
        (1500.0, "m", 1, "perhaps it is 1500 mm; give --unit"),
        (11.7, "m", 0, "11.7 m is large: perhaps it is 11.7 cm or 11.7 mm; give --unit or --scale"),
        (0.117, "m", 0, "1 can be added"),
        (0.117, "mm", 1, "0.000117 m, expected .*; perhaps it is 0.117 m; give another --unit or --scale"),
    ],
)
@pytest.mark.usefixtures("coarse")
def test_sizes_that_look_like_other_units(workspace, tmp_path, size, unit, code, message):
    folder = tmp_path / "set"
    folder.mkdir()
    trimesh.creation.box([size, size / 2, size / 3]).export(folder / "box.ply")
    result = run(folder, "--material", "wood", "--unit", unit, "--dry-run")
    assert result.exit_code == code
    assert re.search(message, result.output)
    if (size, unit) == (117, "mm"):
        assert row(result, "set")[2] == "0.117"


@pytest.mark.usefixtures("coarse")
def test_one_mesh_is_examined_before_it_is_added(workspace, collection, monkeypatch):
    before = snapshot(workspace)
    result = run(collection / "open" / "mesh.ply", "--name", "pair", "--material", "wood")
    assert isinstance(result.exception, ObjectFolderError)
    assert "2 separate pieces" in str(result.exception)
    brick = [collection / "Brick.STL", "--name", "brick", "--material", "wood"]
    dry = run(*brick, "--scale", "0.5", "--dry-run")
    assert dry.exit_code == 0
    assert row(dry, "brick")[2:] == ["0.5", "z?", "1", "closed", "already", "31,250"]
    assert snapshot(workspace) == before
    loaded = []
    for module in (catalog, examination):
        monkeypatch.setattr(module, "load_mesh", lambda *given: loaded.append(given) or load_mesh(*given))
    done = run(*brick, "--unit", "cm")
    assert done.exit_code == 0
    assert len(loaded) == 1
    assert "added brick: wood, longest side 0.002 m, z up; next: objectfolder build brick" in done.output
    assert params.read()["objects"]["brick"]["scale"] == pytest.approx(0.002)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--name", "x"], "my objects/Brick.STL"),
        (["--scale", "0.1"], "is a folder; --name, --scale and --mass are for one mesh, such as /"),
        (["--mass", "0.1"], "is a folder; --name, --scale and --mass are for one mesh, such as /"),
        (["--unit", "inch"], "unit 'inch' is not one of m, cm, mm"),
        (["--up", "x"], "up axis 'x' is neither 'y' nor 'z'"),
        (["--wall", "inf"], "wall is inf, expected a thickness in metres"),
        (["--wall", "nan"], "wall is nan, expected a thickness in metres"),
    ],
)
def test_bad_options_change_nothing(workspace, collection, arguments, message):
    before = snapshot(workspace)
    result = run(collection, "--material", "wood", *arguments)
    assert message in str(result.exception)
    assert snapshot(workspace) == before


@pytest.mark.parametrize(
    "options",
    [
        ("--dry-run",),
        ("--material", "steel"),
        *(("--scale", "3"), ("--unit", "mm"), ("--up", "y"), ("--name", "foo"), ("--wall", "0.1")),
        *(("--bridge", "off"), ("--mass", "0.1")),
    ],
)
def test_options_for_meshes_are_refused_for_a_catalogue(workspace, options):
    before = snapshot(workspace)
    message = f"is a catalogue, whose entries set these; {options[0]} applies to meshes only"
    assert message in str(run("catalogs/starter.yaml", *options).exception)
    both = run("catalogs/starter.yaml", "--scale", "3", "--dry-run").exception
    assert str(both).endswith("; --scale and --dry-run apply to meshes only")
    assert snapshot(workspace) == before


@pytest.mark.parametrize(
    ("name", "problem"), [("nosuch.yaml", "does not exist"), ("folder.yaml", "is a folder")]
)
def test_a_catalogue_that_is_not_there_is_named(workspace, name, problem):
    (workspace / "folder.yaml").mkdir()
    message = str(run(name).exception)
    assert message == f"{name} {problem}; expected a catalogue such as catalogs/starter.yaml"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\nseed: 0", "\nsed: 0", "'sed' is not a section; do you mean seed?"),
        ("material: ceramic", "material: cermic", "objects.mug: material: unknown material 'cermic'"),
    ],
)
def test_nothing_is_added_to_parameters_that_a_build_refuses(workspace, collection, old, new, message):
    text = (workspace / "params.yaml").read_text()
    assert old in text
    (workspace / "params.yaml").write_text(text.replace(old, new))
    before = snapshot(workspace)
    brick = (collection / "Brick.STL", "--name", "brick", "--material", "wood")
    for words in (
        (*brick, "--dry-run"),
        brick,
        (collection, "--material", "wood"),
        ("catalogs/starter.yaml",),
    ):
        error = run(*words).exception
        assert isinstance(error, ObjectFolderError)
        assert message in str(error)
    assert snapshot(workspace) == before


@pytest.mark.usefixtures("coarse")
def test_notes_count_one_in_the_singular(workspace, tmp_path, monkeypatch):
    report = Normalized.report
    monkeypatch.setattr(Normalized, "report", lambda *given: report(*given) | {"self_intersections": 1})
    sheet = trimesh.Trimesh([[0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0]], [[0, 1, 2], [0, 2, 3]])
    sheet.export(tmp_path / "sheet.ply")
    result = run(tmp_path / "sheet.ply", "--name", "sheet", "--material", "wood", "--dry-run")
    assert "sheet: 1 open sheet got a wall of 2% of the size" in result.output
    assert "the surface intersects itself (1 edge)" in result.output


@pytest.mark.parametrize("option", ["--scale", "--wall"])
@pytest.mark.parametrize(
    ("given", "example"), [("112mm", "0.112"), ("45.5 cm", "0.455"), ("2m", "2"), ("large", "0.112")]
)
def test_lengths_with_a_unit_are_refused_with_those_in_metres(workspace, option, given, example):
    result = run("brick.stl", option, given)
    assert result.exit_code == 2
    said = re.sub(r"[│\s]+", " ", result.output)
    assert f"{given!r} is not a number of metres, such as {example} " in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--scale", "112"), r".*; give it in metres: 1\.12 for 112 cm or 0\.112 for 112 mm"),
        (("--scale", "-1"), ".*; give it in metres"),
        (
            ("--scale", "12", "--unit", "cm"),
            "--scale 12 is in metres, not in the unit.*give --scale, or --unit cm, not both",
        ),
        (
            ("--wall", "0.1"),
            r"wall of brick is 0\.1 m, expected less than half of its size, 0\.2 m; give it in metres",
        ),
    ],
    ids=["scale", "negative", "unit", "wall"],
)
@pytest.mark.usefixtures("coarse")
def test_lengths_that_do_not_fit_are_refused(workspace, collection, options, message):
    brick = (collection / "Brick.STL", "--name", "brick", "--material", "wood", *options)
    assert re.fullmatch(message, str(run(*brick).exception))


@pytest.mark.usefixtures("coarse")
def test_a_large_scale_is_noted(workspace, collection):
    brick = (collection / "Brick.STL", "--name", "brick", "--material", "wood", "--dry-run")
    large = run(*brick, "--scale", "12")
    assert "brick: 12 m is large: give it in metres: 0.12 for 12 cm or 0.012 for 12 mm" in large.output


@pytest.mark.usefixtures("coarse")
def test_the_walls_of_a_sheet_add_to_its_size(workspace, tmp_path):
    """A step whose upper side shows up and whose lower end shows out: the wall of the flange is beyond it."""
    corners = np.array([(-0.1, 0.03), (-0.1, 0), (0.1, 0), (0.1, -0.03)])
    vertices = np.concatenate([np.insert(corners, 1, y, 1) for y in (-0.04, 0.04)])
    faces = [face for i in range(3) for face in ((i, i + 4, i + 1), (i + 1, i + 4, i + 5))]
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "step.ply")
    step = (tmp_path / "step.ply", "--name", "step", "--material", "steel", "--dry-run")
    for given, size in ((("--wall", "0.01"), "0.21"), (("--wall", "0.01", "--scale", "0.2"), "0.2")):
        assert row(run(*step, *given), "step")[2] == size


def test_a_mesh_in_the_place_of_its_copy_is_not_to_be_deleted(workspace, box):
    home = workspace / "data/objects/crate"
    shutil.copytree(box.parent, home)
    message = str(run(home / "box.obj", "--name", "crate", "--material", "wood").exception)
    assert message.endswith("where its copy will be; move it out of data/objects and add it from there")


@pytest.mark.usefixtures("coarse")
def test_a_capped_mouth_is_noted(workspace, tmp_path):
    ball = trimesh.creation.icosphere(3, 0.1)
    ball.update_faces(ball.triangles_center[:, 2] < 0.093)
    ball.export(tmp_path / "vase.ply")
    vase = (tmp_path / "vase.ply", "--name", "vase", "--material", "glass", "--dry-run")
    assert "vase: 1 hole capped: the piece is solid; give --wall for a shell" in run(*vase).output
    assert "thicken" in row(run(*vase, "--wall", "0.01"), "vase")


@pytest.mark.parametrize("width", [60, 80, 100])
def test_numbers_of_the_table_stay_whole_in_a_narrow_terminal(width):
    found = [
        Examination(
            Candidate("a_rather_long_object_key", Path("a_rather_long_file_name.obj"), "ceramic"), *values
        )
        for values in (
            (0.0615249, "z", 12, "keep", 254.9e-6),
            (1.23456, "y", 1, "thicken", 2549.04e-6),
            (0.2, "z", 1234, "untangle", 1.25),
        )
    ]
    console = Console(file=io.StringIO(), width=width)
    console.print(examination_table(found, True))
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    assert ("a_rather_long_object_key" in words) == (width >= 80)
    for number in ("0.06152", "12", "254.9", "1.235", "2,549", "0.2", "1234", "1,250,000"):
        assert number in words
    assert "keep" not in words
    if width >= 80:
        assert {"closed", "already", "thicken", "untangle", "ceramic"} < set(words)


@pytest.mark.parametrize(("ups", "guessed"), [(["z", None], ["z", "y?"]), (["z", "y"], ["z", "y"])])
def test_the_table_says_what_is_guessed_only_if_something_is(ups, guessed):
    found = [
        Examination(
            Candidate("cup", Path("cup.obj"), "ceramic", up=up), 0.1, shown.rstrip("?"), 1, "keep", 1e-4
        )
        for up, shown in zip(ups, guessed)
    ]
    console = Console(file=io.StringIO(), width=100)
    console.print(examination_table(found, False))
    text = console.file.getvalue()
    assert [line.split()[3] for line in text.splitlines() if line.startswith("cup")] == guessed
    assert ("? guessed" in text) == ("y?" in guessed)


@pytest.mark.usefixtures("coarse")
def test_a_full_disk_refuses_each_object_and_leaves_nothing(workspace, collection, monkeypatch):
    before = snapshot(workspace)

    def full(*arguments):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(shutil, "copyfile", full)
    result = run(collection, "--material", "wood")
    assert result.exit_code == 1
    assert "refused brick: cannot add brick" in result.output
    assert "brick to write " in result.output
    assert "0 added, 4 refused" in result.output
    assert snapshot(workspace) == before
