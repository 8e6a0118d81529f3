import manifold3d
import numpy as np
import pytest
import trimesh
from solids import box, flipped, join, sphere

from objectfolder.mesh.closing.holes import cap, close_piece, thicken
from objectfolder.mesh.closing.solids import to_arrays
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.topology import boundary_loops, compact, face_areas, is_closed, signed_volume

WALL = 0.02


def cylinder(radius, height, sides=64):
    mesh = trimesh.creation.cylinder(radius, height, sections=sides).subdivide().subdivide()
    return np.array(mesh.vertices), np.array(mesh.faces, np.int64)


def without(solid, chosen):
    vertices, faces = solid
    return vertices, faces[~chosen(vertices[faces].mean(1))]


def close(piece, around=None):
    return close_piece(piece, RayCaster(*(piece if around is None else join(piece, around))), WALL)


def shell(outer, inner):
    return 4 / 3 * np.pi * (outer**3 - inner**3)


@pytest.mark.parametrize("inside_out", [False, True])
def test_an_open_hemisphere_becomes_a_bowl_that_keeps_its_outside(inside_out):
    piece = without(sphere(0.5, 5), lambda centre: centre[:, 2] > 0)
    (vertices, faces), capped, openings = close(flipped(piece) if inside_out else piece)
    assert (capped, openings) == (0, 1)
    assert is_closed(faces)
    assert signed_volume(vertices, faces) == pytest.approx(shell(0.5, 0.48) / 2, rel=0.01)
    assert np.linalg.norm(vertices, axis=1).max() == pytest.approx(0.5)
    assert np.linalg.norm(vertices, axis=1).min() == pytest.approx(0.48, abs=1e-3)


def test_a_tube_gets_a_wall_and_stays_open():
    (vertices, faces), capped, openings = close(
        without(cylinder(0.2, 1), lambda centre: np.abs(centre[:, 2]) > 0.499)
    )
    assert (capped, openings) == (0, 2)
    ring = 64 / 2 * np.sin(2 * np.pi / 64)  # area of the polygon in a unit circle
    assert signed_volume(vertices, faces) == pytest.approx(ring * (0.2**2 - 0.18**2), rel=2e-3)


def test_creases_keep_the_wall_s_thickness():
    piece = without(cylinder(0.2, 1), lambda centre: centre[:, 2] > 0.499)
    (vertices, faces), _, _ = close(piece)
    ring = 64 / 2 * np.sin(2 * np.pi / 64)
    expected = ring * (0.2**2 - 0.18**2 * 0.98)
    assert signed_volume(vertices, faces) == pytest.approx(expected, rel=0.01)


def test_a_flat_sheet_becomes_a_plate():
    mesh = trimesh.creation.box((1, 0.5, 1)).subdivide().subdivide()
    sheet = mesh.submesh([np.flatnonzero(mesh.triangles_center[:, 1] > 0.2499)], append=True)
    (vertices, faces), _, openings = close((np.array(sheet.vertices), np.array(sheet.faces, np.int64)))
    assert openings == 1
    assert is_closed(faces)
    assert signed_volume(vertices, faces) == pytest.approx(WALL)


def test_a_leg_without_a_bottom_is_capped_because_its_hole_is_small():
    leg = without(cylinder(0.02, 1), lambda centre: centre[:, 2] < -0.499)
    (vertices, faces), capped, openings = close(leg)
    assert (capped, openings) == (1, 0)
    assert signed_volume(vertices, faces) == pytest.approx(signed_volume(*cylinder(0.02, 1)))


def test_a_large_hole_that_another_piece_hides_is_capped():
    lid = box((0.8, 0.8, 0.1), (0, 0, 0.55))
    bottomless = without(box((0.5, 0.5, 1)), lambda centre: centre[:, 2] > 0.49)
    assert close(bottomless)[1:] == (0, 1)
    (vertices, faces), capped, openings = close(bottomless, around=lid)
    assert (capped, openings) == (1, 0)
    assert signed_volume(vertices, faces) == pytest.approx(0.25)


def test_pinholes_of_a_sheet_are_capped_and_its_mouth_is_not():
    rng = np.random.default_rng(0)
    piece = without(sphere(0.5, 4), lambda c: (c[:, 2] > 0.1) | (rng.random(len(c)) < 0.01))
    (_, faces), capped, openings = close(piece)
    assert openings == 1
    assert capped > 10
    assert is_closed(faces)


def test_a_loop_that_turns_back_is_capped_in_its_plane():
    corners = np.array([[0, 0], [1, 0], [1, 1], [0.6, 1], [0.6, 0.2], [0.4, 0.2], [0.4, 1], [0, 1.0]])
    vertices, faces = to_arrays(manifold3d.CrossSection([corners]).extrude(0.5))
    opened = faces[vertices[faces][:, :, 2].min(1) < 0.25]
    closed = cap(vertices, opened, boundary_loops(opened))
    assert is_closed(closed[1])
    assert signed_volume(*closed) == pytest.approx(0.5 * (1 - 0.2 * 0.8))
    assert closed[0][:, 2].max() == 0.5
    assert face_areas(*closed).sum() == pytest.approx(2 * (1 - 0.16) + 0.5 * (4 + 2 * 0.8))


def test_thickening_is_inward():
    piece = compact(*without(sphere(0.5, 3), lambda centre: centre[:, 2] > 0))
    vertices, _ = thicken(*piece, 0.05)
    np.testing.assert_array_equal(vertices[: len(piece[0])], piece[0])
    assert np.linalg.norm(vertices[len(piece[0]) :], axis=1).max() < 0.5


@pytest.mark.parametrize("seed", range(8))
def test_a_flat_sheet_gets_its_wall_behind_the_side_that_its_winding_shows(seed):
    plate = trimesh.creation.box((1, 0.6, 0.2)).subdivide()
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))[:3, :3]
    vertices, faces = without(
        (np.array(plate.vertices), np.array(plate.faces, np.int64)), lambda centre: centre[:, 2] < 0.099
    )
    vertices, faces = compact(vertices, faces)
    (closed, sides), _, openings = close((vertices @ turn.T, faces))
    assert openings == 1
    heights = closed @ turn[:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((0.1 - WALL, 0.1))
    assert signed_volume(closed, sides) == pytest.approx(0.6 * WALL)


def test_a_panel_close_before_a_body_keeps_its_wall():
    """The body hides one side of the panel, not the other."""
    panel = np.array([[0.5, -0.2, -0.2], [0.5, 0.2, -0.2], [0.5, 0.2, 0.2], [0.5, -0.2, 0.2]])
    for faces in ([[0, 1, 2], [0, 2, 3]], [[0, 2, 1], [0, 3, 2]]):
        (closed, sides), _, openings = close((panel, np.array(faces)), box((0.996, 0.6, 0.6)))
        assert openings == 1
        assert signed_volume(closed, sides) == pytest.approx(0.16 * WALL)
