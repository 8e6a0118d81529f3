"""What Wavefront files say beyond triangles with one texture."""

import numpy as np
import pytest
import trimesh
from gltf_scene import checker, colors_at
from PIL import Image
from polygons import AREA, VOLUME, area, u_plate
from refusals import refused

from objectfolder.mesh import srgb
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import load_mesh, references
from objectfolder.mesh.reading.mtl import textures
from objectfolder.mesh.reading.obj import read_obj
from objectfolder.mesh.textured import PLAIN, appearance_report
from objectfolder.workspace.objects import object_files

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
COLORS = [[[250, 10, 20], [30, 240, 40]], [[50, 60, 230], [200, 200, 80]]]  # upper left first


def notes(mesh):
    return appearance_report(mesh)["notes"]


def written(folder, obj, mtl=None, name="m.obj"):
    if mtl is not None:
        (folder / "m.mtl").write_text(mtl)
        Image.fromarray(checker(COLORS, 16)).save(folder / "my skin.png")
        obj = "mtllib m.mtl\n" + obj
    (folder / name).write_text(obj)
    return load_mesh(folder / name)


def numbered(polygons, form="{}"):
    return "".join(f"f {' '.join(form.format(i + 1) for i in p)}\n" for p in polygons)


def vertex_lines(vertices, keyword="v"):
    return "".join(f"{keyword} {' '.join(map(str, row))}\n" for row in vertices)


@pytest.mark.parametrize("form", ["{}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}"])
def test_a_concave_polygon_is_covered_once(tmp_path, form):
    vertices, polygons = u_plate()
    uv = vertices[:, :2] + vertices[:, 2:]
    text = vertex_lines(vertices) + vertex_lines(uv, "vt") + vertex_lines(vertices - 1.25, "vn")
    mesh = written(tmp_path, text + numbered(polygons, form))
    assert len(mesh.faces) == 2 * 6 + 8 * 2
    assert area(mesh.vertices, mesh.faces) == pytest.approx(AREA, abs=1e-12)
    if "/" in form.removeprefix("{0}//"):
        (part,) = read_obj(tmp_path / "m.obj").parts
        np.testing.assert_allclose(part.uv, part.vertices[:, :2] + part.vertices[:, 2:])
    solid = normalize(mesh).surface
    assert solid.last_step == "keep"
    assert solid.volume == pytest.approx(VOLUME / 27)


def test_a_concave_quad_among_convex_ones_is_covered_once(tmp_path):
    dart = "v 3 0 0\nv 5 1 0\nv 4 0 0\nv 5 -1 0\n"
    mesh = written(tmp_path, QUAD + dart + "f 1 2 3 4\nf 8 7 6 5\nf 5 8 7 6\n")
    assert len(mesh.faces) == 6
    assert area(mesh.vertices, mesh.faces) == pytest.approx(1 + 1 + 1)


def test_indices_count_back_from_where_they_stand(tmp_path):
    points = "v {x} 0 0\nv {x} 1 0\nv {x} 0 1\nvt {x} 0\nvt {x} 1\nvt 0 {x}\n".format
    back, absolute = "f -3/-3 -2/-2 -1/-1\n", ["f 1/1 2/2 3/3\n", "f 4/4 5/5 6/6\n", "f 7/7 8/8 9/9\n"]
    mesh = written(tmp_path, "".join(points(x=x) + back for x in range(3)))
    same = written(tmp_path, "".join(points(x=x) + absolute[x] for x in range(3)), name="n.obj")
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][:, :, 0], np.repeat([[0], [1], [2]], 3, 1))
    np.testing.assert_array_equal(mesh.faces, same.faces)
    (part,), (other,) = (read_obj(tmp_path / name).parts for name in ("m.obj", "n.obj"))
    np.testing.assert_array_equal(part.vertices, other.vertices)
    np.testing.assert_array_equal(part.uv, other.uv)


@pytest.mark.parametrize("start", ["f\t", "  f ", "v\t", "\tv ", "vt\t", "usemtl\t", "\tusemtl\t"])
@pytest.mark.parametrize("every", [1, 2])
def test_lines_may_be_indented_and_keywords_end_at_a_tab(tmp_path, start, every):
    cube = trimesh.creation.box((0.1, 0.2, 0.3))
    lines = ["mtllib m.mtl", *vertex_lines(cube.vertices).splitlines(), "vt 0.5 0.5", "vt 0.25 0.5"]
    lines += ["usemtl skin", *numbered(cube.faces, "{}/1").splitlines()]
    (tmp_path / "m.mtl").write_text("newmtl skin\nKd 1 0 0\n")
    path = tmp_path / "m.obj"
    path.write_text("\n".join(lines))
    plain = read_obj(path)
    keyword = start.strip()
    chosen = [i for i, line in enumerate(lines) if line.partition(" ")[0] == keyword][::every]
    for i in chosen:
        lines[i] = start + lines[i].partition(" ")[2]
    path.write_text("\n".join(lines))
    found = read_obj(path)
    (part,), (same,) = found.parts, plain.parts
    assert found.notes == plain.notes == []
    assert len(part.faces) == 12
    np.testing.assert_array_equal(part.faces, same.faces)
    np.testing.assert_array_equal(part.vertices, same.vertices)
    np.testing.assert_array_equal(part.uv, same.uv)
    np.testing.assert_array_equal(part.material.color, same.material.color)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r\r\n"),
        lambda text: text.replace("\n", "\n\t"),
        lambda text: text.replace("f ", "f \\\n"),
        lambda text: text.replace("v ", "v \\\r\n"),
        lambda text: "# mtllib v\n" + text.replace("\nf", " # v\n\nf").replace("\nv", " # v 1\nv"),
    ],
    ids=["cr", "crlf", "crcrlf", "indented", "continued", "continued-crlf", "comments"],
)
def test_lines_may_have_other_ends_and_beginnings(tmp_path, change):
    cube = trimesh.creation.box((0.1, 0.2, 0.3))
    text = "mtllib m.mtl\n" + vertex_lines(cube.vertices) + "usemtl skin\n" + numbered(cube.faces)
    parts = []
    for convert in (str, change):
        (tmp_path / "m.mtl").write_bytes(convert("newmtl skin\nKd 1 0 0\n").encode())
        (tmp_path / "m.obj").write_bytes(convert(text).encode())
        found = read_obj(tmp_path / "m.obj")
        assert found.notes == []
        parts += found.parts
    plain, part = parts
    assert len(part.faces) == 12
    np.testing.assert_array_equal(part.vertices, plain.vertices)
    np.testing.assert_array_equal(part.faces, plain.faces)
    np.testing.assert_array_equal(part.material.color, [1, 0, 0])


def test_one_face_without_texture_coordinates_loses_the_texture_alone(tmp_path):
    faces = "usemtl skin\nf 1/1 2/2 3/3\nf 1 3 4\nf 1/1 3/3 4/4\n"
    mesh = written(tmp_path, QUAD + CORNERS + faces, "newmtl skin\nmap_Kd my skin.png\n")
    colors = {tuple(np.rint(c)) for c in colors_at(mesh, (0.6, 0.25, 0.15))}
    assert len(mesh.faces) == 3
    assert {(50, 60, 230)} < colors  # the lower left quarter
    assert notes(mesh)[0] == "texture without coordinates replaced by its mean colour (1)"


def test_forms_with_as_many_numbers_are_told_apart(tmp_path):
    faces = "f 1//1 2//1 3//1\nf 1/1 3/3 4/4\nf 1 2 3 4 3 4\nf 1/1 2/2 3\n"
    mesh = written(tmp_path, QUAD + CORNERS + "vn 0 0 1\n" + faces)
    assert len(mesh.faces) == 1 + 1 + 4 + 1
    np.testing.assert_array_equal(
        np.unique(mesh.vertices, axis=0), [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]]
    )


def test_a_material_called_none_is_not_that_of_faces_without_one(tmp_path):
    faces = "f 1/1 2/2 3/3\nusemtl None\nf 1/1 3/3 4/4\n"
    mesh = written(tmp_path, QUAD + CORNERS + faces, "newmtl None\nKd 1 0 0\n")
    grey = np.rint(255 * srgb.encode(np.float64(PLAIN)))
    assert {tuple(c) for c in colors_at(mesh).round()} == {(255, 0, 0), (grey, grey, grey)}


@pytest.mark.parametrize(
    ("options", "color"),
    [
        ("", (50, 60, 230)),
        ("-s 4 4 1", (30, 240, 40)),  # 0.2 -> 0.8
        ("-s 4", (200, 200, 80)),
        ("-o 0.5 0 0", (200, 200, 80)),
        ("-o 0.5", (200, 200, 80)),
        ("-o 1e-05 5e-1 0", (250, 10, 20)),
        ("-blendu on -bm 1 -s 1 4 1 -imfchan l -texres 512", (250, 10, 20)),
        ("-s 4 4 1 -o -1 0 0 -clamp on", (250, 10, 20)),
        ("-clamp on -o 3 0 0", (200, 200, 80)),
        ("-mm 0 1 -t 0 0 0 -O 0.5 0.5", (30, 240, 40)),
    ],
)
def test_options_of_a_texture_move_and_scale_it(tmp_path, options, color):
    uv = "vt 0.2 0.2\nvt 0.2 0.2\nvt 0.2 0.2\n"
    faces = "usemtl skin\nf 1/1 2/2 3/3\n"
    mesh = written(tmp_path, QUAD + uv + faces, f"newmtl skin\nmap_Kd {options} my skin.png\n")
    np.testing.assert_allclose(colors_at(mesh), [color], atol=1e-6)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("map_Kd -s 1 1 1 2 3.png", "2 3.png"),
        ("map_Kd -s 1e-05 +2.5E3 .5 a  b.png", "a  b.png"),
        ("map_Kd -clamp on 7", "7"),
        ("map_Kd -mm 0.2 0.8 t.png", "t.png"),
        ("map_Bump -bm 0.3 t.png", "t.png"),
        ("bump -type sphere -cc on t.png", "t.png"),
        ("map_Kd -new.png", "-new.png"),
    ],
)
def test_options_take_as_many_words_as_the_standard_says(line, name):
    assert textures(line) == [(line.split()[0], name)]


def test_what_a_material_drops_is_listed(tmp_path):
    mtl = (
        "newmtl skin\nmap_Kd -mm 0.5 1 my skin.png\nmap_Bump -bm 2 b.png\nd 0.5\n"
        "newmtl other\nKd 1 0 0\nTr 0.0\nd 1.0\nmap_d a.png\nmap_Ns s.png\n"
        "newmtl unused\nTr 0.7\ndisp d.png\n"
    )
    faces = "usemtl skin\nf 1/1 2/2 3/3\nusemtl other\nf 1/1 3/3 4/4\n"
    assert notes(written(tmp_path, QUAD + CORNERS + faces, mtl))[:4] == [
        "bump map left out (1)",
        "map_ns left out (1)",
        "option -mm of map_Kd left out (1)",
        "transparency left out (2)",
    ]


@pytest.mark.parametrize(
    ("mode", "alpha", "left_out"), [("RGBA", 0, 1), ("RGBA", 255, 0), ("LA", 254, 1), ("P", 0, 1)]
)
def test_alpha_of_a_texture_is_listed(tmp_path, mode, alpha, left_out):
    image = Image.new("RGBA", (2, 2), (200, 100, 50, 255))
    image.putpixel((1, 0), (200, 100, 50, alpha))
    image.convert(mode).save(tmp_path / "leaf.png")
    mesh = written(
        tmp_path, QUAD + CORNERS + "usemtl leaf\nf 1/1 2/2 3/3\n", "newmtl leaf\nmap_Kd leaf.png\n"
    )
    assert notes(mesh) == ["alpha of map_Kd left out (1)"] * left_out


@pytest.mark.parametrize("color", ["Kd 1 0 0", "map_Kd my skin.png", ""])
def test_roughness_and_metallic_are_kept_and_what_shines_is_listed(tmp_path, color):
    mtl = f"newmtl skin\n{color}\nPr 0.25\nPm 1\nKe 0 2 0\nTf 1 1 1\nPs 0\nPc 0.5\n"
    vertices = QUAD if color else "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n"
    mesh = written(tmp_path, vertices + CORNERS + "usemtl skin\nf 1/1 2/2 3/3\n", mtl)
    assert (mesh.roughness, mesh.metallic) == (0.25, 1)
    left_out = ["clearcoat", "emission", "transmission filter Tf"]
    assert notes(mesh) == [f"{what} left out (1)" for what in left_out]


def test_a_small_metal_part_makes_no_metal_of_the_rest(tmp_path):
    screw = "v 0 0 1\nv 0.1 0 1\nv 0.1 0.1 1\nv 0 0.1 1\n"
    faces = "usemtl wood\nf 1 2 3 4\nusemtl screw\nf 5 6 7 8\n"
    mtl = "newmtl wood\nKd 0.5 0.3 0.1\nnewmtl screw\nKd 1 1 1\nPm 1\nPr 0.1\n"
    mesh = written(tmp_path, QUAD + screw + faces, mtl)
    assert mesh.metallic == pytest.approx(0.01 / 1.01)
    assert mesh.roughness == pytest.approx((0.5 + 0.01 * 0.1) / 1.01)
    assert notes(mesh) == [
        "roughness 0.1 to 0.5 replaced by its mean 0.496",
        "metallic 0 to 1 replaced by its mean 0.0099",
    ]


@pytest.mark.parametrize(
    ("defined", "used", "image"),
    [
        ("my  skin", "my skin", "my skin.png"),
        ("my skin", "my  skin", '"my skin.png"'),
        ("my skin # of wood", "my skin", "my skin.png # diffuse"),
        ("my skin", "my skin   # of wood", "my skin.png"),
    ],
)
def test_names_end_at_comments_and_have_single_spaces(tmp_path, defined, used, image):
    text = QUAD + CORNERS + f"usemtl {used}\nf 1/1 2/2 3/3\n"
    mesh = written(tmp_path, text, f"newmtl {defined}\nmap_Kd {image}\n")
    assert mesh.texture.shape == (32, 32, 3)
    assert notes(mesh) == []


def test_names_may_hold_what_looks_like_a_comment(tmp_path):
    """As those of 3ds Max do."""
    mtl = "newmtl Material #25\nKd 1 0 0\nnewmtl Material #26\nmap_Kd my skin #1.png\n"
    lost = written(tmp_path, QUAD + "usemtl Material #27\nf 1 2 3\n", "newmtl Material #25\nKd 1 0 0\n")
    assert notes(lost) == ["material Material #27 is not defined: its faces have no colour"]
    Image.fromarray(checker(COLORS, 16)).save(tmp_path / "my skin #1.png")
    text = QUAD + CORNERS + "usemtl Material #25\nf 1/1 2/2 3/3\nusemtl Material #26\nf 1/1 3/3 4/4\n"
    mesh = written(tmp_path, text, mtl)
    assert len(mesh.source["notes"]) == 1
    assert mesh.source["notes"][0].startswith("2 materials baked")


def test_white_vertices_do_not_bleach_a_material(tmp_path):
    white = "v 0 0 0 1 1 1\nv 1 0 0 1 1 1\nv 1 1 0 1 1 1\n"
    mesh = written(tmp_path, white + "usemtl red\nf 1 2 3\n", "newmtl red\nKd 1 0 0\n")
    assert mesh.texture.tolist() == [[[255, 0, 0]]]
    assert notes(mesh) == ["white vertex colours beside Kd left out"]


@pytest.mark.parametrize(("color", "shown"), [("1 1 1", (50, 60, 230)), ("0 1 0", (0, 255, 0))])
def test_colours_of_faces_without_coordinates_count_if_they_are_not_white(tmp_path, color, shown):
    """The material of an earlier object has a texture, and holds on."""
    Image.new("RGB", (4, 4), (50, 60, 230)).save(tmp_path / "t.png")
    other = "".join(f"v {x} {y} 2 {color}\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    faces = "usemtl skin\nf 1/1 2/2 3/3\n" + other + "f 5 6 7\n"
    mesh = written(tmp_path, QUAD + CORNERS + faces, "newmtl skin\nmap_Kd t.png\n")
    upper = (mesh.vertices[mesh.faces][..., 2] == 2).all(1)
    np.testing.assert_allclose(colors_at(mesh)[upper], [shown], atol=2)


def test_materials_that_no_face_has_are_noted(tmp_path):
    mesh = written(tmp_path, QUAD + "f 1 2 3\n", "newmtl red\nKd 1 0 0\n")
    assert notes(mesh) == ["materials left out: no face says which it has (usemtl)"]


def test_a_material_without_a_colour_is_plain(tmp_path):
    mesh = written(tmp_path, QUAD + "usemtl a\nf 1 2 3\n", "newmtl a\nNs 10\n")
    assert mesh.texture is mesh.vertex_colors is None  # PLAIN, as of a mesh without materials
    grey = written(
        tmp_path, QUAD + "usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n", "newmtl a\nNs 1\nnewmtl b\nKd 1 0 0\n"
    )
    low = np.rint(255 * srgb.encode(np.float64(PLAIN)))
    assert {tuple(c) for c in grey.vertex_colors} == {(low, low, low), (255, 0, 0)}


def test_the_range_of_vertex_colours_is_that_of_the_file(tmp_path):
    """A material whose vertices are nearly black, beside one that is not."""
    dark = "v 0 0 0 1 1 0\nv 1 0 0 1 0 1\nv 0 1 0 0 1 1\n"
    bright = "v 0 0 1 200 100 50\nv 1 0 1 255 0 0\nv 0 1 1 0 0 9\n"
    mesh = written(tmp_path, dark + bright + "usemtl a\nf 1 2 3\nusemtl b\nf 4 5 6\n")
    found = dict(zip(map(tuple, mesh.vertices), map(tuple, mesh.vertex_colors)))
    assert found[0, 0, 0] == (1, 1, 0)
    assert found[0, 0, 1] == (200, 100, 50)
    assert notes(mesh) == [
        "material a, b is not defined: its faces have no colour but that of their vertices"
    ]


@pytest.mark.parametrize(
    ("material", "plain"), [("", PLAIN), ("newmtl a\nKd 0 1 0\n", [0, 1, 0])], ids=["none", "Kd"]
)
def test_vertices_without_a_colour_have_that_of_their_material(tmp_path, material, plain):
    (tmp_path / "m.mtl").write_text(material)
    path = tmp_path / "m.obj"
    path.write_text("mtllib m.mtl\nv 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 0 0 1\nusemtl a\nf 1 2 3\n")
    (part,) = read_obj(path).parts
    np.testing.assert_array_equal(part.colors, [[1, 0, 0], np.broadcast_to(plain, 3), [0, 0, 1]])
    assert part.material.color is None


def test_comments_and_further_numbers_of_a_line_are_left_out(tmp_path):
    plain, path = QUAD + CORNERS + "vn 0 0 1\nf 1/1/1 2/2/1 3/3/1\n", tmp_path / "m.obj"
    path.write_text(plain)
    (same,) = read_obj(path).parts
    lines = [f"{line} # 1/2 x" for line in plain.splitlines()]
    lines[0] = lines[0].replace("#", "1.0#")  # the weight of a rational curve's point
    lines[5] = lines[5].replace("#", "0 #")  # the third coordinate of a texture
    path.write_text("\n".join(["# v x", *lines, "f 1 2", "f 1"]))
    (part,) = read_obj(path).parts
    for name in ("vertices", "faces", "uv", "normals"):
        np.testing.assert_array_equal(getattr(part, name), getattr(same, name))


def test_a_face_whose_coordinates_are_not_in_the_file_has_none(tmp_path):
    (tmp_path / "m.obj").write_text(QUAD + CORNERS + "f 1/1/1 2/2/1 3/3/1\nf 1/1 3/3 4/9\n")
    parts = read_obj(tmp_path / "m.obj").parts
    assert [(len(part.faces), part.uv is None, part.normals) for part in parts] == [
        (1, True, None),
        (1, False, None),
    ]


TWO_MATERIALS = (
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl {}\nf 1 3 2\nf 1 2 4\nusemtl {}\nf 1 4 3\nf 2 3 4\n"
)


@pytest.mark.parametrize(
    ("names", "encoding"),
    [(("Stahl_ä", "Stahl_ö"), "cp1252"), (("红", "绿"), "gbk"), (("\u8005a", "\u5085a"), "gbk")],
)
def test_names_that_are_no_utf8_stay_apart(tmp_path, names, encoding):
    path = tmp_path / "m.obj"
    library = "newmtl {}\nKd 1 0 0\nnewmtl {}\nKd 0 1 0\n".format(*names)
    (tmp_path / "m.mtl").write_bytes(library.encode(encoding))
    path.write_bytes(("mtllib m.mtl\n" + TWO_MATERIALS.format(*names)).encode(encoding))
    mesh = load_mesh(path)
    assert appearance_report(mesh)["notes"] == []
    assert len(np.unique(mesh.vertex_colors, axis=0)) == 2


ONE_SIDE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"


def test_a_texture_lies_beside_its_library_or_else_beside_the_mesh(tmp_path):
    path = tmp_path / "m.obj"
    (tmp_path / "mats").mkdir()
    path.write_text("mtllib mats/m.mtl\n" + ONE_SIDE)
    for name, found in (("t.png", "mats/t.png"), ("../maps/t.png", "maps/t.png"), ("own.png", "own.png")):
        (tmp_path / "mats/m.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
        file = tmp_path / found
        file.parent.mkdir(exist_ok=True)
        Image.new("RGB", (2, 2), (9, 8, 7)).save(file)
        if name == "t.png":
            Image.new("RGB", (2, 2), (1, 2, 3)).save(tmp_path / name)
        assert [str(name) for name in references(path)] == ["mats/m.mtl", found]
        assert load_mesh(path).texture.max() == 9
    (tmp_path / "mats/m.mtl").write_text("newmtl a\nmap_Kd ../../gone.png\n")
    refused(r"outside its folder; .* edit the path in the \.mtl file", load_mesh, path)


def test_only_textures_that_faces_need_have_to_be_there(tmp_path):
    path = tmp_path / "m.obj"
    path.write_text("mtllib m.mtl\n" + ONE_SIDE)
    (tmp_path / "m.mtl").write_text(
        "newmtl a\nKd 1 0 0\nmap_Bump C:\\tex\\b.png\nnewmtl b\nmap_Kd gone.png\n"
    )
    assert load_mesh(path).texture.tolist() == [[[255, 0, 0]]]
    assert [str(target) for target in object_files(path)] == ["mesh.obj", "m.mtl"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("C:\\x\\gone.mtl", r"outside its folder; .* edit the path in the \.obj file"),
        ("gone.mtl", r"m\.obj .*gone\.mtl, which does not exist; put it there, or delete the line mtllib"),
        ("M.MTL", r"M\.MTL, which does not exist \(m\.mtl does: upper and lower case differ\); put"),
    ],
    ids=["drive", "gone", "case"],
)
def test_where_a_library_is_and_what_to_do_is_told(tmp_path, name, message):
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "m.obj").write_text(f"mtllib {name}\n" + ONE_SIDE)
    refused(message, load_mesh, tmp_path / "m.obj")
