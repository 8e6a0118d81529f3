"""Colours and places of glTF scenes, through loading, baking, writing and loading again."""

import json

import numpy as np
import pytest
from gltf_scene import Scene, checker, colors_at, square
from refusals import refused
from solids import box
from trimesh.transformations import quaternion_matrix

from objectfolder.mesh import srgb
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.textured import PLAIN, TexturedMesh, appearance_report

RED, GREEN, BLUE, SAND = [220, 30, 20], [10, 200, 60], [30, 40, 230], [200, 180, 120]
FOUR = [[RED, GREEN], [BLUE, SAND]]  # first row on top, as glTF's v
CENTRES = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
INNER = [(0.6, 0.2, 0.2), (0.2, 0.6, 0.2), (1 / 3, 1 / 3, 1 / 3)]


def linear(color):
    return srgb.decode(np.asarray(color) / 255).tolist()


def loaded_twice(scene, tmp_path, **options):
    """Load a scene, write it and load that: both meshes."""
    mesh = load_mesh(scene.write(tmp_path / "scene.gltf"), "y", **options)
    mesh.write_glb(tmp_path / "visual.glb")
    return mesh, load_mesh(tmp_path / "visual.glb", "y")


def assert_colors(meshes, per_quad, places=INNER):
    expected = np.repeat(np.asarray(per_quad, float), 2, 0)
    for mesh in meshes:
        assert len(mesh.faces) == len(expected)
        for weights in places:
            np.testing.assert_allclose(colors_at(mesh, weights), expected, atol=2)


def four_squares(size=0.3, shift=(0, 0)):
    return [square(u + shift[0], v + shift[1], size) for u, v in CENTRES]


@pytest.mark.parametrize("texture_size", [1024, 256, 64])
def test_every_kind_of_material_keeps_its_colour_in_one_texture(tmp_path, texture_size):
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 128))), four_squares())
    scene.quads(1, scene.material(scene.texture(checker([[SAND, BLUE]], 16))), [square(0.25, 0.5, 0.2)])
    scene.quads(2, scene.material(baseColorFactor=[*linear(GREEN), 1]))
    scene.quads(3, scene.material(), COLOR_0=np.repeat([[linear(RED)], [linear(BLUE)]], 4, 1))
    scene.quads(4)  # no material
    tinted = scene.material(scene.texture(checker([[[255] * 3]], 8)), baseColorFactor=[*linear(BLUE), 1])
    scene.quads(5, tinted, [square(0.5, 0.5, 0.5)])
    plain = 255 * srgb.encode(np.full(3, PLAIN))
    meshes = loaded_twice(scene, tmp_path, texture_size=texture_size)
    assert_colors(meshes, [RED, GREEN, BLUE, SAND, SAND, GREEN, RED, BLUE, plain, BLUE])
    assert max(meshes[0].texture.shape) <= texture_size
    report = appearance_report(meshes[0])
    assert report["materials"] == 6
    assert any("6 materials baked" in note for note in report["notes"])
    assert report["source_texture_size"] == 256


def test_a_texture_of_many_parts_stays_as_it_is(tmp_path):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 8)))
    scene.quads(0, material, four_squares())
    scene.quads(1, material, four_squares())
    meshes = loaded_twice(scene, tmp_path)
    for mesh in meshes:
        np.testing.assert_array_equal(mesh.texture, checker(FOUR, 8))
    assert_colors(meshes, [RED, GREEN, BLUE, SAND] * 2)


def test_two_large_textures_share_one_small_texture(tmp_path):
    scene = Scene()
    for x, colors in enumerate((FOUR, FOUR[::-1])):
        scene.quads(x, scene.material(scene.texture(checker(colors, 512))), four_squares())
    meshes = loaded_twice(scene, tmp_path, texture_size=200)
    assert_colors(meshes, [RED, GREEN, BLUE, SAND, BLUE, SAND, RED, GREEN])
    assert max(meshes[0].texture.shape) <= 200
    assert min(meshes[0].texture.shape[:2]) >= 90  # most of the room is used


@pytest.mark.parametrize("others", [0, 1])
def test_repeats_far_from_the_origin(tmp_path, others):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 16)))
    scene.quads(0, material, [*four_squares(shift=(7, -3)), *four_squares(shift=(-2, 0)), square(3, 5, 0.4)])
    if others:
        scene.quads(1, scene.material(baseColorFactor=[*linear(RED), 1]))
    meshes = loaded_twice(scene, tmp_path)
    quads = [RED, GREEN, BLUE, SAND] * 2
    expected = np.repeat(quads, 2, 0)
    for mesh in meshes:
        np.testing.assert_allclose(colors_at(mesh)[:16], expected, atol=2)
        # The last quad lies around a corner that all four squares share.
        np.testing.assert_allclose(colors_at(mesh, (0.9, 0.05, 0.05))[16], SAND, atol=2)
        np.testing.assert_allclose(colors_at(mesh, (0.05, 0.9, 0.05))[16], BLUE, atol=2)
        np.testing.assert_allclose(colors_at(mesh, (0.05, 0.05, 0.9))[17], GREEN, atol=2)
    assert appearance_report(meshes[0])["uv_outside_fraction"] == pytest.approx(18 / (18 + 2 * others))
    if others:
        assert meshes[0].uv.min() >= 0
        assert meshes[0].uv.max() <= 1


def test_a_face_over_many_repeats(tmp_path):
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 16))), [square(0, 0, 9)])
    scene.quads(1, scene.material(baseColorFactor=[*linear(RED), 1]))
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "y")
    rng = np.random.default_rng(3)
    uv = square(0, 0, 9)
    for weights in rng.dirichlet([1, 1, 1], 40):
        place = weights @ uv[[0, 1, 2]]
        if (np.abs((2 * place) % 1 - 0.5) < 0.4).all():  # not at a border of squares
            column, row = np.floor(2 * place).astype(int) % 2
            np.testing.assert_allclose(colors_at(mesh, weights)[0], FOUR[row][column], atol=2)


@pytest.mark.parametrize(
    ("sampler", "u", "column"),
    [
        ({}, 1.25, 0),
        ({"wrapS": 33071}, 1.25, 1),
        ({"wrapS": 33071}, -0.4, 0),
        ({"wrapS": 33648}, 1.25, 1),
        ({"wrapS": 33648}, 2.25, 0),
        ({"wrapS": 33648}, -0.75, 1),
    ],
)
@pytest.mark.parametrize("others", [0, 1])
def test_what_lies_beyond_the_texture(tmp_path, sampler, u, column, others):
    scene = Scene()
    texture = scene.texture(checker(FOUR, 16), **sampler)
    scene.quads(0, scene.material(texture), [square(u, 0.25, 0.2)])
    for _ in range(others):
        scene.quads(1, scene.material(texture), [square(0.25, 0.75, 0.2)])
    assert_colors(loaded_twice(scene, tmp_path), [FOUR[0][column], *[BLUE] * others])


@pytest.mark.parametrize(
    ("transform", "uv", "color"),
    [
        ({"offset": [0.5, 0]}, (0.25, 0.25), GREEN),
        ({"offset": [0, 0.5]}, (0.25, 0.25), BLUE),
        ({"scale": [0.5, 0.5]}, (1.5, 0.5), GREEN),
        # A quarter turn, counter-clockwise with v pointing down, takes (0.25, -0.75) to (-0.75, -0.25).
        ({"rotation": np.pi / 2}, (0.25, -0.75), BLUE),
        ({"offset": [0.5, 0], "rotation": np.pi / 2, "scale": [0.5, 1]}, (0.5, 0.75), BLUE),
        ({"texCoord": 1}, (0.25, 0.25), SAND),
    ],
)
def test_texture_transforms(tmp_path, transform, uv, color):
    scene = Scene()
    info = {"extensions": {"KHR_texture_transform": transform}}
    material = scene.material(scene.texture(checker(FOUR, 16)), info)
    scene.quads(0, material, [square(*uv, 0.1)], TEXCOORD_1=[square(0.75, 0.75, 0.1)])
    scene.document["extensionsUsed"] = scene.document["extensionsRequired"] = ["KHR_texture_transform"]
    assert_colors(loaded_twice(scene, tmp_path), [color])


def test_the_second_set_of_texture_coordinates(tmp_path):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 16)), {"texCoord": 1})
    scene.quads(0, material, [square(0.25, 0.25, 0.1)], TEXCOORD_1=[square(0.75, 0.25, 0.1)])
    assert_colors(loaded_twice(scene, tmp_path), [GREEN])


@pytest.mark.parametrize(("dtype", "top"), [("u1", 255), ("u2", 65535)])
def test_texture_coordinates_of_integers(tmp_path, dtype, top):
    scene = Scene()
    uv = np.rint(np.concatenate(four_squares()) * top)
    index = scene.accessor(uv, dtype, normalized=True)
    material = scene.material(scene.texture(checker(FOUR, 16)))
    corner = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
    vertices = (corner + np.arange(4)[:, None, None] * [2, 0, 0]).reshape(-1, 3)
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(4)[:, None, None]
    scene.node(scene.mesh(vertices, faces, material, TEXCOORD_0=index))
    assert_colors(loaded_twice(scene, tmp_path), [RED, GREEN, BLUE, SAND])


@pytest.mark.parametrize(("dtype", "top"), [("f4", None), ("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("columns", [3, 4])
def test_vertex_colours_are_linear(tmp_path, dtype, top, columns):
    scene = Scene()
    values = np.repeat([[*linear(color), 1][:columns] for color in (RED, SAND)], 4, 0)
    index = scene.accessor(
        values if top is None else np.rint(values * top), dtype, normalized=top is not None
    )
    corner = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    scene.node(scene.mesh(np.concatenate([corner, corner + 2]), faces, COLOR_0=index))
    first, second = loaded_twice(scene, tmp_path)
    # 8 bits of linear light are 10 levels of dark sRGB wide.
    np.testing.assert_allclose(
        first.vertex_colors, np.repeat([RED, SAND], 4, 0), atol=7 if dtype == "u1" else 0
    )
    np.testing.assert_array_equal(second.vertex_colors, first.vertex_colors)


def test_all_256_levels_of_vertex_colours_survive_writing(tmp_path):
    scene = Scene()
    level = np.arange(256)
    colors = srgb.decode(np.stack([level, level[::-1], level], 1) / 255)
    scene.quads(0, None, COLOR_0=colors.reshape(64, 4, 3))
    for mesh in loaded_twice(scene, tmp_path):
        np.testing.assert_array_equal(mesh.vertex_colors, np.stack([level, level[::-1], level], 1))


def test_vertex_colours_and_factors_multiply_and_surfaces_stay(tmp_path):
    scene = Scene()
    factor = [0.5, 0.25, 1.0, 1.0]
    material = scene.material(baseColorFactor=factor, roughnessFactor=0.25, metallicFactor=0.75)
    scene.quads(0, material, COLOR_0=np.full((1, 4, 3), 0.5))
    meshes = loaded_twice(scene, tmp_path)
    assert_colors(meshes, [255 * srgb.encode(0.5 * np.array(factor[:3]))])
    for mesh in meshes:
        assert (mesh.roughness, mesh.metallic) == (0.25, 0.75)
        assert mesh.texture is None


def test_vertex_colours_tint_a_texture(tmp_path):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 16)))
    shade = np.array([0.25, 1.0, 0.5, 1.0])[:, None, None] * np.ones((4, 4, 3))
    scene.quads(0, material, four_squares(), COLOR_0=shade)
    colors = [
        255 * srgb.encode(s * np.array(linear(c))) for s, c in zip(shade[:, 0], (RED, GREEN, BLUE, SAND))
    ]
    assert_colors(loaded_twice(scene, tmp_path), colors)


def test_vertex_colours_beside_a_texture_are_interpolated(tmp_path):
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 16))), four_squares())
    corners = np.array([[0.3, 0.4, 0.5], [0.6, 0.4, 0.3], [0.8, 0.6, 0.3], [0.5, 0.5, 0.5]])
    scene.quads(1, None, COLOR_0=corners[None])
    for mesh in loaded_twice(scene, tmp_path):
        for weights in (*INNER, (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0)):
            expected = 255 * srgb.encode(np.asarray(weights) @ corners[[[0, 1, 2], [0, 2, 3]]])
            np.testing.assert_allclose(colors_at(mesh, weights)[8:], expected, atol=2)


def notes(mesh):
    return appearance_report(mesh)["notes"]


def test_equal_vertex_colours_tint_the_texture_as_it_is(tmp_path):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 16)))
    tint = np.array([0.25, 1.0, 0.5])
    scene.quads(0, material, four_squares(), COLOR_0=np.tile(tint, (4, 4, 1)))
    scene.quads(1, material, four_squares(), COLOR_0=np.tile(tint, (4, 4, 1)))
    tinted = np.rint(255 * srgb.encode(srgb.decode(checker(FOUR, 16) / 255) * tint))
    for mesh in loaded_twice(scene, tmp_path):
        np.testing.assert_array_equal(mesh.texture, tinted)
        assert notes(mesh) == []


@pytest.mark.parametrize(("texture_size", "atol"), [pytest.param(1024, 2, marks=pytest.mark.slow), (256, 12)])
def test_vertex_colours_leave_a_texture_its_detail(tmp_path, texture_size, atol):
    """A check of 16 x 16 fields on one quad, shaded from corner to corner."""
    rng = np.random.default_rng(4)
    fields = rng.integers(40, 256, (16, 16, 3))
    shade = np.array([0.25, 1.0, 0.5, 0.75])
    scene = Scene()
    material = scene.material(scene.texture(checker(fields, 16)))
    scene.quads(0, material, [square(0.5, 0.5, 1)], COLOR_0=np.tile(shade[:, None], (1, 1, 3))[None])
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "y", texture_size=texture_size)
    (note,) = notes(mesh)
    assert note.startswith("1 material baked into ")
    assert note.endswith("images at 100%") == (texture_size == 1024)
    corners = square(0.5, 0.5, 1)
    for row, column in np.ndindex(16, 16):
        place = (np.array([column, row]) + 0.5) / 16
        face = 0 if place[0] > place[1] else 1
        index = [[0, 1, 2], [0, 2, 3]][face]
        weights = np.linalg.solve(np.vstack([corners[index].T, np.ones(3)]), [*place, 1])
        expected = 255 * srgb.encode(np.array(linear(fields[row, column])) * (weights @ shade[index]))
        np.testing.assert_allclose(colors_at(mesh, weights)[face], expected, atol=atol)


def test_a_face_over_many_repeats_takes_no_texels_from_small_ones(tmp_path):
    scene = Scene()
    shade = np.array([0.25, 1.0, 0.5, 0.75])
    colors = np.tile(shade[:, None], (5, 1, 3))
    uv = [square(0, 0, 40), *four_squares(0.25)]
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 32))), uv, COLOR_0=colors)
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "y", texture_size=256)
    assert notes(mesh)[0].endswith("to 100%")
    # Small faces come first.
    for face, color in enumerate((RED, RED, GREEN, GREEN, BLUE, BLUE, SAND, SAND)):
        corners = shade[[[0, 1, 2], [0, 2, 3]][face % 2]]
        for weights in INNER:
            expected = 255 * srgb.encode(np.array(linear(color)) * (weights @ corners))
            np.testing.assert_allclose(colors_at(mesh, weights)[face], expected, atol=2)


@pytest.mark.parametrize(("spread", "said"), [(1, "100%"), (8, "47% to 94.1%")])
def test_the_scales_of_the_images_are_noted(tmp_path, spread, said):
    """An image of 32 texels is repeated eight times along a face: 128 have room for 15 each, and a margin."""
    scene = Scene()
    small = scene.texture(checker(FOUR, 16))
    scene.quads(0, scene.material(small), [square(0.5, 0.5, 0.2)])
    ends = np.array([[0, 0.4], [spread, 0.4], [spread, 0.6], [0, 0.6]])
    scene.quads(1, scene.material(scene.texture(checker(FOUR, 16))), [ends])
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "y", texture_size=128)
    assert notes(mesh)[0].endswith(f"images at {said}")


@pytest.mark.parametrize(("u", "column"), [(40.5, 1), (-40.5, 0)])
def test_faces_far_beyond_a_clamped_image_take_no_texels(tmp_path, u, column):
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 16), wrapS=33071)), [square(u, 0.25, 0.2)])
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "y", texture_size=64)
    assert_colors([mesh], [FOUR[0][column]])
    assert notes(mesh)[0].endswith("images at 100%")


def test_roughness_and_metallic_are_means_by_area(tmp_path):
    scene = Scene()
    smooth = scene.material(roughnessFactor=0.1, metallicFactor=1.0)
    rough = scene.material(roughnessFactor=0.9, metallicFactor=0.0)
    scene.quads(0, smooth)
    scene.node(scene.mesh([[5, 0, 0], [5, 0, 3], [5, 2, 0]], [[0, 1, 2]], rough))  # area 3 beside 1
    mesh, back = loaded_twice(scene, tmp_path)
    assert mesh.roughness == pytest.approx(0.25 * 0.1 + 0.75 * 0.9)
    assert mesh.metallic == pytest.approx(0.25)
    assert (back.roughness, back.metallic) == (mesh.roughness, mesh.metallic)
    notes = " ".join(appearance_report(mesh)["notes"])
    assert "roughness 0.1 to 0.9 replaced by its mean 0.7" in notes


def test_what_is_left_out_is_noted(tmp_path):
    scene = Scene()
    texture = scene.texture(checker(FOUR, 4))
    material = scene.material(texture, metallicRoughnessTexture={"index": texture})
    scene.document["materials"][material] |= {"normalTexture": {"index": texture}, "alphaMode": "BLEND"}
    scene.quads(0, material, four_squares())
    report = appearance_report(load_mesh(scene.write(tmp_path / "s.gltf"), "y"))
    assert report["notes"] == [
        "normal map left out (1)",
        "roughness and metallic map replaced by its mean (1)",
        "transparency left out (1)",
    ]
    assert report["roughness"] == pytest.approx(np.mean([30, 200, 40, 180]) / 255)
    assert report["metallic"] == pytest.approx(np.mean([20, 60, 230, 120]) / 255)


def test_extensions_of_a_material_and_its_emission_are_noted(tmp_path):
    scene = Scene()
    material = scene.material()
    scene.document["materials"][material] |= {
        "emissiveFactor": [0, 0.5, 0],
        "extensions": {
            "KHR_materials_transmission": {"transmissionFactor": 1},
            "KHR_materials_clearcoat": {},
            "KHR_materials_specular": {},
        },
    }
    scene.quads(0, material)
    assert notes(load_mesh(scene.write(tmp_path / "s.gltf"), "y")) == [
        "KHR_materials_clearcoat left out (1)",
        "KHR_materials_specular left out (1)",
        "emission left out (1)",
        "transparency left out (1)",
    ]


def test_glossiness_materials(tmp_path):
    scene = Scene()
    material = scene.material()
    gloss = {"diffuseFactor": [*linear(SAND), 1], "glossinessFactor": 0.75}
    scene.document["materials"][material]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": gloss}
    scene.quads(0, material)
    mesh, back = loaded_twice(scene, tmp_path)
    assert_colors([mesh, back], [SAND])
    assert (mesh.roughness, mesh.metallic) == (0.25, 0)


def test_a_map_of_glossiness_counts_as_its_mean(tmp_path):
    scene = Scene()
    material = scene.material()
    pixels = np.full((2, 4, 4), 255, np.uint8)
    pixels[..., 3] = [[0, 51, 102, 51], [51, 51, 51, 51]]  # a fifth of 255 in the mean
    gloss = {"glossinessFactor": 0.5, "specularGlossinessTexture": {"index": scene.texture(pixels)}}
    scene.document["materials"][material]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": gloss}
    scene.quads(0, material)
    mesh = load_mesh(scene.write(tmp_path / "m.gltf"))
    assert mesh.roughness == pytest.approx(0.9, abs=1e-12)
    assert mesh.source["notes"] == ["specular and glossiness map replaced by its mean (1)"]


def tetrahedron(scene):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
    return vertices, scene.mesh(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def signed_volume(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.einsum("fc,fc->", a, np.cross(b, c)) / 6


def test_nodes_place_meshes_and_mirrors_keep_the_outside_outside(tmp_path):
    scene = Scene()
    vertices, mesh = tetrahedron(scene)
    quaternion = np.array([0.1, -0.4, 0.3, 0.8])
    quaternion /= np.linalg.norm(quaternion)
    inner = scene.node(
        mesh, root=False, translation=[1, 2, 3], rotation=quaternion.tolist(), scale=[2, -1, 3]
    )
    turned = quaternion_matrix(quaternion[[3, 0, 1, 2]])[:3, :3]  # trimesh's order is w, x, y, z
    outer = np.array([[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]], float)
    scene.node(root=True, matrix=outer.T.ravel().tolist(), children=[inner])
    result = load_mesh(scene.write(tmp_path / "s.gltf"), "z")
    expected = ((vertices * [2, -1, 3]) @ turned.T + [1, 2, 3]) @ outer[:3, :3].T + outer[:3, 3]
    np.testing.assert_allclose(result.vertices, expected, atol=1e-12)
    assert signed_volume(result) == pytest.approx(6)  # 1 x 2 x 3 / 6, times 2 x 1 x 3


def test_a_mesh_of_several_nodes_stands_in_each_place(tmp_path):
    scene = Scene()
    vertices, mesh = tetrahedron(scene)
    for x in (0, 10, 20):
        scene.node(mesh, translation=[x, 0, 0], scale=[-1 if x == 10 else 1, 1, 1])
    scene.node(mesh, root=False)  # of no scene
    result = load_mesh(scene.write(tmp_path / "s.gltf"), "z")
    assert len(result.faces) == 12
    assert signed_volume(result) == pytest.approx(3)
    np.testing.assert_allclose(result.vertices[8:], vertices + np.array([20, 0, 0]))


def test_strips_fans_and_triangles_without_indices(tmp_path):
    scene = Scene()
    corner = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    for mode, order in ((5, [0, 1, 2, 3]), (6, [0, 1, 3, 2]), (4, [0, 1, 2, 2, 1, 3])):
        primitive = {"attributes": {"POSITION": scene.accessor(np.array(corner, float)[order])}, "mode": mode}
        scene.node(scene.append("meshes", {"primitives": [primitive]}))
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "z")
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    np.testing.assert_allclose(np.cross(b - a, c - a), np.tile([0, 0, 1], (6, 1)))


def test_interleaved_and_sparse_data(tmp_path):
    scene = Scene()
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32)
    rows = np.concatenate([vertices, np.full((4, 2), 9, np.float32)], 1)
    view = scene.view(rows.tobytes(), byteStride=20)
    accessor = {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"}
    sparse = {
        "count": 1,
        "indices": {"bufferView": scene.view(np.uint16([3]).tobytes()), "componentType": 5123},
        "values": {"bufferView": scene.view(np.float32([0, 0, 7]).tobytes())},
    }
    index = scene.append("accessors", {**accessor, "sparse": sparse})
    scene.node(scene.mesh(index, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    mesh = load_mesh(scene.write(tmp_path / "s.gltf"), "z")
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 7]])


def test_faces_without_texture_area_are_counted(tmp_path):
    scene = Scene()
    material = scene.material(scene.texture(checker(FOUR, 16)))
    point, nan = np.full((4, 2), 0.25), np.full((4, 2), np.nan)
    scene.quads(0, material, [square(0.25, 0.25, 0.1), point, nan, square(1.25, 0.25, 0.1)])
    report = appearance_report(load_mesh(scene.write(tmp_path / "s.gltf"), "y"))
    assert report["uv_degenerate_fraction"] == 0.25
    assert report["uv_not_finite_fraction"] == 0.25
    assert report["uv_outside_fraction"] == 0.25


def test_baking_gives_the_same_bytes_again(tmp_path):
    scene = Scene()
    for x in range(30):  # equal sizes: their order in the texture must not depend on the machine
        scene.quads(
            x, scene.material(scene.texture(checker([[[x, 8 * x, 255 - x]]], 40))), [square(0.5, 0.5, 0.9)]
        )
    path = scene.write(tmp_path / "s.gltf")
    for name in ("a.glb", "b.glb"):
        load_mesh(path, "y", 200).write_glb(tmp_path / name)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert_colors([load_mesh(tmp_path / "a.glb", "y")], [[x, 8 * x, 255 - x] for x in range(30)])


def test_hundreds_of_materials_fit_one_texture(tmp_path):
    scene = Scene()
    colors = np.random.default_rng(4).integers(0, 256, (300, 3))
    for x, color in enumerate(colors):
        if x % 2:
            scene.quads(
                x, scene.material(scene.texture(checker([[color]], 8 + x % 7))), [square(0.5, 0.5, 0.8)]
            )
        else:
            scene.quads(x, scene.material(baseColorFactor=[*linear(color), 1]))
    meshes = loaded_twice(scene, tmp_path, texture_size=256)
    assert_colors(meshes, colors)
    refused("300 materials do not fit one texture of 64 texels", load_mesh, tmp_path / "scene.gltf", "y", 64)


def test_an_object_without_colour_keeps_its_surface(tmp_path):
    vertices, faces = box((1, 2, 3))
    TexturedMesh(vertices, faces, roughness=0.25, metallic=0.5).write_glb(tmp_path / "m.glb")
    back = load_mesh(tmp_path / "m.glb", "y")
    assert (back.roughness, back.metallic) == (0.25, 0.5)
    np.testing.assert_allclose(back.texture, 255 * srgb.encode(np.full((1, 1, 3), PLAIN)), atol=1)


def broken(change):
    scene = Scene()
    scene.quads(0, scene.material(scene.texture(checker(FOUR, 4))), four_squares())
    change(scene.document, scene)
    return scene


def cut(document, scene):
    document["accessors"][0]["count"] = 10**9


def cycle(document, scene):
    document["nodes"][0]["children"] = [0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d, s: d.update(extensionsRequired=["KHR_draco_mesh_compression"]),
            "KHR_draco_mesh_compression",
        ),
        (
            lambda d, s: d["images"].__setitem__(0, {"uri": "gone%20away.png"}),
            r"gone away\.png, which does not",
        ),
        (lambda d, s: d["images"].__setitem__(0, {"uri": "../x.png"}), r"\.\./x\.png, outside its folder"),
        (
            lambda d, s: d["images"].__setitem__(0, {"uri": "data:image/png;base64,AAAA"}),
            "texture image 0 cannot be read",
        ),
        (lambda d, s: d["textures"][0].update(source=None), "texture 0 has no image"),
        (cut, "reaches beyond the end of buffer view"),
        (
            lambda d, s: d["meshes"][0]["primitives"][0]["attributes"].update(
                COLOR_0=s.accessor(np.ones((16, 2)))
            ),
            "has 2 columns, expected 3 or 4",
        ),
        (cycle, "node 0 has two parents, expected one; export it again"),
        (lambda d, s: d["asset"].update(version="1.0"), "glTF version 1.0, expected 2.0"),
        (lambda d, s: d.update(accessors=7), "not valid glTF"),
        (lambda d, s: d["meshes"][0]["primitives"][0].update(mode=0), "holds no faces"),
        (
            lambda d, s: (
                s.accessor([0, 1, 99], "u4")
                and d["meshes"][0]["primitives"][0].update(indices=len(d["accessors"]) - 1)
            ),
            "use vertices 0 to 99, but there are 16",
        ),
    ],
)
def test_a_broken_document_is_refused_by_name(tmp_path, change, message):
    path = broken(change).write(tmp_path / "scene.gltf")
    caught = refused(message, load_mesh, path)
    assert str(path) in caught


def test_a_missing_or_short_buffer_is_named(tmp_path):
    path = broken(lambda d, s: None).write(tmp_path / "scene.gltf")
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = "data.bin"
    path.write_text(json.dumps(document))
    refused(r"scene\.gltf refers to .*data\.bin, which does not exist", load_mesh, path)
    (tmp_path / "data.bin").write_bytes(b"\0" * 100)
    refused(r"data\.bin holds 100 bytes, expected \d+; it may be cut off: copy or export", load_mesh, path)


def test_a_glb_that_breaks_off_is_refused_at_every_length(tmp_path):
    scene = broken(lambda d, s: None)
    load_mesh(scene.write(tmp_path / "scene.gltf")).write_glb(tmp_path / "whole.glb")
    whole = (tmp_path / "whole.glb").read_bytes()
    for length in range(0, len(whole), max(len(whole) // 60, 1)):
        (tmp_path / "cut.glb").write_bytes(whole[:length])
        refused(r"cut\.glb cannot be read", load_mesh, tmp_path / "cut.glb")


def box_scene(**node):
    scene = Scene()
    vertices, faces = box((1, 2, 3))
    material = scene.append("materials", {"extensions": {"KHR_materials_unlit": {}}})
    primitive = {
        "attributes": {"POSITION": scene.accessor(vertices)},
        "indices": scene.accessor(faces.ravel(), "u4"),
        "material": material,
    }
    mesh = scene.append("meshes", {"primitives": [primitive]})
    scene.document["scenes"][0]["nodes"] = [scene.append("nodes", {"mesh": mesh, **node})]
    return scene


def test_a_rotation_that_is_no_unit_quaternion_keeps_the_shape(tmp_path):
    mesh = load_mesh(box_scene(rotation=[1, 0, 0, 1]).write(tmp_path / "m.gltf"))
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0).ravel(), [1, 3, 2], atol=1e-6)


def test_an_unlit_material_states_neither_roughness_nor_metallic(tmp_path):
    mesh = load_mesh(box_scene().write(tmp_path / "m.gltf"))
    assert (mesh.roughness, mesh.metallic) == (None, None)


def test_copies_of_no_place_are_one(tmp_path):
    scene = box_scene(extensions={"EXT_mesh_gpu_instancing": {"attributes": {}}})
    assert len(load_mesh(scene.write(tmp_path / "m.gltf")).faces) == 12


def test_an_empty_list_of_scenes_shows_all_nodes(tmp_path):
    scene = box_scene()
    scene.document["scenes"] = []
    assert len(load_mesh(scene.write(tmp_path / "m.gltf")).faces) == 12
