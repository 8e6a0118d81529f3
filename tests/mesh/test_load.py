import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image
from solids import box

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.load import default_up, load_mesh
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.textured import TexturedMesh

PLY = """ply
format ascii 1.0
element vertex {vertices}
property float x
property float y
property float z
{color}element face {faces}
property list uchar int vertex_indices
end_header
{body}
"""
TETRAHEDRON = ["0 0 0", "1 0 0", "0 2 0", "0 0 3"]
FACES = ["3 0 2 1", "3 0 1 3", "3 0 3 2", "3 1 2 3"]


def write_ply(path, vertices, faces, color=""):
    body = "\n".join([*vertices, *faces])
    path.write_text(PLY.format(vertices=len(vertices), faces=len(faces), color=color, body=body))
    return path


def pixels(height, width):
    rng = np.random.default_rng(5)
    return rng.integers(0, 256, (height, width, 3), dtype=np.uint8)


def write_obj(folder, image=None, kd="1 1 1"):
    (folder / "m.obj").write_text(
        "mtllib m.mtl\nusemtl skin\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\n"
        "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 3/3 2/2\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n"
    )
    texture = ""
    if image is not None:
        Image.fromarray(image).save(folder / "skin.png")
        texture = "map_Kd skin.png\n"
    (folder / "m.mtl").write_text(f"newmtl skin\nKd {kd}\n{texture}")
    return folder / "m.obj"


def test_obj_with_its_texture(tmp_path):
    image = pixels(8, 6)
    mesh = load_mesh(write_obj(tmp_path, image))
    np.testing.assert_array_equal(mesh.texture, image)
    assert len(mesh.faces) == 4
    assert mesh.uv.shape == (len(mesh.vertices), 2)
    # Seams split vertices: each corner still has its place and its texture coordinate.
    first = mesh.faces[0]
    np.testing.assert_array_equal(mesh.vertices[first], [[0, 0, 0], [0, 2, 0], [1, 0, 0]])
    np.testing.assert_allclose(mesh.uv[first], [[0, 0], [0, 1], [1, 0]])
    assert mesh.metallic is None


def test_obj_with_a_colour_only(tmp_path):
    mesh = load_mesh(write_obj(tmp_path, kd="1 0.5 0"))
    np.testing.assert_allclose(mesh.texture, [[[255, 128, 0]]], atol=1)


def test_plain_colour_keeps_roughness_and_metallic_in_glb(tmp_path):
    vertices, faces = box((1, 0.5, 0.25))
    texel = np.array([[[200, 40, 40]]], np.uint8)
    mesh = TexturedMesh(vertices, faces, np.zeros((8, 2)), texel, roughness=0.125, metallic=1.0)
    mesh.write_glb(tmp_path / "m.glb")
    back = load_mesh(tmp_path / "m.glb", "y")
    assert (back.roughness, back.metallic) == (0.125, 1.0)
    np.testing.assert_array_equal(back.texture, texel)


def test_polygons_become_triangles(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    assert load_mesh(path).faces.shape == (2, 3)


def test_ply_with_vertex_colours(tmp_path):
    color = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    colors = [[10, 20, 30], [40, 50, 60], [70, 80, 90], [255, 0, 1]]
    vertices = [f"{v} {' '.join(map(str, c))}" for v, c in zip(TETRAHEDRON, colors)]
    mesh = load_mesh(write_ply(tmp_path / "t.ply", vertices, FACES, color))
    np.testing.assert_array_equal(mesh.vertex_colors, colors)
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert mesh.texture is None


def test_y_up_is_turned_about_x_and_stays_right_handed(tmp_path):
    path = write_ply(tmp_path / "t.ply", TETRAHEDRON, FACES)
    as_is, turned = load_mesh(path, "z"), load_mesh(path, "y")
    x, y, z = as_is.vertices.T
    np.testing.assert_array_equal(turned.vertices, np.stack([x, -z, y], 1))
    assert normalize(turned).surface.volume == pytest.approx(normalize(as_is).surface.volume)
    assert default_up("a.GLB") == default_up("a.gltf") == "y"
    assert default_up("a.obj") == default_up("a.ply") == "z"


def textured(image):
    vertices, faces = box((1, 0.5, 0.25))
    uv = np.float32(np.random.default_rng(1).random((8, 2)))
    return TexturedMesh(np.float32(vertices) * 1.0, faces, uv * 1.0, image, roughness=0.25, metallic=0.75)


def test_glb_is_y_up_and_comes_back_z_up(tmp_path):
    mesh = textured(pixels(4, 8))
    path = tmp_path / "m.glb"
    mesh.write_glb(path)
    back = load_mesh(path, default_up(path))
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    x, y, z = mesh.vertices.T
    np.testing.assert_array_equal(load_mesh(path, "z").vertices, np.stack([x, z, -y], 1))
    np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_array_equal(back.texture, mesh.texture)
    np.testing.assert_allclose(back.uv, mesh.uv, atol=1e-7)
    assert (back.roughness, back.metallic) == (0.25, 0.75)
    first = path.read_bytes()
    mesh.write_glb(path)
    assert path.read_bytes() == first


def test_glb_keeps_vertex_colours(tmp_path):
    vertices, faces = box((1, 1, 1))
    colors = np.random.default_rng(2).integers(0, 256, (8, 3), dtype=np.uint8)
    TexturedMesh(vertices, faces, vertex_colors=colors).write_glb(tmp_path / "m.glb")
    np.testing.assert_array_equal(load_mesh(tmp_path / "m.glb").vertex_colors, colors)


def test_parts_of_a_scene_are_placed_and_joined(tmp_path):
    scene = trimesh.Scene()
    part = trimesh.creation.box((1, 1, 1))
    scene.add_geometry(part, transform=trimesh.transformations.translation_matrix([2, 0, 0]))
    scene.add_geometry(part.copy(), transform=trimesh.transformations.translation_matrix([0, 3, 0]))
    (tmp_path / "s.glb").write_bytes(scene.export(file_type="glb"))
    mesh = load_mesh(tmp_path / "s.glb")
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -0.5, -0.5], [2.5, 3.5, 0.5]])


def test_a_large_texture_is_scaled_down_and_a_small_one_is_not(tmp_path):
    flat = np.full((64, 32, 3), [200, 100, 50], np.uint8)
    path = write_obj(tmp_path, flat)
    small = load_mesh(path, texture_size=16).texture
    assert small.shape == (16, 8, 3)
    assert (small == [200, 100, 50]).all()
    assert load_mesh(path, texture_size=1024).texture.shape == (64, 32, 3)


def test_vertices_that_no_face_uses_may_be_anything(tmp_path):
    path = write_ply(tmp_path / "t.ply", [*TETRAHEDRON, "nan nan nan", "inf 0 0"], FACES)
    done = normalize(load_mesh(path))
    assert done.surface.volume == pytest.approx(1 / 27)
    assert np.isfinite(done.visual.vertices).all()


def glb_of_nothing():
    chunk = json.dumps({"asset": {"version": "2.0"}}).encode()
    chunk += b" " * (-len(chunk) % 4)
    return (
        struct.pack("<4sII", b"glTF", 2, 20 + len(chunk)) + struct.pack("<I4s", len(chunk), b"JSON") + chunk
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("m.stl", b"solid", r"format '\.stl' is not one of \.obj"),
        ("m", b"solid", "format '' is not one of"),
        ("m.ply", b"", "cannot be read|no faces"),
        ("m.ply", b"\x00\xff\x00" * 99, "cannot be read|no faces"),
        ("m.glb", b"\x00\xff\x00" * 99, "cannot be read|no faces"),
        ("m.glb", glb_of_nothing(), "cannot be read|no faces"),
        ("m.gltf", b"{", "cannot be read|no faces"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\n", "cannot be read|no faces"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "1 of its vertices are NaN"),
        ("m.obj", b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n", "in one point"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read|no faces"),
    ],
)
def test_what_is_not_a_mesh_is_refused_by_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ObjectFolderError, match=message) as caught:
        load_mesh(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_a_missing_file_and_a_wrong_axis(tmp_path):
    with pytest.raises(ObjectFolderError, match=r"nowhere\.obj does not exist"):
        load_mesh(tmp_path / "nowhere.obj")
    with pytest.raises(ObjectFolderError, match="up axis 'x' is neither"):
        load_mesh(write_ply(tmp_path / "t.ply", TETRAHEDRON, FACES), up="x")
