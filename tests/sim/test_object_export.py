"""Objects that MuJoCo and PyBullet load."""

import json
import re
import sys
from importlib.util import find_spec
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from brick import without
from refusals import refused
from typer.testing import CliRunner

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command
from objectfolder.cli import app
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import visual
from objectfolder.sim.body import rotation
from objectfolder.sim.export import write_mjcf, write_urdf
from objectfolder.sim.gltf import write_glb
from objectfolder.sim.usd import write_usd

WITH_USD = pytest.mark.skipif(not find_spec("pxr"), reason="usd-core is not installed")
WRITERS = pytest.mark.parametrize(
    "write", [write_mjcf, write_urdf, write_glb, pytest.param(write_usd, marks=WITH_USD)]
)

pytestmark = pytest.mark.usefixtures("small_textures")


@pytest.fixture(scope="module")
def mjcf(brick, body, tmp_path_factory):
    return write_mjcf(brick, tmp_path_factory.mktemp("mjcf"), hulls=body.hulls)


@pytest.fixture(scope="module")
def urdf(brick, body, tmp_path_factory):
    return write_urdf(brick, tmp_path_factory.mktemp("urdf"), hulls=body.hulls)


@pytest.fixture
def bullet():
    pybullet = pytest.importorskip("pybullet", reason="PyBullet is not installed")
    client = pybullet.connect(pybullet.DIRECT)
    yield pybullet
    pybullet.disconnect(client)


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def tensor(turn, diagonal):
    turn = np.reshape(turn, (3, 3))
    return turn @ np.diag(diagonal) @ turn.T


@pytest.mark.slow
def test_detailed_surfaces_are_simplified_until_they_fit_their_texture(monkeypatch):
    bell = ObjectFile.sample("bell")
    monkeypatch.setattr(visual, "TEXELS", 288)  # the first tolerance leaves 16,650 triangles, 3190 have room
    drawn = visual.visual_mesh(bell)
    assert 1500 < len(drawn.faces) <= 288**2 // visual._TEXELS_PER_FACE
    assert drawn.area == pytest.approx(bell.to_mesh().area, rel=0.005)
    assert visual.texture_image(drawn).size == (288, 288)


def test_surfaces_that_never_fit_their_texture_are_refused(brick, monkeypatch):
    monkeypatch.setattr(visual, "simplify", lambda mesh, tolerance: ())  # as if it was not closed
    count = len(brick.to_mesh().faces)
    refused(rf"brick: the surface has {count} triangles .* most 256,", visual.visual_mesh, brick)


@pytest.mark.parametrize("path", ["mjcf", "urdf"])
def test_mujoco_loads_mass_and_shape(request, brick, body, path):
    model = mujoco.MjModel.from_xml_path(str(request.getfixturevalue(path)))
    found = model.body("brick")
    assert found.mass[0] == pytest.approx(0.1 * 0.06 * 0.03 * 1070, rel=0.01)
    assert found.mass[0] == pytest.approx(body.mass, rel=1e-5)
    np.testing.assert_allclose(found.ipos, body.centre, atol=1e-8)
    own = tensor(rotation(found.iquat), found.inertia)
    np.testing.assert_allclose(own, body.inertia, atol=1e-5 * body.inertia.max())
    assert model.ngeom == len(body.hulls) + 1
    assert model.njnt == (path == "mjcf")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for geom in range(model.ngeom):  # hulls and the surface, in the object frame
        mesh = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert len(body.hulls) == 1
        np.testing.assert_allclose([placed.min(0), placed.max(0)], brick.bounds, atol=0.005 * brick.scale)


def test_only_hulls_collide_in_mujoco(mjcf):
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    hull, seen = model.geom("brick_hull0"), model.geom("brick_visual")
    assert (hull.contype, hull.conaffinity, seen.contype, seen.conaffinity) == (1, 1, 0, 0)
    np.testing.assert_allclose(hull.friction, [0.5, 0.005, 0.0001])
    assert 'density="1070"' in mjcf.read_text()


def test_pybullet_loads_mass_and_inertia(bullet, urdf, body):
    loaded = bullet.loadURDF(str(urdf), flags=bullet.URDF_USE_INERTIA_FROM_FILE)
    mass, friction, inertia, position, orientation, *_ = bullet.getDynamicsInfo(loaded, -1)
    assert mass == pytest.approx(body.mass, rel=1e-6)
    assert friction == 0.5
    np.testing.assert_allclose(position, body.centre, atol=1e-8)
    own = tensor(bullet.getMatrixFromQuaternion(orientation), inertia)
    np.testing.assert_allclose(own, body.inertia, atol=1e-4 * body.inertia.max())
    assert len(bullet.getCollisionShapeData(loaded, -1)) == len(body.hulls)


def test_object_rests_in_pybullet(bullet, urdf, brick):
    bullet.setGravity(0, 0, -9.81)
    bullet.createMultiBody(0, bullet.createCollisionShape(bullet.GEOM_PLANE))
    loaded = bullet.loadURDF(str(urdf), [0, 0, 0.02], flags=bullet.URDF_USE_INERTIA_FROM_FILE)
    for _ in range(240):
        bullet.stepSimulation()
    (_, _, height), turn = bullet.getBasePositionAndOrientation(loaded)
    assert height == pytest.approx(0.015, abs=0.001)
    assert abs(turn[3]) > 0.9999


def test_the_material_of_an_obj_has_no_reflections(mjcf):
    lines = mjcf.with_name("visual.mtl").read_text().splitlines()
    expected = [" ".join([name, *[f"{value:.8f}"] * 3]) for name, value in (("Ka", 1), ("Kd", 1), ("Ks", 0))]
    assert [line for line in lines if line[0] == "K"] == expected


def test_texture_has_the_base_colours(brick, mjcf):
    """As OpenGL reads them: the first row of MuJoCo's texture is at 0."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    mesh = model.mesh("brick_visual").id
    geom = model.geom("brick_visual").id
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][model.mesh_face[faces]].mean(1)
    places = model.mesh_texcoord[model.mesh_texcoordadr[mesh] :][model.mesh_facetexcoord[faces]].mean(1)
    width, height = model.tex_width[0], model.tex_height[0]
    image = model.tex_data[: 3 * width * height].reshape(height, width, 3)
    column, row = (places * [width, height]).astype(int).T
    points = (vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]) / brick.scale
    colors = brick.base_colors(points).astype(int)
    spread = np.ptp(colors, axis=0).max()
    assert spread > 4
    assert np.abs(image[row, column] - colors).max() < spread / 2


def test_object_without_a_look_is_grey(brick, body, tmp_path):
    plain = without(brick, "vision")
    path = write_mjcf(plain, tmp_path, hulls=body.hulls)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ntex == 0
    np.testing.assert_allclose(model.material("brick_look").rgba, [0.7, 0.7, 0.7, 1])
    robot = write_urdf(plain, tmp_path / "urdf", hulls=body.hulls)
    assert [color.get("rgba") for color in ElementTree.parse(robot).iter("color")] == ["0.7 0.7 0.7 1"]


def test_a_model_that_mujoco_refuses_is_named(brick, body, tmp_path):
    world = ObjectFile(brick.header | {"key": "world"}, brick.tensors)
    refused("'world', which MuJoCo refuses", write_mjcf, world, tmp_path, hulls=body.hulls)
    assert not [*tmp_path.iterdir()]


@WRITERS
def test_the_same_object_gives_the_same_bytes(brick, body, tmp_path, write):
    first, again = (write(brick, tmp_path / name, hulls=body.hulls).parent for name in ("first", "again"))
    assert content(first) == content(again)


def told_by(path):
    """Mass and moments of inertia, ascending, that an exported file tells."""
    if path.suffix in (".xml", ".urdf"):
        found = mujoco.MjModel.from_xml_path(str(path)).body("brick")
        return found.mass[0], sorted(found.inertia)
    if path.suffix == ".glb":
        data = path.read_bytes()
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])  # the first chunk
        motion = document["nodes"][0]["extensions"]["KHR_physics_rigid_bodies"]["motion"]
        return motion["mass"], sorted(motion["inertiaDiagonal"])
    text = path.read_text()
    mass, moments = (re.search(rf"{name} = (.*)", text)[1] for name in ("physics:mass", "diagonalInertia"))
    return float(mass), sorted(map(float, moments.strip("()").split(",")))


@WRITERS
def test_exports_have_the_mass_of_the_real_object_and_its_inertia(brick, body, tmp_path, write):
    real = ObjectFile(brick.header | {"mass": 0.05}, brick.tensors)
    mass, moments = told_by(write(brick, tmp_path / "solid", hulls=body.hulls))
    given, less = told_by(write(real, tmp_path / "real", hulls=body.hulls))
    assert (mass, given) == (pytest.approx(body.mass, rel=1e-5), pytest.approx(0.05, rel=1e-6))
    np.testing.assert_allclose(less, np.multiply(moments, 0.05 / body.mass), rtol=1e-5)


@WRITERS
def test_existing_folder_is_refused(brick, tmp_path, write):
    (tmp_path / "brick").mkdir()
    refused(f"{tmp_path}/brick exists already", write, brick, tmp_path)


@WRITERS
def test_what_is_broken_off_leaves_nothing(brick, body, tmp_path, write, monkeypatch):
    def fail(file):
        raise KeyboardInterrupt

    monkeypatch.setattr("objectfolder.sim.export.visual_mesh", fail)
    with pytest.raises(KeyboardInterrupt):
        write(brick, tmp_path, hulls=body.hulls)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["mjcf", "urdf"])
def test_command_writes_what_mujoco_loads(brick_path, tmp_path, kind):
    arguments = ["export", kind, str(brick_path), str(tmp_path / "out"), "--hulls", "1"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    [printed] = result.stdout.split()
    assert mujoco.MjModel.from_xml_path(printed).body("brick").mass[0] == pytest.approx(0.1926, rel=0.01)
    again = CliRunner().invoke(app, arguments)
    assert "out/brick exists already" in str(again.exception)


def test_command_refuses_two_objects_of_a_name(brick_path, tmp_path):
    result = CliRunner().invoke(app, ["export", "mjcf", *[str(brick_path)] * 2, str(tmp_path / "out")])
    assert "a second object brick" in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("change", [{"geometry": None}, {"material": "moss", "material_properties": None}])
def test_command_checks_all_objects_before_it_writes_one(brick, brick_path, tmp_path, change):
    header = brick.header | {"key": "second"} | change
    parts = {name: value for name, value in header.items() if value is not None}
    ObjectFile(parts, brick.tensors).save(tmp_path / "second.safetensors")
    files = [str(brick_path), str(tmp_path / "second.safetensors")]
    arguments = ["export", "mjcf", *files, str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, ObjectFolderError)
    assert "second" in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("library", ["mujoco", "coacd", "manifold3d", "pxr"])
def test_library_that_is_not_there_is_named(brick_path, tmp_path, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    kind, extra = ("usd", "usd") if library == "pxr" else ("urdf", "rl")
    result = CliRunner().invoke(app, ["export", kind, str(brick_path), str(tmp_path / "out")])
    assert isinstance(result.exception, ObjectFolderError)
    assert f"{library} is not installed; this needs: {install_command(extra)}" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_two_objects_fit_into_one_scene(brick, body, tmp_path):
    other = ObjectFile({**brick.header, "key": "other"}, brick.tensors)
    paths = [write_mjcf(file, tmp_path, hulls=body.hulls) for file in (brick, other)]
    included = "".join(f'<include file="{path.parent.name}/{path.name}"/>' for path in paths)
    (tmp_path / "scene.xml").write_text(f"<mujoco>{included}</mujoco>")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.nbody == 3
    assert {model.material(k).name for k in range(model.nmat)} == {"brick_look", "other_look"}
