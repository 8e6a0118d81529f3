from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest
import trimesh
from brick import without
from refusals import refused
from solids import box, flipped, join, sphere

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim import hulls as module
from objectfolder.sim.hulls import MAX_VERTICES, cached_hulls, convex_hulls, read_hulls, write_hulls
from objectfolder.sim.solid import close_holes, simplify

SIDES = (1.0, 0.6, 0.3)


def mesh_of(solid):
    return trimesh.Trimesh(*solid, process=False)


def bracket():
    """An L of two bricks of 1 x 1 x 0.4 and 0.4 x 1 x 1.6, 1.04 in volume."""
    outline = np.array([[0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 2], [0, 2]])
    vertices = np.array([[x, y, z] for y in (0, 1) for x, z in outline])
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]])
    sides = [[[a, b, a + 6], [b, b + 6, a + 6]] for a, b in zip(range(6), [1, 2, 3, 4, 5, 0])]
    faces = np.concatenate([cap, cap[:, ::-1] + 6, np.array(sides).reshape(-1, 3)[:, ::-1]])
    return trimesh.Trimesh(vertices, faces, process=False)


def test_box_is_its_own_hull():
    (hull,) = convex_hulls(mesh_of(box(SIDES, centre=(3, 4, 5))))
    assert len(hull.vertices) == 8
    assert hull.volume == pytest.approx(np.prod(SIDES), rel=1e-6)
    np.testing.assert_allclose(hull.bounds, [[2.5, 3.7, 4.85], [3.5, 4.3, 5.15]], atol=1e-6)


def test_bracket_is_cut_at_its_concavity():
    solid = bracket()
    assert solid.is_watertight
    assert solid.volume == pytest.approx(1.04)
    hulls = convex_hulls(solid)
    assert len(hulls) == 2
    assert sum(hull.volume for hull in hulls) == pytest.approx(1.04, rel=0.02)  # its convex hull: 1.52
    np.testing.assert_allclose(
        [np.min([h.bounds[0] for h in hulls], 0), np.max([h.bounds[1] for h in hulls], 0)],
        solid.bounds,
        atol=1e-4,
    )
    (whole,) = convex_hulls(solid, max_hulls=1)
    assert whole.volume == pytest.approx(1.52, rel=0.01)


def test_cavity_is_filled():
    hollow = mesh_of(join(box(SIDES), flipped(box((0.9, 0.5, 0.2)))))
    assert hollow.volume == pytest.approx(0.18 - 0.09)
    (hull,) = convex_hulls(hollow)
    assert hull.volume == pytest.approx(0.18, rel=1e-6)


@pytest.mark.parametrize("faces", [box(SIDES)[1][:, ::-1], box(SIDES)[1][:1], box(SIDES)[1][[0, 0, 1]]])
def test_surface_that_encloses_nothing_is_refused(faces):
    with pytest.raises(
        ObjectFolderError, match=f"a mesh of {len(faces)} faces has no hulls: expected a closed"
    ):
        convex_hulls(trimesh.Trimesh(box(SIDES)[0], faces, process=False))


def test_round_hull_has_few_vertices_and_stays_inside():
    ball = mesh_of(sphere(1.0, 4))
    (hull,) = convex_hulls(ball)
    assert len(hull.vertices) <= MAX_VERTICES < len(ball.vertices)
    assert np.linalg.norm(hull.vertices, axis=1).max() <= 1 + 1e-9
    # A vertex's share of the sphere is a cap of height 1 / 64; the furthest first is at most twice as wide.
    depth = 1 - (hull.triangles[:, 0] * hull.face_normals).sum(1)
    assert depth.max() < 4 / 64


def test_the_same_mesh_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_hulls(tmp_path / f"{name}.npz", convex_hulls(bracket()))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_no_hulls_and_no_mesh_are_refused():
    refused("max_hulls is 0, expected at least 1", convex_hulls, bracket(), max_hulls=0)


@pytest.mark.parametrize("library", ["coacd", "manifold3d"])
def test_missing_library_is_named(library, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, library, None)
    refused(f"{library} is not installed; .* extra rl", convex_hulls, bracket())


def test_a_cache_without_coacd_names_the_library(brick, tmp_path, monkeypatch):
    def absent(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(module, "version", absent)
    refused(r"coacd is not installed; .* extra rl", cached_hulls, brick, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_hulls_are_read_as_they_were_written(tmp_path):
    hulls = mesh_of(box(SIDES)), mesh_of(sphere(0.1, 1, centre=(1, 2, 3)))
    write_hulls(tmp_path / "x.npz", hulls)
    for read, written in zip(read_hulls(tmp_path / "x.npz"), hulls, strict=True):
        np.testing.assert_array_equal(read.vertices, written.vertices)
        np.testing.assert_array_equal(read.faces, written.faces)


def dented(vertices):
    return np.r_[vertices[:8], [0.8 * np.array([2, 0, 0]) + 0.2 * vertices[8]], vertices[9:]]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"faces": lambda f: f[:-1], "face_counts": lambda n: n - [0, 1]}, "hull 1 is not a closed surface"),
        ({"vertices": dented}, "hull 1 is not convex"),
        ({"faces": lambda f: f[:, ::-1]}, "hull 0 is not a closed surface oriented outward"),
        ({"vertices": lambda v: np.r_[v[:9], v[9:] * np.nan]}, "hull 1 has vertices that are not finite"),
        ({"faces": lambda f: np.r_[f[:-1], [[8, 0, 1]]]}, "hull 1 has faces with missing vertices"),
        ({"vertex_counts": lambda n: np.add(n, [1, 0])}, "does not hold as many hulls as it counts"),
        ({"face_counts": lambda n: np.add(n, [24, -24])}, "does not hold as many hulls as it counts"),
        ({"face_counts": lambda n: n.astype(float)}, "does not hold as many hulls as it counts"),
    ],
)
def test_damaged_hulls_are_named(tmp_path, spoil, message):
    path = tmp_path / "x.npz"
    write_hulls(path, [mesh_of(box(SIDES)), mesh_of(box(SIDES, centre=(2, 0, 0)))])
    arrays = dict(read_npz(path))
    write_npz(path, **arrays | {name: change(arrays[name]) for name, change in spoil.items()})
    refused(f"{path}:? {message}.*; delete it to compute", read_hulls, path)


def test_truncated_hulls_are_named(tmp_path):
    write_hulls(tmp_path / "x.npz", [mesh_of(box(SIDES))])
    (tmp_path / "x.npz").write_bytes((tmp_path / "x.npz").read_bytes()[:-40])
    refused(r"x\.npz is damaged .*; delete it and rebuild", read_hulls, tmp_path / "x.npz")


def test_hulls_are_made_once_for_each_setting(brick, tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(
        module, "convex_hulls", lambda mesh, count: made.append(count) or (mesh_of(box(SIDES)),)
    )
    for count in (16, 16, 2, 2):
        (hull,) = cached_hulls(brick, tmp_path, count)
        assert hull.volume == pytest.approx(np.prod(SIDES))
    assert made == [16, 2]


def test_object_without_geometry_has_no_hulls(brick, tmp_path):
    refused("brick: the file holds no geometry", cached_hulls, without(brick, "geometry"), tmp_path)


def test_missing_triangles_are_put_back():
    vertices, faces = sphere(1.0, 2)
    # Triangles without a common vertex.
    apart = [k for k in range(1, len(faces)) if not set(faces[k]) & set(faces[0])][-1]
    closed = close_holes(trimesh.Trimesh(vertices, np.delete(faces, [0, apart], 0), process=False))
    assert {tuple(sorted(f)) for f in closed.faces.tolist()} == {tuple(sorted(f)) for f in faces.tolist()}
    assert closed.is_winding_consistent
    assert closed.volume == pytest.approx(mesh_of((vertices, faces)).volume)
    assert close_holes(closed) is closed


def test_flat_hole_is_closed_flat():
    vertices, faces = box((1, 2, 3))
    top = vertices[faces][:, :, 2].min(1) > 0
    assert top.sum() == 2
    closed = close_holes(trimesh.Trimesh(vertices, faces[~top], process=False))
    assert closed.is_watertight
    assert closed.volume == pytest.approx(6)
    assert closed.area == pytest.approx(22)


def test_simplified_surface_has_the_shape():
    ball = mesh_of(sphere(1.0, 5))
    (light,) = simplify(ball, 0.01)
    assert len(light.faces) < len(ball.faces) / 10
    assert np.abs(np.linalg.norm(light.triangles_center, axis=1) - 1).max() < 0.02
