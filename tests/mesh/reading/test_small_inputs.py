"""Small mesh files that once took minutes, gigabytes or the wrong file."""

import gc
import json
import time
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from gltf_scene import Scene, loaded_or_refused, square
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading import gltf
from objectfolder.mesh.reading.load import load_mesh, references
from objectfolder.mesh.reading.mtl import textures
from objectfolder.mesh.reading.obj import MAX_MATERIALS, mtl_names

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\n"
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
TEXTURED = (
    "mtllib m.mtl\nusemtl skin\n" + TETRAHEDRON + "vt 0 0\nvt 1 0\nvt 0 1\n"
    "f 1/1 3/3 2/2\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n"
)
SOLID = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    "EndSolid a\n"
)
PLY = (
    "ply\nformat ascii 1.0\n{}\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "property float s\nproperty float t\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n0 0 1 1 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
)


def seconds(work, text):
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        work(text)
        best = min(best, time.process_time() - start)
    return best


def read_with_library(folder):
    """Reads a tetrahedron with the given material library."""

    def read(text):
        (folder / "m.mtl").write_text("newmtl skin\nKd 1 1 1\n" + text)
        load_mesh(folder / "m.obj")

    (folder / "m.obj").write_text(TEXTURED)
    return read


def read_ply(folder):
    def read(text):
        (folder / "m.ply").write_text(PLY.format(text))
        with suppress(ObjectFolderError):  # the long name
            list(references(folder / "m.ply"))

    return read


def read_names(folder):
    def read(text):
        (folder / "m.obj").write_text(text)
        mtl_names(folder / "m.obj")

    return read


def read_obj_text(folder):
    def read(text):
        (folder / "m.obj").write_text(TETRAHEDRON + text + "\n" + FACES)
        load_mesh(folder / "m.obj")

    return read


def read_stl_text(folder):
    def read(text):
        (folder / "m.stl").write_text(text)
        load_mesh(folder / "m.stl")

    return read


@pytest.mark.parametrize(
    ("reader", "make"),
    [
        (read_stl_text, lambda n: SOLID * (1 + n // 100)),
        (read_stl_text, lambda n: "solid " + "solid " * (n // 6) + SOLID),
        (read_names, lambda n: "mtllib a" + " " * n + "b"),
        (read_names, lambda n: "mtllib " + "a " * (n // 2)),
        (lambda folder: textures, lambda n: "\n" * n),
        (lambda folder: textures, lambda n: " \n" * (n // 2)),
        (lambda folder: textures, lambda n: "map_Kd a" + " " * n + "b"),
        (read_with_library, lambda n: "\n" * n),
        (read_with_library, lambda n: "newmtl a" + " " * n + "b"),
        (read_with_library, lambda n: "map_Ks a" + " " * n + "b"),
        (read_obj_text, lambda n: "usemtl a" + " " * n + "b"),
        (read_ply, lambda n: "comment TextureFile a" + " " * n + "b"),
    ],
)
def test_text_takes_time_in_proportion_to_its_length(tmp_path, reader, make):
    work = reader(tmp_path)
    work(make(100))
    short, long = seconds(work, make(2500)), seconds(work, make(25000))
    assert long < 30 * short + 0.1  # a quadratic one: 100 times


def test_a_file_of_too_many_pieces_is_refused(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text(TETRAHEDRON + "".join(f"usemtl a{i}\nf 1 2 3\n" for i in range(MAX_MATERIALS + 1)))
    refused(r"m\.obj uses 4097 materials, expected at most 4096; join", load_mesh, path)


def test_the_images_of_one_file_are_decoded_once(tmp_path, monkeypatch):
    Image.new("RGB", (4, 4), (9, 8, 7)).save(tmp_path / "t.png")
    opened = []
    real = Image.open
    monkeypatch.setattr(Image, "open", lambda *a, **k: opened.append(k.get("formats")) or real(*a, **k))
    names = [f"a{i}" for i in range(20)]
    (tmp_path / "m.mtl").write_text("".join(f"newmtl {name}\nmap_Kd t.png\n" for name in names))
    (tmp_path / "m.obj").write_text(TEXTURED.replace("skin", "a7"))
    np.testing.assert_array_equal(load_mesh(tmp_path / "m.obj").texture, np.full((4, 4, 3), [9, 8, 7]))
    assert sum(kinds is not None for kinds in opened) == 1
    opened.clear()
    scene = Scene()
    texture = scene.texture(np.full((4, 4, 3), [9, 8, 7]))
    for x in range(20):
        scene.quads(x, scene.material(texture), [square(0.5, 0.5, 0.5)])
    load_mesh(scene.write(tmp_path / "m.gltf"))
    assert len(opened) == 1


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_trimesh_opens_no_file_of_the_user(tmp_path, monkeypatch, kind):
    """It would take any format that Pillow knows."""
    (tmp_path / "t.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n")
    (tmp_path / "m.obj").write_text(TEXTURED)
    (tmp_path / "m.mtl").write_text("newmtl skin\nmap_Kd t.png\n")
    (tmp_path / "m.ply").write_text(PLY.format("comment TextureFile t.png"))
    real, opened = Image.open, []
    monkeypatch.setattr(Image, "open", lambda *a, **k: opened.append(k) or real(*a, **k))
    refused(r"t\.png cannot be read as an image", load_mesh, tmp_path / f"m.{kind}")
    assert [sorted(options) for options in opened] == [["formats"]]


LONG = "x" * 300 + ".png"


@pytest.mark.parametrize("statement", ["map_Kd", "map_Kd -s 1 1 1", "map_Ks"])
@pytest.mark.parametrize("name", [LONG, "a/" * 600 + "t.png"])
def test_a_name_too_long_for_a_file_is_told(tmp_path, statement, name):
    path = tmp_path / "m.obj"
    path.write_text(TEXTURED)
    (tmp_path / "m.mtl").write_text(f"newmtl skin\n{statement} {name}\n")
    assert [str(name) for name in references(path)] == ["m.mtl"]
    if "Kd" not in statement:  # a map that is not read
        assert len(load_mesh(path).faces) == 4
        return
    caught = refused(r"m\.obj refers to (xxx|a/a).*too long; shorten", load_mesh, path)
    assert len(caught) < 400


def test_a_ply_with_a_long_texture_name_and_any_case(tmp_path, capfd):
    path = tmp_path / "m.ply"
    path.write_text(PLY.format(f"comment texturefile {LONG}"))
    for read in (load_mesh, lambda p: list(references(p))):
        refused("too long; shorten", read, path)
    assert capfd.readouterr() == ("", "")  # trimesh once logged a traceback
    path.write_text(PLY.format("comment texturefile skin.png"))
    assert [str(name) for name in references(path)] == ["skin.png"]


def test_a_texture_that_cannot_be_read_is_told(tmp_path, monkeypatch):
    path = tmp_path / "m.obj"
    path.write_text(TEXTURED)
    (tmp_path / "m.mtl").write_text("newmtl skin\nmap_Kd t.png\n")
    Image.new("RGB", (4, 4)).save(tmp_path / "t.png")
    real = Path.read_bytes

    def refuse(file):
        if file.suffix == ".png":
            raise PermissionError(13, "Permission denied", str(file))
        return real(file)

    monkeypatch.setattr(Path, "read_bytes", refuse)
    refused(r"t\.png, which cannot be read: Permission denied", load_mesh, path)


def triangle(scene):
    return scene.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [0, 1, 2])


def sparse_of_many(scene, primitive):
    accessor = scene.document["accessors"][primitive["attributes"]["POSITION"]]
    indices = {"bufferView": scene.view(bytes([0])), "componentType": 5121}
    values = {"bufferView": scene.view(bytes(12))}
    del accessor["bufferView"]
    accessor |= {"count": 5_000_000, "sparse": {"count": 1, "indices": indices, "values": values}}


def stride_of_zero(scene, primitive):
    scene.document["accessors"][0]["count"] = 5_000_000
    scene.document["bufferViews"][0]["byteStride"] = 0


def many_colors(scene, primitive):
    many = scene.accessor(np.zeros((100_000, 4)), "u1")
    primitive["attributes"] = {"POSITION": 0, "COLOR_0": many}
    scene.document["meshes"][0]["primitives"] *= 50


@pytest.mark.parametrize(
    ("change", "message", "most"),
    [
        (sparse_of_many, "has 5000000 values, more than the", 10e6),
        (stride_of_zero, "reaches beyond the end of buffer view 0", 10e6),
        (many_colors, r"accessor \d has 100000 values for 3 vertices", 20e6),
    ],
)
def test_a_document_takes_no_more_memory_than_its_bytes(tmp_path, change, message, most):
    scene = Scene()
    mesh = triangle(scene)
    scene.node(mesh)
    change(scene, scene.document["meshes"][mesh]["primitives"][0])
    path = scene.write(tmp_path / "m.gltf")
    gc.collect()
    tracemalloc.start()
    try:
        refused(message, load_mesh, path)
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("repeated", ["nodes", "primitives"])
def test_repeated_meshes_are_counted(tmp_path, monkeypatch, repeated):
    monkeypatch.setattr(gltf, "MAX_ELEMENTS", 600)
    for count in (100, 101):  # of 3 vertices and 3 corners
        scene = Scene()
        mesh = triangle(scene)
        for _ in range(count if repeated == "nodes" else 1):
            scene.node(mesh)
        if repeated == "primitives":
            scene.document["meshes"][mesh]["primitives"] *= count
        path = scene.write(tmp_path / "m.gltf")
        if count == 100:
            assert len(load_mesh(path).faces) == 100
        else:
            refused(r"more than 600 vertices .* simplify it", load_mesh, path)


def test_a_mesh_that_nodes_repeat_is_read_once(tmp_path, monkeypatch):
    scene = Scene()
    mesh = triangle(scene)
    for x in range(50):
        scene.node(mesh, translation=[x, 0, 0])
    read = []
    real = gltf.GltfFile.accessor
    monkeypatch.setattr(gltf.GltfFile, "accessor", lambda self, *a: read.append(a) or real(self, *a))
    loaded = load_mesh(scene.write(tmp_path / "m.gltf"))
    assert len(read) == 2  # positions and indices
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(
        loaded.vertices[loaded.faces], corner + np.arange(50)[:, None, None] * [1, 0, 0]
    )


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 9) | st.floats() | st.text(max_size=5),
    lambda child: st.lists(child, max_size=3) | st.dictionaries(st.text(max_size=5), child, max_size=3),
    max_leaves=5,
)


def places(value, place=()):
    """All paths into a JSON document."""
    yield place
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from places(inner, (*place, key))


def whole_document(folder):
    """A document that uses every part of the standard that is read."""
    scene = Scene()
    texture = scene.texture(np.zeros((2, 2, 3)), wrapS=33071, wrapT=10497)
    info = {"extensions": {"KHR_texture_transform": {"offset": [0, 0], "rotation": 0.1, "scale": [2, 2]}}}
    material = scene.material(texture, info, baseColorFactor=[1, 1, 1, 1], roughnessFactor=0.5)
    scene.document["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {"index": texture}
    scene.quads(0, material, [square(0.5, 0.5, 0.5)], COLOR_0=np.full((1, 4, 3), 0.5))
    scene.node(0, rotation=[0, 0, 0, 1], scale=[1, 1, 1], translation=[0, 1, 0], children=[])
    scene.document |= {"extensionsRequired": ["KHR_texture_transform"]}
    scene.document["meshes"][0] |= {"weights": [0.5], "extras": {"visible": True}}
    primitive = scene.document["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}]
    primitive["attributes"] |= {
        "JOINTS_0": scene.accessor(np.zeros((4, 4)), "u1"),
        "WEIGHTS_0": scene.accessor(np.ones((4, 4))),
    }
    matrices = scene.accessor(np.eye(4).reshape(1, 16))
    scene.document["skins"] = [{"joints": [1], "inverseBindMatrices": matrices}]
    copies = {"attributes": {"TRANSLATION": scene.accessor(np.eye(3))}}
    hidden = {"KHR_node_visibility": {"visible": True}, "MSFT_lod": {"ids": []}}
    scene.node(0, skin=0, extensions={"EXT_mesh_gpu_instancing": copies, **hidden}, camera=0)
    scene.document["images"].append({"uri": "other.png", "name": "other"})
    return json.loads(scene.write(folder / "m.gltf").read_text())


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_value_anywhere_in_a_gltf_raises_anything_but_our_own_error(tmp_path, data):
    document = whole_document(tmp_path)
    for _ in range(data.draw(st.integers(1, 2))):
        place = data.draw(st.sampled_from(list(places(document))))
        value = data.draw(JSON)
        if not place:
            document = value
            break
        inner = document
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
    path = tmp_path / "m.gltf"
    path.write_text(json.dumps(document))
    loaded_or_refused(path)
    with suppress(ObjectFolderError):
        list(references(path))


WRONG_GROUPS = [[None], [3], {"a": 1}, 3, None, [{"uri": 3}], [{"uri": [1]}]]


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "3", '{"asset": []}', "[" * 100_000, '{"asset": {"version": [[]]}}'),
        *(
            json.dumps({"asset": {"version": "2.0"}, group: value})
            for group in ("images", "buffers")
            for value in WRONG_GROUPS
        ),
    ],
    ids=lambda text: text[:60],
)
def test_references_of_what_is_no_gltf(tmp_path, text):
    path = tmp_path / "m.gltf"
    path.write_text(text)
    refused(r"m\.gltf cannot be read as a mesh", list, references(path))


@pytest.mark.parametrize("group", ["images", "buffers"])
def test_an_item_without_a_file_refers_to_none(tmp_path, group):
    path = tmp_path / "m.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, group: [{"uri": None}]}))
    assert list(references(path)) == []
