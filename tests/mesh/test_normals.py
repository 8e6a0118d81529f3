import numpy as np
import pytest
from gltf_scene import Scene
from solids import box, sphere

from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.normals import (
    area_vectors,
    average_normals,
    crease_normals,
    replace_bad_normals,
    split_vertices,
    unit_vectors,
)
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.textured import TexturedMesh, appearance_report
from objectfolder.shapes import GENERATORS, generate

WHOLE = np.s_[:]


def ball(level=2, **appearance):
    """A sphere with the normals of the true one."""
    vertices, faces = sphere(0.5, level)
    return TexturedMesh(vertices, faces, normals=unit_vectors(vertices), **appearance)


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(np.sum(a * b, -1), -1, 1)))


def corner_normals(mesh):
    return mesh.normals[mesh.faces]


def against_faces(mesh):
    """Whether each corner's normal points to the inner side of its face."""
    return np.einsum("fkc,fc->fk", corner_normals(mesh), area_vectors(mesh.vertices, mesh.faces)) <= 0


def test_smooth_normals_of_a_sphere_converge_to_the_true_ones():
    errors = []
    for level in (2, 3, 4):
        vertices, faces = sphere(0.5, level)
        errors.append(degrees(crease_normals(vertices, faces), unit_vectors(vertices)[faces]).max())
    assert errors[-1] < 0.5
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2, rtol=0.25)


def test_averaged_normals_are_means_with_the_neighbours():
    """On a tetrahedron everyone is everyone's neighbour; beside a flat face there is nothing to average."""
    faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    normals = unit_vectors(np.random.default_rng(0).normal(size=(4, 3)))
    np.testing.assert_array_equal(average_normals(normals, faces, 0), normals)
    np.testing.assert_allclose(
        average_normals(normals, faces, 1), np.tile(unit_vectors(normals.mean(0)), (4, 1))
    )
    up = np.tile([0.0, 0, 1], (4, 1))
    np.testing.assert_allclose(average_normals(up, faces, 3), up)


def test_a_box_keeps_its_edges_and_a_cylinder_its_rims():
    vertices, faces = box((1, 2, 3))
    flat = unit_vectors(area_vectors(vertices, faces))
    np.testing.assert_array_equal(crease_normals(vertices, faces), flat[:, None].repeat(3, 1))
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(around), np.sin(around)], 1)
    vertices = np.concatenate([np.c_[ring, np.zeros(24)], np.c_[ring, np.ones(24)], [[0, 0, 1.0]]])
    i, j = np.arange(24), (np.arange(24) + 1) % 24
    side = np.concatenate([np.stack([i, j, j + 24], 1), np.stack([i, j + 24, i + 24], 1)])
    top = np.stack([i + 24, j + 24, np.full(24, 48)], 1)
    normals = crease_normals(vertices, np.concatenate([side, top]))
    np.testing.assert_array_equal(normals[48:], np.broadcast_to([0.0, 0, 1], (24, 3, 3)))
    radial = vertices[side] * [1, 1, 0]
    assert degrees(normals[:48], radial).max() < 4  # half of the angle between sides is 7.5


def test_the_creases_of_a_mesh_do_not_depend_on_its_texture_seams():
    vertices, faces = sphere(0.5, 2)
    apart = vertices[faces].reshape(-1, 3)
    cut = crease_normals(apart, np.arange(len(apart)).reshape(-1, 3))
    np.testing.assert_allclose(cut, crease_normals(vertices, faces), atol=1e-12)


def test_a_face_without_area_gets_a_unit_normal():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2.0, 0, 0]])
    normals = crease_normals(vertices, np.array([[0, 1, 2], [0, 1, 3], [3, 3, 3]]))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1)


def test_copies_for_creases_follow_the_vertices_and_keep_every_corner():
    vertices, faces = box((1, 2, 3))
    corners = crease_normals(vertices, faces)
    vertex, split_faces, normals = split_vertices(faces, corners, len(vertices))
    np.testing.assert_array_equal(vertex[:8], np.arange(8))
    assert len(vertex) == 24  # three sides meet in each corner
    np.testing.assert_array_equal(vertex[split_faces], faces)
    np.testing.assert_array_equal(normals[split_faces], corners)


def test_smoothing_keeps_what_belongs_to_the_vertices():
    vertices, faces = box((1, 2, 3))
    uv, colors = vertices[:, :2], np.arange(24, dtype=np.uint8).reshape(8, 3)
    mesh = TexturedMesh(vertices, faces, uv, np.zeros((2, 2, 3), np.uint8), colors).with_smooth_normals()
    for before, after in ((vertices, mesh.vertices), (uv, mesh.uv), (colors, mesh.vertex_colors)):
        np.testing.assert_array_equal(after[mesh.faces], before[faces])


@pytest.mark.parametrize("bad", [[0, 0, 0], [np.inf, 0, 1], "against"])
def test_a_bad_normal_gives_way_to_its_faces(bad):
    mesh = ball()
    normals = 3 * mesh.normals
    normals[7] = -normals[7] if bad == "against" else bad
    corners, fraction = replace_bad_normals(mesh.vertices, mesh.faces, normals)
    hit = mesh.faces == 7
    assert fraction == pytest.approx(hit.mean())
    np.testing.assert_allclose(corners[~hit], corner_normals(mesh)[~hit])
    flat = unit_vectors(area_vectors(mesh.vertices, mesh.faces))[:, None].repeat(3, 1)
    np.testing.assert_allclose(corners[hit], flat[hit])


def test_normals_that_mostly_point_inwards_are_left_out(tmp_path):
    mesh = ball()
    corners, fraction = replace_bad_normals(mesh.vertices, mesh.faces, -mesh.normals)
    assert corners is None
    assert fraction == 1
    TexturedMesh(mesh.vertices, mesh.faces, normals=-mesh.normals).write_glb(tmp_path / "m.glb")
    report = appearance_report(load_mesh(tmp_path / "m.glb", "y"))
    assert report["vertex_normals"] is False
    assert report["normals_bad_fraction"] == 1
    assert "vertex normals left out: 100% of them" in report["notes"][0]


def test_a_glb_keeps_its_normals_and_stays_z_up(tmp_path):
    mesh = ball()
    mesh.write_glb(tmp_path / "m.glb")
    back = load_mesh(tmp_path / "m.glb", "y")
    np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_allclose(back.normals, mesh.normals, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(back.normals, axis=1), 1, atol=1e-12)
    assert appearance_report(back)["vertex_normals"] is True
    as_it_is = load_mesh(tmp_path / "m.glb", "z")
    np.testing.assert_allclose(as_it_is.normals, unit_vectors(as_it_is.vertices), atol=1e-6)


def test_a_mesh_without_normals_has_none_after_loading(tmp_path):
    vertices, faces = box((1, 1, 1))
    TexturedMesh(vertices, faces).write_glb(tmp_path / "m.glb")
    assert b"NORMAL" not in (tmp_path / "m.glb").read_bytes()
    assert load_mesh(tmp_path / "m.glb", "y").normals is None
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices)
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    (tmp_path / "m.obj").write_text(text)
    mesh = load_mesh(tmp_path / "m.obj")
    assert mesh.normals is None
    assert appearance_report(mesh)["vertex_normals"] is False


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 0.5, 1), (-1, 1, 1), (-2, -0.5, -1)])
def test_nodes_place_normals_as_they_place_surfaces(tmp_path, scale):
    """The normals of an ellipsoid are the gradient of its equation, also of a mirrored one."""
    mesh, scene = ball(3), Scene()
    half = np.sqrt(0.5)
    placed = {"rotation": [half, 0, 0, half], "scale": list(scale), "translation": [5, 6, 7]}
    scene.node(scene.mesh(mesh.vertices, mesh.faces, NORMAL=mesh.normals), **placed)
    loaded = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    local = (loaded.vertices - [5, 6, 7]) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # turned back
    expected = unit_vectors(local / np.square(scale)) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    np.testing.assert_allclose(loaded.normals, expected, atol=1e-5)
    assert loaded.source["normals_bad_fraction"] == 0
    assert not against_faces(loaded).any()


def test_quantized_normals_are_read(tmp_path):
    mesh, scene = ball(), Scene()
    scene.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    padded = np.pad(np.round(mesh.normals * 127), ((0, 0), (0, 1)))
    view = scene.view(padded.astype("<i1").tobytes(), byteStride=4)
    accessor = {"bufferView": view, "componentType": 5120, "normalized": True, "type": "VEC3"}
    normals = scene.append("accessors", {**accessor, "count": len(padded)})
    scene.node(scene.mesh(mesh.vertices, mesh.faces, NORMAL=normals))
    loaded = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    assert degrees(loaded.normals, mesh.normals).max() < 1


def test_parts_without_normals_stay_flat_beside_others(tmp_path):
    mesh, scene = ball(), Scene()
    scene.node(scene.mesh(mesh.vertices, mesh.faces, NORMAL=mesh.normals))
    scene.node(scene.mesh(mesh.vertices, mesh.faces), translation=[3, 0, 0])
    loaded = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    smooth, flat = np.split(corner_normals(loaded), 2)
    np.testing.assert_allclose(smooth, corner_normals(mesh), atol=1e-6)
    faces = unit_vectors(area_vectors(mesh.vertices, mesh.faces))
    np.testing.assert_allclose(flat, faces[:, None].repeat(3, 1), atol=1e-5)
    assert loaded.source["normals_bad_fraction"] == 0


def test_baking_several_materials_keeps_normals(tmp_path):
    mesh, scene = ball(), Scene()
    image = scene.texture(np.full((8, 8, 3), 100))
    uv = np.float32(3 * mesh.vertices[:, :2])  # repeats, so that vertices are copied
    colors = np.float32(0.5 + mesh.vertices)
    scene.node(
        scene.mesh(mesh.vertices, mesh.faces, scene.material(image), NORMAL=mesh.normals, TEXCOORD_0=uv)
    )
    scene.node(scene.mesh(mesh.vertices, mesh.faces, NORMAL=mesh.normals, COLOR_0=colors))
    loaded = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    assert "materials baked" in loaded.source["notes"][-1]
    for half in np.split(corner_normals(loaded), 2):
        np.testing.assert_allclose(half, corner_normals(mesh), atol=1e-6)


def test_obj_normals_come_by_corner(tmp_path):
    (tmp_path / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 2\nvn 0.6 0 0.8\nvn 0 1 0\n"
        "f 1//1 2//2 3//1\nf 1//3 4//3 2//3\n"
    )
    mesh = load_mesh(tmp_path / "m.obj")
    up, aside, side = [0, 0, 1], [0.6, 0, 0.8], [0, 1, 0]
    np.testing.assert_allclose(corner_normals(mesh), [[up, aside, up], [side, side, side]])
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[1]], [[0, 0, 0], [0, 0, 1], [1, 0, 0]])


def test_ply_normals_are_kept_also_beside_face_colours(tmp_path):
    mesh = ball()
    for colored in (False, True):
        lines = [*(" ".join(map(str, [*v, *n])) for v, n in zip(mesh.vertices, mesh.normals))]
        shade = [f" {i % 256} 0 0" if colored else "" for i in range(len(mesh.faces))]
        lines += [f"3 {a} {b} {c}{s}" for (a, b, c), s in zip(mesh.faces, shade)]
        header = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
        header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
        header += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
        header += [f"property uchar {name}" for name in ("red", "green", "blue") if colored]
        (tmp_path / "m.ply").write_text("\n".join([*header, "end_header", *lines]) + "\n")
        loaded = load_mesh(tmp_path / "m.ply")
        np.testing.assert_allclose(corner_normals(loaded), corner_normals(mesh), atol=1e-6)
        assert (loaded.vertex_colors is not None) == colored


def test_the_closed_surface_does_not_depend_on_normals(tmp_path):
    """Bad ones give their faces copies of vertices, which welding undoes."""
    mesh = ball(3)
    given = mesh.normals.copy()
    given[::9] *= -1
    surfaces = []
    for normals in (None, mesh.normals, given):
        TexturedMesh(mesh.vertices, mesh.faces, normals=normals).write_glb(tmp_path / "m.glb")
        loaded = load_mesh(tmp_path / "m.glb", "y")
        surfaces.append((len(loaded.vertices), normalize(loaded).surface.mesh))
    assert surfaces[2][0] > surfaces[1][0] == surfaces[0][0]
    for _, (vertices, faces) in surfaces[1:]:
        assert vertices.tobytes() == surfaces[0][1][0].tobytes()
        assert faces.tobytes() == surfaces[0][1][1].tobytes()


@pytest.mark.parametrize("generator", ["mug", "block", "teapot"])
def test_generated_objects_have_normals_that_no_loading_changes(generator, tmp_path):
    mesh = generate(generator, texture_size=256)
    bare = GENERATORS[generator](texture_size=256)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], bare.vertices[bare.faces])
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1)
    mesh.write_glb(tmp_path / "m.glb")
    back = load_mesh(tmp_path / "m.glb", "y")
    assert back.source["normals_bad_fraction"] < 1e-3
    assert degrees(corner_normals(mesh), corner_normals(back)).max() < (0.1 if generator != "teapot" else 90)
