"""Polygons and colours of ``.ply`` and ``.off``."""

import numpy as np
import pytest
from gltf_scene import checker
from PIL import Image
from polygons import AREA, area, u_plate
from refusals import refused

from objectfolder.mesh import srgb
from objectfolder.mesh.reading.load import load_mesh, references
from objectfolder.mesh.textured import PLAIN

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)


def rows(values):
    return "".join(" ".join(map(str, row)) + "\n" for row in values)


def counted(polygons):
    return [[len(polygon), *polygon] for polygon in polygons]


def header(vertices, faces, vertex=(), face=(), kind="ascii", comment=""):
    properties = "".join(f"property {p}\n" for p in ("float x", "float y", "float z", *vertex))
    of_faces = "".join(f"property {p}\n" for p in ("list uchar int vertex_indices", *face))
    return (
        f"ply\nformat {kind} 1.0\n{comment}element vertex {vertices}\n{properties}"
        f"element face {faces}\n{of_faces}end_header\n"
    )


def colors_by_vertex(mesh):
    return dict(zip(map(tuple, mesh.vertices), map(tuple, mesh.vertex_colors)))


def test_concave_polygons_of_a_ply_are_covered_once(tmp_path):
    vertices, polygons = u_plate()
    path = tmp_path / "m.ply"
    path.write_text(header(16, 10) + rows(vertices) + rows(counted(polygons)))
    mesh = load_mesh(path)
    assert len(mesh.faces) == 28
    assert area(mesh.vertices, mesh.faces) == pytest.approx(AREA)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_concave_polygons_keep_the_colours_of_their_faces(tmp_path, kind):
    vertices, (bottom, top, *_) = u_plate()
    colors = [[200, 10, 20], [30, 40, 250]]
    names = [f"uchar {name}" for name in ("red", "green", "blue")]
    head = header(16, 2, face=names, kind=kind)
    path = tmp_path / "m.ply"
    if kind == "ascii":
        path.write_text(head + rows(vertices) + rows([8, *p, *c] for p, c in zip((bottom, top), colors)))
    else:
        order = "<" if "little" in kind else ">"
        table = np.zeros(2, [("n", "u1"), ("p", order + "i4", 8), ("c", "u1", 3)])
        table["n"], table["p"], table["c"] = 8, [bottom, top], colors
        path.write_bytes(head.encode() + vertices.astype(order + "f4").tobytes() + table.tobytes())
    mesh = load_mesh(path)
    assert area(mesh.vertices, mesh.faces) == pytest.approx(14)
    for z, color in zip((0, 0.5), colors):
        of_cap = mesh.vertices[:, 2] == z
        assert (mesh.vertex_colors[of_cap] == color).all()


def test_concave_polygons_keep_the_coordinates_of_their_corners(tmp_path):
    vertices, (bottom, top, *_) = u_plate()
    Image.fromarray(checker([[[9, 8, 7]]], 4)).save(tmp_path / "t.png")
    path = tmp_path / "m.ply"
    head = header(16, 2, face=["list uchar float texcoord"], comment="comment TextureFile t.png\n")
    faces = [[8, *p, 16, *(vertices[p, :2] / 3).ravel()] for p in (bottom, top)]
    path.write_text(head + rows(vertices) + rows(faces))
    mesh = load_mesh(path)
    assert area(mesh.vertices, mesh.faces) == pytest.approx(14)
    np.testing.assert_allclose(mesh.uv, mesh.vertices[:, :2] / 3)
    np.testing.assert_array_equal(mesh.texture, np.full((4, 4, 3), [9, 8, 7]))


def test_a_ply_of_several_textures_is_refused(tmp_path):
    for name in ("a.png", "b.png"):
        Image.fromarray(checker([[[9, 8, 7]]], 4)).save(tmp_path / name)
    path = tmp_path / "m.ply"
    comments = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    face = ["list uchar float texcoord", "int texnumber"]
    corners = "3 0 1 2 6 0 0 1 0 1 1 0\n3 0 2 3 6 0 0 1 1 0 1 1\n"
    path.write_text(header(4, 2, face=face, comment=comments) + rows(SQUARE) + corners)
    refused(r"m\.ply names 2 textures \(a\.png, b\.png\), expected", load_mesh, path)
    path.write_text(path.read_text().replace("b.png", "a.png"))
    assert load_mesh(path).texture is not None


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_header_may_be_in_latin_1(tmp_path, encoding, kind):
    Image.fromarray(checker([[[9, 8, 7]]], 4)).save(tmp_path / "häute.png")
    comments = "comment Maß: 1 Å\ncomment TextureFile häute.png\n"
    head = header(4, 1, vertex=["float s", "float t"], kind=kind, comment=comments).encode(encoding)
    vertices = np.hstack([SQUARE, SQUARE[:, :2]])
    path = tmp_path / "m.ply"
    if kind == "ascii":
        path.write_bytes(head + (rows(vertices) + "4 0 1 2 3\n").encode())
    else:
        face = np.array([(4, [0, 1, 2, 3])], [("n", "u1"), ("p", "<i4", 4)])
        path.write_bytes(head + vertices.astype("<f4").tobytes() + face.tobytes())
    mesh = load_mesh(path)
    assert area(mesh.vertices, mesh.faces) == pytest.approx(1)
    assert (mesh.texture == [9, 8, 7]).all()
    assert [str(name) for name in references(path)] == ["häute.png"]


@pytest.mark.parametrize("prefix", ["", "diffuse_"])
@pytest.mark.parametrize(
    ("kind", "most"), [("uchar", 255), ("ushort", 65535), ("ushort", 255), ("float", 255), ("float", 1)]
)
def test_colours_of_a_ply_in_bytes_words_and_fractions(tmp_path, prefix, kind, most):
    colors = np.array([[0, 128, 255], [1, 2, 3], [250, 100, 0], [255, 255, 255]])
    names = [f"{kind} {prefix}{name}" for name in ("red", "green", "blue")]
    path = tmp_path / "m.ply"
    stored = colors * most // 255 if most >= 255 else colors / 255
    path.write_text(
        header(4, 1, vertex=names) + rows([*v, *c] for v, c in zip(SQUARE, stored)) + rows([[4, 0, 1, 2, 3]])
    )
    assert colors_by_vertex(load_mesh(path)) == dict(zip(map(tuple, SQUARE), map(tuple, colors)))


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v"), None])
def test_coordinates_of_no_texture_do_not_matter(tmp_path, names):
    colors = [f"uchar {name}" for name in ("red", "green", "blue")]
    path = tmp_path / "m.ply"
    if names:
        coordinates = [f"float {name}" for name in names]
        vertices = rows([*v, 1, 2, 3, 0.5, 0.5] for v in SQUARE)
        path.write_text(header(4, 1, vertex=colors + coordinates) + vertices + "4 0 1 2 3\n")
    else:
        vertices = rows([*v, 1, 2, 3] for v in SQUARE)
        corners = "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0 0 1 1 0 1\n"
        path.write_text(header(4, 2, vertex=colors, face=["list uchar float texcoord"]) + vertices + corners)
    mesh = load_mesh(path)
    assert mesh.texture is None
    assert (mesh.vertex_colors == [1, 2, 3]).all()


def test_colours_of_faces_beside_those_of_vertices_are_noted(tmp_path):
    names = [f"uchar {name}" for name in ("red", "green", "blue")]
    path = tmp_path / "m.ply"
    of_vertices = rows([*v, 1, 2, 3] for v in SQUARE)
    path.write_text(header(4, 1, vertex=names, face=names) + of_vertices + "3 0 1 2 9 9 9\n")
    mesh = load_mesh(path)
    assert (mesh.vertex_colors == [1, 2, 3]).all()
    assert mesh.source["notes"] == ["colours of faces beside those of vertices left out"]


def test_an_off_of_any_polygons(tmp_path):
    vertices, polygons = u_plate()
    path = tmp_path / "m.off"
    path.write_text(f"OFF # a plate\n16 10 24\n\n{rows(vertices)}{rows(counted(polygons))}")
    mesh = load_mesh(path)
    assert len(mesh.faces) == 28
    assert area(mesh.vertices, mesh.faces) == pytest.approx(AREA)
    assert mesh.vertex_colors is None


@pytest.mark.parametrize("unit", [1, 255])
@pytest.mark.parametrize("head", ["COFF\n4 2 0", "COFF 4 2 0"])
def test_an_off_with_colours_of_vertices(tmp_path, unit, head):
    colors = np.array([[0, 51, 255], [102, 0, 3], [255, 204, 0], [255, 255, 255]])
    table = [[*v, *(c / 255 if unit == 1 else c), unit] for v, c in zip(SQUARE, colors)]
    path = tmp_path / "m.off"
    path.write_text(f"{head}\n{rows(table)}3 0 1 2\n3 0 2 3 9 9 9\n")
    mesh = load_mesh(path)
    assert colors_by_vertex(mesh) == dict(zip(map(tuple, SQUARE), map(tuple, colors)))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


def test_an_off_with_colours_of_faces_and_normals(tmp_path):
    table = np.column_stack([SQUARE, np.tile([0.0, 0, 1], (4, 1))])
    path = tmp_path / "m.off"
    path.write_text(f"NOFF\n4 2 0\n{rows(table)}3 0 1 2 10 20 30\n3 0 2 3 40 50 255 255\n")
    mesh = load_mesh(path)
    np.testing.assert_array_equal(mesh.vertex_colors[mesh.faces][:, 0], [[10, 20, 30], [40, 50, 255]])
    np.testing.assert_array_equal(mesh.normals, np.tile([0.0, 0, 1], (len(mesh.vertices), 1)))


@pytest.mark.parametrize("unit", [1, 255])
def test_faces_of_an_off_without_a_colour_are_plain_beside_coloured_ones(tmp_path, unit):
    path = tmp_path / "m.off"
    path.write_text(f"OFF\n4 2 0\n{rows(SQUARE)}3 0 1 2 {unit} 0 {unit}\n3 0 2 3\n")
    mesh = load_mesh(path)
    plain = round(255 * srgb.encode(np.float64(PLAIN)))
    np.testing.assert_array_equal(mesh.vertex_colors[mesh.faces][:, 0], [[255, 0, 255], [plain] * 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("4OFF\n1 1 0\n", "its first line is '4OFF', expected OFF, COFF or NOFF and text"),
        ("OFF BINARY\n", "expected OFF, COFF or NOFF and text"),
        ("OFF\nmany\n", "no numbers of vertices and faces follow"),
        ("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "has 4 lines of vertices and faces, expected 3 and 2"),
        ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "some of its vertices have words that are no numbers"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "no numbers, or too few"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\nthree 0 1 2\n", "some of its faces have words"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 inf\n", "some of its faces have words"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "use vertices 0 to 3, but there are 3"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -2\n", "use vertices -2 to 1, but there are 3"),
    ],
)
def test_an_off_that_is_none_is_refused_in_words(tmp_path, text, message):
    path = tmp_path / "m.off"
    path.write_text(text)
    refused(message, load_mesh, path)


def test_a_texture_without_coordinates_and_colours_beside_one_are_noted(tmp_path):
    Image.new("RGB", (2, 2), (9, 8, 7)).save(tmp_path / "t.png")
    path = tmp_path / "m.ply"
    start = "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 3\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    places = ["0 0 0", "1 0 0", "0 1 0"]
    path.write_text(start + axes + faces + "\n".join(places) + "\n3 0 1 2\n")
    assert load_mesh(path).source["notes"][0] == "texture left out: the file has no texture coordinates"
    more = "property float s\nproperty float t\n" + "".join(
        f"property uchar {name}\n" for name in ("red", "green", "blue")
    )
    rows = "".join(f"{place} 0.5 0.5 1 2 3\n" for place in places)
    path.write_text(start + axes + more + faces + rows + "3 0 1 2\n")
    assert load_mesh(path).source["notes"] == ["vertex colours beside a texture left out"]
    assert load_mesh(path).texture.max() == 9


def test_an_ascii_stl_that_breaks_off_in_a_later_solid_is_refused(tmp_path):
    path = tmp_path / "m.stl"
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    facet = f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    whole = f"solid a\n{facet}endsolid a\n"
    path.write_text(2 * whole)
    assert len(load_mesh(path).faces) == 2
    path.write_text(whole + "solid b\n" + facet + facet[:60])
    refused(r"begins 3 triangles, of which 2 are complete; it may be cut off: copy", load_mesh, path)
