"""Assets of meshes without a build, beside closed forms and what a build stores."""

import json
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from refusals import refused

import objectfolder
from objectfolder.base.materials import Material, material
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.ply import read_surface, write_surface
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sdf import fit_grid
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.sim import asset as module
from objectfolder.sim import visual
from objectfolder.sim.asset import default_key
from objectfolder.sim.drawing import draw_look
from objectfolder.sim.gltf import unpack_glb
from objectfolder.sim.visual import source_look
from objectfolder.sim.weight import judge_weight
from objectfolder.sound.fem.settings import VoxelizeConfig

SIDES = np.array([0.2, 0.1, 0.06])


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """A coarser grid than that of presets, for speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "VoxelizeConfig", lambda: VoxelizeConfig(sdf_resolution=64))
        patch.setattr(visual, "TEXELS", 64)
        yield


def textured_box(path, repeats=1.0):
    """A box with a texture that is red on the left half and green on the right."""
    mesh = trimesh.creation.box(SIDES)
    mesh.unmerge_vertices()
    uv = repeats * (mesh.vertices[:, [0, 2]] / SIDES[[0, 2]] + 0.5)
    texels = np.zeros((8, 8, 3), np.uint8)
    texels[:, :4, 0] = texels[:, 4:, 1] = 200
    image = Image.fromarray(texels)
    mesh.visual = trimesh.visual.TextureVisuals(uv, trimesh.visual.material.SimpleMaterial(image=image))
    mesh.export(path)
    return path


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return textured_box(tmp_path_factory.mktemp("mesh") / "crate.obj")


@pytest.fixture(scope="module")
def crate(mesh):
    return objectfolder.asset(mesh, "wood")


@pytest.fixture(scope="module")
def folder(crate, tmp_path_factory):
    return crate.write(tmp_path_factory.mktemp("assets"))


def moments(mass, sides):
    return mass / 12 * (np.square(sides).sum() - np.square(sides))


def test_a_box_has_its_mass_and_inertia(crate):
    mass = 750 * SIDES.prod()
    assert crate.body.mass == pytest.approx(mass, rel=1e-6)
    np.testing.assert_allclose(np.diag(crate.body.inertia), moments(mass, SIDES), rtol=1e-6)
    assert crate.body.friction == material("wood").friction
    assert len(crate.body.hulls) == 1
    assert str(crate.weight) == "0.9 kg: solid, 1200 cm3 at 750 kg/m3; between 0.42 and 1.14 kg"


def test_mujoco_loads_what_is_written(crate, folder):
    model = mujoco.MjModel.from_xml_path(str(folder / "crate.xml"))
    assert model.body_mass[1] == pytest.approx(crate.body.mass, rel=1e-5)
    np.testing.assert_allclose(model.body_ipos[1], crate.body.centre, atol=1e-8)
    assert model.ntex == 1
    names = {path.name for path in folder.iterdir()}
    assert {"crate.urdf", "crate.glb", "asset.json", "thumbnail.png", "visual.png", "hull00.obj"} <= names


def test_every_file_says_where_the_mass_is_from(crate, folder):
    said = str(crate.weight)
    model = mujoco.MjModel.from_xml_path(str(folder / "crate.xml"))
    assert said in bytes(model.text_data).decode()
    assert said in (folder / "crate.urdf").read_text()
    assert said.encode() in (folder / "crate.glb").read_bytes()
    report = json.loads((folder / "asset.json").read_text())
    assert report["weight"]["source"] == "solid"
    assert report["mass"] == pytest.approx(crate.body.mass)
    assert ElementTree.parse(folder / "crate.urdf").getroot().get("name") == "crate"


def test_the_source_keeps_its_triangles_and_texture(crate, mesh):
    assert len(crate.look.faces) == 12
    np.testing.assert_allclose(crate.look.extents, SIDES, rtol=1e-6)
    image = draw_look(crate.look, 64)
    red, green = (image[..., k] > 1.5 * image[..., 1 - k] + 10 for k in (0, 1))
    assert red.sum() > 200
    assert green.sum() > 200
    assert np.nonzero(red)[1].mean() < np.nonzero(green)[1].mean()
    assert (image[0, 0] == 255).all()


def test_a_repeating_texture_repeats_and_vertex_colours_are_painted(crate, tmp_path):
    made = objectfolder.asset(textured_box(tmp_path / "twice.obj", 2.0), "wood")
    document, _ = unpack_glb((made.write(tmp_path, ["glb"]) / "twice.glb").read_bytes())
    assert document["samplers"][0]["wrapS"] == 10497
    ends = np.where(crate.look.vertices[:, :1] < 0, [200, 0, 0], [0, 200, 0]).astype(np.uint8)
    unit = crate.look.vertices / crate.file.scale
    look = source_look(TexturedMesh(unit, crate.look.faces, vertex_colors=ends), crate.file)
    colours = np.asarray(look.visual.material.image).reshape(-1, 3)
    assert (colours[:, 0] > 150).sum() > 100
    assert (colours[:, 1] > 150).sum() > 100
    plain = source_look(TexturedMesh(unit, crate.look.faces), crate.file)
    assert visual.texture_image(plain) is None


def test_it_is_what_a_build_stores(tmp_path):
    """The grid, of which hulls are computed, byte for byte; volume, centre and inertia of the same solid."""
    path = tmp_path / "ring.ply"
    trimesh.creation.torus(0.3, 0.1, 40, 20).export(path)
    made = objectfolder.asset(path, "steel", 0.1)
    done = normalize(load_mesh(path), "ring", scale=0.1)
    write_surface(tmp_path / "surface.ply", done.surface.mesh)
    grid = fit_grid(*read_surface(tmp_path / "surface.ply"), 64, "ring")
    np.testing.assert_array_equal(made.file.surface.grid.values, grid.values)
    assert made.file.header["solid"] == done.report(0.1, "z")["solid"]


def test_a_shell_and_a_mass(mesh):
    wall = 0.002
    hollow = objectfolder.asset(mesh, "plastic", shell=wall)
    kg = 1070 * (SIDES.prod() - (SIDES - 2 * wall).prod())
    assert hollow.weight.kg == pytest.approx(kg, rel=0.01)
    assert hollow.weight.source == "shell"
    assert "hollow with a wall of 2 mm" in str(hollow.weight)
    assert not hollow.warnings
    both = objectfolder.asset(mesh, "plastic", shell=wall, mass=0.1)
    hulls = [both.file.to_mesh().convex_hull]
    body, thin = (module.rigid_body(one.file, hulls) for one in (both, hollow))
    assert body.mass == 0.1
    np.testing.assert_allclose(body.inertia, thin.inertia * 0.1 / thin.mass, rtol=1e-9)
    assert both.weight.source == "given"


def test_too_heavy_for_what_it_looks_like():
    """A closed bottle of plastic, 1.5 litres; a fork; a wooden block; a material of one's own."""
    bottle = judge_weight(material("plastic"), 1.5e-3, 0.08, 0.08, None, None)
    assert (
        "it is 80 mm thick, and plastic is seldom solid beyond 15 mm: solid it weighs 1.6" in bottle.warning
    )
    assert "give --mass KG if you know it, or --shell 2" in bottle.warning
    assert bottle.low == pytest.approx(900 * 0.08 * 0.0005)
    assert not judge_weight(material("plastic"), 1.5e-3, 0.08, 0.08, 0.002, None).warning
    assert not judge_weight(material("plastic"), 1.5e-3, 0.08, 0.08, None, 0.05).warning
    assert not judge_weight(material("steel"), 5e-6, 0.01, 0.004, None, None).warning
    assert not judge_weight(material("wood"), 7e-4, 0.06, 0.085, None, None).warning
    assert not judge_weight(Material("moss", 300.0, 1e6, 0.2, alpha=1.0), 1, 1, 1, None, None).warning


def test_names(tmp_path):
    assert default_key(tmp_path / "025_mug" / "textured.obj") == "mug"
    assert default_key(tmp_path / "Blue Mug.obj") == "blue_mug"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": 900.0}, r"crate: mass is 900 kg, .* give kilograms: 0.9 for 900 g"),
        ({"mass": -1.0}, "crate: mass is -1, expected kilograms above 0"),
        ({"shell": 2.0}, "crate: shell is 2000 mm, .*: --shell is in millimetres"),
        ({"shell": 0.04}, "crate: a wall of 20.00% of the size fills the solid"),
        ({"scale": 200.0}, "scale of crate is 200 m, .* give it in metres: .* 0.2 for 200 mm"),
        ({"wall": 0.5}, "wall of crate is 0.5 m"),
        ({"up": "x"}, "up axis 'x'"),
        ({"unit": "inch"}, "unit 'inch' is not one of m, cm, mm"),
    ],
)
def test_refusals_name_the_object_the_value_and_what_helps(mesh, options, message):
    refused(message, objectfolder.asset, mesh, "wood", **options)


def test_what_is_there_stays(crate, folder):
    refused("crate exists already: choose another name, or delete it", crate.write, folder.parent)
    refused("format 'stl' is not one of mjcf, urdf, usd, glb", crate.write, folder, ["stl"])
