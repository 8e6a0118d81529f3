"""glTF that readers draw, and that gives back the modes, the mass and the sound of an Object File."""

import igl
import numpy as np
import pytest
import torch
import trimesh
from brick import without
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from objectfolder.cli import app
from objectfolder.mesh.srgb import encode
from objectfolder.mesh.textured import y_up, z_up
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import gltf, visual
from objectfolder.sim.gltf import AUDIO, PHYSICS, unpack_glb, write_glb
from objectfolder.sound.synthesis import sinusoid_bank

pytestmark = pytest.mark.usefixtures("small_textures")


@pytest.fixture(scope="module")
def path(brick, body, tmp_path_factory):
    return write_glb(brick, tmp_path_factory.mktemp("glb"), hulls=body.hulls)


@pytest.fixture(scope="module")
def glb(path):
    return unpack_glb(path.read_bytes())


def accessor_values(document, buffer, accessor):
    found = document["accessors"][accessor]
    kind, width = {5126: "<f4", 5125: "<u4"}[found["componentType"]], {"SCALAR": 1, "VEC3": 3}[found["type"]]
    start = document["bufferViews"][found["bufferView"]]["byteOffset"]
    values = np.frombuffer(buffer, kind, found["count"] * width, start)
    return values if width == 1 else values.reshape(-1, width)


def look_of(document):
    drawn = document["meshes"][document["nodes"][0]["mesh"]]["primitives"][0]
    return document["materials"][drawn["material"]]["pbrMetallicRoughness"]


@pytest.fixture(scope="module")
def model(glb):
    document, buffer = glb
    found = document["extensions"][AUDIO]["modalModels"][0]
    names = ("frequencies", "decayRates", "positions", "shapes", "indices")
    return {name: accessor_values(document, buffer, found[name]) for name in names}


def test_a_reader_that_knows_no_extension_draws_the_surface(brick, path):
    scene = trimesh.load(path)
    (node,) = scene.graph.nodes_geometry
    drawn = scene.geometry[scene.graph[node][1]]
    places = z_up(drawn.vertices)
    np.testing.assert_allclose([places.min(0), places.max(0)], brick.bounds, atol=2e-4)
    assert drawn.visual.material.baseColorTexture.size == (64, 64)
    assert drawn.area == pytest.approx(brick.to_mesh().area, rel=0.01)


def test_the_motion_is_that_of_the_rigid_body(glb, body):
    document, _ = glb
    motion = document["nodes"][0]["extensions"][PHYSICS]["motion"]
    assert motion["mass"] == pytest.approx(body.mass)
    np.testing.assert_allclose(z_up(np.array([motion["centerOfMass"]]))[0], body.centre, atol=1e-12)
    axes = Rotation.from_quat(motion["inertiaOrientation"]).as_matrix()
    inertia = axes @ np.diag(motion["inertiaDiagonal"]) @ axes.T
    spin = np.array([[0.3, -0.2, 0.9]])
    kinetic = (y_up(spin) @ inertia @ y_up(spin).T).item()
    assert kinetic == pytest.approx((spin @ body.inertia @ spin.T).item())


def test_hulls_collide_and_nobody_draws_them(glb, body):
    document, _ = glb
    body_node = document["nodes"][0]
    assert document["scenes"] == [{"nodes": [0]}]
    assert len(body_node["children"]) == len(body.hulls)
    for child in body_node["children"]:
        collider = document["nodes"][child]["extensions"][PHYSICS]["collider"]
        shape = document["nodes"][collider["geometry"]["node"]]
        assert collider["geometry"]["convexHull"] is True
        assert document["meshes"][shape["mesh"]]["name"] == shape["name"]
        assert "mesh" not in document["nodes"][child]
    friction = document["extensions"][PHYSICS]["physicsMaterials"][0]
    assert friction["staticFriction"] == friction["dynamicFriction"] == body.friction


def test_modes_come_back(brick, model):
    points = z_up(model["positions"])
    order = [np.abs(brick.frequencies - hertz).argmin() for hertz in model["frequencies"]]
    assert sorted(order) == list(range(len(brick.frequencies)))
    np.testing.assert_allclose(model["frequencies"], brick.frequencies[order], rtol=1e-6)
    np.testing.assert_allclose(model["decayRates"], brick.tuning().damping.numpy()[order], rtol=1e-6)
    shapes = z_up(model["shapes"]).reshape(len(order), len(points), 3)
    expected = brick.mode_shapes(points)[..., order].transpose(2, 0, 1)
    np.testing.assert_allclose(shapes, expected, atol=2e-3 * np.abs(expected).max())


def test_the_sound_that_the_extension_defines_is_the_objects(brick, model):
    """Modes struck at a sample point, as in its section Synthesis, but displacements, not their pressure."""
    points, force = z_up(model["positions"]), np.array([0.3, -1.0, 2.0])
    shapes = z_up(model["shapes"]).reshape(len(model["frequencies"]), len(points), 3)
    damped = torch.from_numpy(2 * np.pi * model["frequencies"].astype(np.float64))
    bank = sinusoid_bank(damped, torch.from_numpy(model["decayRates"].astype(np.float64)), 16000, 0.1)
    for place in (0, len(points) // 2):
        sound = torch.from_numpy((shapes[:, place] @ force)[None]).float() @ bank
        expected = brick.impact(points[place], force, duration=0.1, contact_time=0.0)
        np.testing.assert_allclose(sound, expected, atol=5e-3 * np.abs(expected).max())


def test_shapes_between_the_samples_are_interpolated_well(brick, model):
    samples, faces = z_up(model["positions"]).astype(float), model["indices"].reshape(-1, 3)
    assert 100 < len(samples) <= gltf.SAMPLES
    mesh = trimesh.Trimesh(samples, faces, process=False)
    points = brick.sample_surface(300)
    squared, face, nearest = igl.point_mesh_squared_distance(points, samples, faces.astype(np.int64))[:3]
    assert squared.max() < (0.03 * brick.scale) ** 2
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[face], nearest)
    known = brick.mode_shapes(samples)[mesh.faces[face]]
    error = (weights[..., None, None] * known).sum(1) - brick.mode_shapes(points)
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(brick.mode_shapes(points))


def test_a_material_tells_its_damping_only_if_the_draft_knows_the_law(brick, body, tmp_path):
    documents = {}
    for law, more in (("rayleigh", {}), ("loss", {"loss_factor": [[1000.0, 0.02]]})):
        properties = brick.header["material_properties"] | more
        file = ObjectFile(brick.header | {"material_properties": properties}, brick.tensors)
        path = write_glb(file, tmp_path / law, hulls=body.hulls)
        documents[law] = unpack_glb(path.read_bytes())[0]["extensions"][AUDIO]["acousticMaterials"][0]
    assert documents["rayleigh"]["beta"] == brick.header["material_properties"]["beta"]
    assert documents["rayleigh"]["density"] == documents["loss"]["density"]
    assert not {"alpha", "beta"} & documents["loss"].keys()


def test_an_object_without_sound_has_none(brick, body, tmp_path):
    document, _ = unpack_glb(write_glb(without(brick, "audio"), tmp_path, hulls=body.hulls).read_bytes())
    assert document["extensionsUsed"] == [PHYSICS]
    assert AUDIO not in document["nodes"][0]["extensions"]


def test_an_object_without_base_colours_is_grey(brick, body, tmp_path):
    document, _ = unpack_glb(write_glb(without(brick, "vision"), tmp_path, hulls=body.hulls).read_bytes())
    found = look_of(document)
    assert "baseColorTexture" not in found
    assert encode(np.array(found["baseColorFactor"][:3])) == pytest.approx(visual.GREY, abs=0.5 / 255)
    assert found["baseColorFactor"][3] == 1


def test_a_texture_keeps_its_colours_and_is_read_without_mipmaps(glb):
    """They would mix the rectangles of faces."""
    document, _ = glb
    assert look_of(document).get("baseColorFactor", [1, 1, 1, 1]) == [1, 1, 1, 1]
    (texture,) = document["textures"]
    assert document["samplers"][texture["sampler"]]["minFilter"] == 9729  # LINEAR


def test_arrays_come_back_from_a_buffer_of_any_length():
    document, buffer = {"bufferViews": [], "accessors": []}, bytearray(b"abc")
    rows = np.arange(12, dtype=np.float32).reshape(4, 3)
    arrays = rows, np.arange(5, dtype=np.uint32)
    first, second = (gltf.add_accessor(document, buffer, values) for values in arrays)
    document, buffer = unpack_glb(gltf.pack_glb(document, buffer))
    np.testing.assert_array_equal(accessor_values(document, buffer, first), rows)
    np.testing.assert_array_equal(accessor_values(document, buffer, second), np.arange(5))
    assert document["accessors"][0]["max"] == [9, 10, 11]


def test_command(brick_path, tmp_path):
    done = CliRunner().invoke(app, ["export", "glb", str(brick_path), str(tmp_path), "--hulls", "2"])
    assert done.exit_code == 0
    assert (tmp_path / "brick" / "brick.glb").stat().st_size > 10_000


def test_samples_are_on_the_surface_and_apart(brick):
    points, faces = gltf.sample_modes(brick)
    assert brick.nearest(points)[1].max() < 1e-6
    assert np.unique(points, axis=0).shape == points.shape
    assert faces.max() < len(points)
