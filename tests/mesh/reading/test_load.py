import io
import json
import struct
import zlib

import numpy as np
import pytest
import trimesh
from gltf_scene import Scene, colors_at, loaded_or_refused, square
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from refusals import refused
from solids import box

from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import AS_STORED, FORMATS, default_up, load_mesh, references
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


def test_plain_colour_keeps_roughness_and_metallic_in_glb(tmp_path):
    vertices, faces = box((1, 0.5, 0.25))
    texel = np.array([[[200, 40, 40]]], np.uint8)
    mesh = TexturedMesh(vertices, faces, np.zeros((8, 2)), texel, roughness=0.125, metallic=1.0)
    mesh.write_glb(tmp_path / "m.glb")
    back = load_mesh(tmp_path / "m.glb", "y")
    assert (back.roughness, back.metallic) == (0.125, 1.0)
    np.testing.assert_array_equal(back.texture, texel)


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


def test_a_large_texture_is_scaled_down_and_a_small_one_is_not(tmp_path):
    flat = np.full((64, 32, 3), [200, 100, 50], np.uint8)
    path = write_obj(tmp_path, flat)
    small = load_mesh(path, texture_size=16).texture
    assert small.shape == (16, 8, 3)
    assert (small == [200, 100, 50]).all()
    assert load_mesh(path, texture_size=1024).texture.shape == (64, 32, 3)


def test_a_texture_above_the_default_size_is_read_as_it_was_stored(tmp_path):
    large = np.full((2048, 2, 3), [200, 100, 50], np.uint8)
    mesh = load_mesh(write_obj(tmp_path, large), texture_size=2048)
    mesh.write_glb(tmp_path / "visual.glb")
    assert load_mesh(tmp_path / "visual.glb", "y", AS_STORED).texture.shape == (2048, 2, 3)


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
        ("m.dae", b"solid", r"format '\.dae' is not one of \.obj.*; convert the mesh"),
        ("m.stl", b"solid", "cannot be read|no faces"),
        ("m.off", b"OFF\n3 1 0\n", "cannot be read|no faces"),
        ("m.obj", b"", "cannot be read as a mesh: it is empty; export it again"),
        ("m.obj", b"Dear Sir or Madam,\nhere is my mesh.\n", "holds no faces"),
        ("m.obj", b"ply\nformat ascii 1.0\n", "looks like a .ply"),
        (
            "m.glb",
            b"version https://git-lfs.github.com/spec/v1\n",
            "header; export it again .*Git LFS pointer",
        ),
        ("m.gltf", b"<!DOCTYPE html>", "not JSON .*looks like XML or HTML"),
        (
            "m.stl",
            bytes(80) + b"\x02\0\0\0" + bytes(99),
            "has 183 bytes, expected 184 for 2 triangles; it may be cut off: copy",
        ),
        ("m.ply", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        ("m.stl", b"PK\x03\x04" + bytes(99), "looks like a .zip archive"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "'f 0 1 2' has the index 0"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/0 3/1\n", "has the index 0"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -4\nv 0 0 1\n", "counts back to v -4, but 3 precede"),
        (
            "m.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n",
            "'f 1 2 x' is not a face, expected corners such as",
        ),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1/1/1 2 3\n", "'f 1/1/1/1 2 3' is not a face"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 /2 3\n", "'f 1 /2 3' is not a face"),
        ("m.obj", b"v 0 0 0\nvt 1 u\nf 1 1 1\n", "'vt 1 u' has words that are no numbers, or too few"),
        ("m.obj", b"v 0 0 0\nv 1 0-2 0\nf 1 1 1\n", "'v 1 0-2 0' has words that are no numbers, or too few"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1-1 2 3\n", "'f 1-1 2 3' is not a face"),
        (
            "m.off",
            b"OFF\n3 1 0\n0 0 0\n1 0-1 0\n0 1 0\n3 0 1 2\n",
            "its vertices have words that are no numbers",
        ),
        ("m.stl", b"solid\nfacet\nvertex 0 0 0\nvertex 1-2 0 0\nvertex 0 1 0\n", "words that are no numbers"),
        ("m.obj", b"v 0 0 0\n v 1 0\nf 1 1 1\n", "'v 1 0' has words that are no numbers, or too few"),
        ("m.obj", b"v 0 0 0\nv 1e200 0 0\nv 0 1 0\nf 1 2 3\n", r"1e\+200, expected at most 1e\+30; repair"),
        ("m.obj", b"v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "1 of its vertices are NaN or infinite"),
        ("m", b"solid", "format '' is not one of"),
        ("m.ply", b"", "cannot be read|no faces"),
        (
            "m.ply",
            b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
            b"property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n",
            "no faces",
        ),
        ("m.ply", b"\x00\xff\x00" * 99, "cannot be read|no faces"),
        ("m.glb", b"\x00\xff\x00" * 99, "cannot be read|no faces"),
        ("m.glb", glb_of_nothing(), "cannot be read|no faces"),
        ("m.gltf", b"{", "cannot be read|no faces"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\n", "cannot be read|no faces"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "1 of its vertices are NaN"),
        ("m.obj", b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n", "coincide; expected a solid object: export"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "'f 1 2 9' uses a vertex beyond the 3 of"),
        (
            "m.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 4\nf 1/2 2/3 5/4 3/1 # 9\n",
            "'f 1/2 2/3 5/4 3/1 # 9' uses a vertex beyond the 4",
        ),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + b"9" * 99, "uses a vertex beyond the 3"),
    ],
)
def test_what_is_not_a_mesh_is_refused_by_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    caught = refused(message, load_mesh, tmp_path / name)
    assert str(tmp_path / name) in caught


def test_a_missing_file_and_a_wrong_axis(tmp_path):
    refused(r"nowhere\.obj does not exist", load_mesh, tmp_path / "nowhere.obj")
    refused("up axis 'x' is neither", load_mesh, write_ply(tmp_path / "t.ply", TETRAHEDRON, FACES), up="x")


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        (".off", "OFF\n4 4 0\n{vertices}\n{faces}\n"),
        (".stl", "solid t\n{facets}endsolid t\n"),
    ],
)
def test_stl_and_off(tmp_path, suffix, content):
    corners = np.array([[float(x) for x in v.split()] for v in TETRAHEDRON])
    faces = np.array([[int(x) for x in f.split()[1:]] for f in FACES])
    loops = ["".join("vertex {} {} {}\n".format(*c) for c in corners[f]) for f in faces]
    facets = "".join(f"facet normal 0 0 0\nouter loop\n{loop}endloop\nendfacet\n" for loop in loops)
    path = tmp_path / ("m" + suffix)
    path.write_text(content.format(vertices="\n".join(TETRAHEDRON), faces="\n".join(FACES), facets=facets))
    mesh = load_mesh(path)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], corners[faces])
    assert mesh.texture is None
    assert mesh.vertex_colors is None
    assert default_up(path) == "z"


def test_face_colours_of_a_ply_stay_sharp(tmp_path):
    colors = [[10, 20, 30], [40, 50, 60], [10, 20, 30], [255, 0, 1]]
    faces = [f"{f} {' '.join(map(str, c))}" for f, c in zip(FACES, colors)]
    path = write_ply(tmp_path / "t.ply", TETRAHEDRON, faces)
    extra = "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header"
    path.write_text(path.read_text().replace("end_header", extra))
    mesh = load_mesh(path)
    np.testing.assert_array_equal(mesh.vertex_colors[mesh.faces], np.repeat(np.array(colors)[:, None], 3, 1))
    plain = load_mesh(write_ply(tmp_path / "plain.ply", TETRAHEDRON, FACES))
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], plain.vertices[plain.faces])


def write_two_materials(folder, first="map_Kd -s 1 1 1 my skin.png", libraries="mtllib a.mtl my b.mtl"):
    (folder / "m.obj").write_text(
        f"{libraries}\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nvt 0.1 0.1\nvt 0.2 0.1\nvt 0.1 0.2\n"
        "usemtl one\nf 1/1 3/3 2/2\nusemtl two\nf 1/1 2/2 4/3\nusemtl one\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n"
    )
    (folder / "a.mtl").write_text(f"newmtl one\nKd 0 0 0\n{first}\n")
    (folder / "my b.mtl").write_text("newmtl two\nKd 0.2 0.4 1.0\n")
    Image.fromarray(np.full((16, 16, 3), [200, 100, 50], np.uint8)).save(folder / "my skin.png")
    return folder / "m.obj"


@pytest.mark.parametrize("libraries", ["mtllib a.mtl my b.mtl", "mtllib my b.mtl\nmtllib a.mtl"])
def test_obj_with_several_libraries_and_materials(tmp_path, libraries):
    mesh = load_mesh(write_two_materials(tmp_path, libraries=libraries))
    mesh.write_glb(tmp_path / "m.glb")
    for m in (mesh, load_mesh(tmp_path / "m.glb", "y")):
        colors = {
            tuple(np.sort(m.vertices[f].sum(1))): tuple(np.rint(c)) for f, c in zip(m.faces, colors_at(m))
        }
        # Faces by the sums of their corners' coordinates; the texture replaces Kd.
        assert colors == {
            (0, 1, 2): (200, 100, 50),
            (0, 1, 3): (51, 102, 255),
            (0, 2, 3): (200, 100, 50),
            (1, 2, 3): (200, 100, 50),
        }


@pytest.mark.parametrize("marked", ["m.obj", "m.mtl", "m.off"])
def test_a_mark_of_byte_order_is_no_part_of_the_first_line(tmp_path, marked):
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    (tmp_path / "m.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    (tmp_path / marked).write_bytes(b"\xef\xbb\xbf" + (tmp_path / marked).read_bytes())
    assert len(load_mesh(tmp_path / "m.off").faces) == 1
    assert load_mesh(tmp_path / "m.obj").texture.tolist() == [[[255, 0, 0]]]
    assert [str(path) for path in references(tmp_path / "m.obj")] == ["m.mtl"]


def png_header(width, height):
    """A PNG that says how large it is, and breaks off."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + struct.pack(">I", 13)
        + body
        + struct.pack(">I", zlib.crc32(body))
        + bytes([0, 0, 0, 9])
        + b"IDAT"
    )


def encoded(kind):
    stream = io.BytesIO()
    Image.fromarray(pixels(4, 4)).save(stream, kind)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "which does not exist; put it there"),
        (b"", "cannot be read as an image"),
        (b"not an image", "cannot be read as an image"),
        (png_header(8, 8), "cannot be read as an image"),
        (png_header(8192, 8192), "cannot be read as an image"),  # of a size that is allowed
        (png_header(8192, 8193), "has 8192 x 8193 pixels, expected at most 8192 x 8192; resize it"),
        (png_header(16384, 16384), "pixels, expected at most 8192 x 8192; resize it"),
        (png_header(10**9, 10**9), "pixels, expected at most 8192 x 8192; resize it"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 1 1\n", "cannot be read as an image .unknown format"),
        (encoded("GIF"), "cannot be read as an image .unknown format.; expected PNG, JPEG, WEBP"),
    ],
)
@pytest.mark.parametrize("kind", ["obj", "ply", "gltf"])
def test_a_bad_texture_is_named_with_the_mesh(tmp_path, kind, content, message):
    path = tmp_path / f"m.{kind}"
    if kind == "obj":
        write_obj(tmp_path, pixels(4, 4))
    elif kind == "ply":
        coordinates = "property float s\nproperty float t\n"
        write_ply(path, [f"{v} 0 0" for v in TETRAHEDRON], FACES, coordinates)
        path.write_text(
            path.read_text().replace("element vertex", "comment TextureFile skin.png\nelement vertex")
        )
    else:
        scene = Scene()
        scene.quads(0, scene.material(scene.texture(pixels(4, 4))), [square(0.5, 0.5, 0.5)])
        scene.document["images"] = [{"uri": "skin.png"}]
        scene.write(path)
    (tmp_path / "skin.png").unlink(missing_ok=True)
    if content is not None:
        (tmp_path / "skin.png").write_bytes(content)
    caught = refused(message, load_mesh, path)
    assert str(path) in caught
    assert "skin.png" in caught


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_mesh_that_breaks_off_is_read_or_refused(tmp_path, suffix):
    """Text that ends at a line is whole for its parser; nothing but our own errors may come out."""
    box_mesh = trimesh.creation.box((1, 2, 3))
    if suffix in (".glb", ".gltf"):
        scene = Scene()
        scene.quads(0, scene.material(scene.texture(pixels(4, 4))), [square(0.5, 0.5, 0.5)])
        whole = scene.write(tmp_path / "whole.gltf").read_bytes()
        if suffix == ".glb":
            load_mesh(tmp_path / "whole.gltf").write_glb(tmp_path / "whole.glb")
            whole = (tmp_path / "whole.glb").read_bytes()
    else:
        exported = box_mesh.export(file_type=suffix[1:])
        whole = exported.encode() if isinstance(exported, str) else exported
    path = tmp_path / ("cut" + suffix)
    for length in np.linspace(0, len(whole) - 1, 40).astype(int):
        path.write_bytes(whole[:length])
        loaded_or_refused(path)
    path.write_bytes(whole)
    assert len(load_mesh(path).faces) in (2, 12)


BEGINNINGS = [
    b"",
    b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    b"mtllib x\nusemtl y\nvt 0 0\nv 0 0 0 1 1 1\nf ",
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n",
    b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n",
    b"solid x\nfacet normal 0 0 1\nouter loop\n",
    b"glTF\x02\0\0\0",
    b'{"asset": {"version": "2.0"}, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], ',
]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from(FORMATS),
    beginning=st.sampled_from(BEGINNINGS),
    rest=st.one_of(st.binary(max_size=300), st.text("vft/#-. 0123456789e\n", max_size=200).map(str.encode)),
)
def test_no_bytes_raise_anything_but_our_own_error(tmp_path, suffix, beginning, rest):
    path = tmp_path / ("m" + suffix)
    path.write_bytes(beginning + rest)
    loaded_or_refused(path)
