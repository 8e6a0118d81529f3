"""Pieces as artists model furniture: without the faces that others hide, carved, and in frames."""

import manifold3d
import numpy as np
import pytest
from solids import box, join

from objectfolder.mesh.closing.holes import cap, close_piece, fit_wall, thicken
from objectfolder.mesh.closing.solids import to_arrays
from objectfolder.mesh.closing.surface import close_surface
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.scanline import MAX_OUTSIDE, winding_certificate
from objectfolder.mesh.topology import (
    boundary_loops,
    compact,
    distance,
    edge_defects,
    face_areas,
    is_closed,
    signed_volume,
)

WALL = 0.02


def without(solid, chosen):
    vertices, faces = solid
    return compact(vertices, faces[~chosen(vertices[faces].mean(1))])


def close(piece, around=None):
    return close_piece(piece, RayCaster(*(piece if around is None else join(piece, around))), WALL)


def bounds_solid(mesh):
    return edge_defects(mesh[1]) == (0, 0, 0) and winding_certificate(*mesh).solid


def board_with_open_ends(sides=(0.6, 0.3, 0.02), centre=(0, 0, 0)):
    """A shelf: top, bottom and front, without the back and the ends; its one hole goes around three sides."""
    half = np.array(sides) / 2
    x, y, _ = centre
    return without(
        box(sides, centre),
        lambda c: (np.abs(c[:, 0] - x) > 0.99 * half[0]) | (c[:, 1] - y > 0.99 * half[1]),
    )


def test_a_board_without_its_back_and_ends_is_the_whole_board():
    piece = board_with_open_ends()
    assert len(boundary_loops(piece[1])) == 1
    for tight in (False, True):
        mesh = cap(*piece, boundary_loops(piece[1]), tight)
        assert bounds_solid(mesh)
        assert signed_volume(*mesh) == pytest.approx(0.6 * 0.3 * 0.02)
        assert face_areas(*mesh).sum() == pytest.approx(2 * (0.6 * 0.3 + 0.9 * 0.02))


def test_a_cupboard_of_boards_without_hidden_faces_is_closed_without_a_grid():
    posts = [box((0.02, 0.3, 1), (x, 0, 0)) for x in (-0.31, 0.31)]
    shelves = [board_with_open_ends(centre=(0, 0, z)) for z in (-0.4, 0, 0.4)]
    surface = close_surface(*join(*posts, *shelves))
    assert [step.name for step in surface.repairs] == ["clean", "cap", "union"]
    assert surface.warnings == []
    assert surface.volume == pytest.approx(2 * 0.02 * 0.3 + 3 * 0.6 * 0.3 * 0.02)
    assert surface.components == 1


def frame(depth=0.05, bend=0.0):
    """A picture frame without its back, whose inner rim lies behind or before the outer one by ``bend``."""
    outline = [np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) for w, h in ((0.5, 0.4), (0.4, 0.3))]
    vertices, faces = to_arrays(manifold3d.CrossSection(outline, manifold3d.FillRule.EvenOdd).extrude(depth))
    vertices, faces = without((vertices, faces), lambda c: c[:, 2] < 1e-6)
    inner = (np.abs(vertices[:, 0]) < 0.45) & (vertices[:, 2] < 1e-6)
    vertices[inner, 2] += bend
    return vertices, faces


@pytest.mark.parametrize("bend", [0, 0.01, -0.01])
def test_the_back_of_a_frame_is_a_ring(bend):
    vertices, faces = frame(bend=bend)
    (closed, sides), capped, openings = close_piece((vertices, faces), None, WALL)
    assert (capped, openings) == (2, 0)
    assert bounds_solid((closed, sides))
    assert len(closed) == len(vertices)
    corners = closed[sides]
    lower, upper = corners.min(1), corners.max(1)
    window = (lower[:, :2] > -0.3).all(1) & (upper[:, :2] < 0.3).all(1)
    assert not window.any()
    _, hit = RayCaster(closed, sides).first_hit(np.array([[0.1, 0.1, 1]]), np.array([[0, 0, -1.0]]))
    assert hit[0] == -1  # one sees through it
    assert signed_volume(closed, sides) == pytest.approx(0.05 * (0.8 - 0.48), rel=0.25 if bend else 1e-6)


def test_a_frame_that_is_a_sheet_stays_open_inside():
    (vertices, faces), capped, openings = close(frame(depth=0.2))
    assert (capped, openings) == (0, 2)
    assert bounds_solid((vertices, faces))
    _, hit = RayCaster(vertices, faces).first_hit(np.array([[0.1, 0.1, 1]]), np.array([[0, 0, -1.0]]))
    assert hit[0] == -1
    assert vertices[:, 2].max() == pytest.approx(0.2)


def carved(depth, ridges=12):
    """A tray upside down, with ridges finer than the wall on a third of its top, open below."""
    left = np.linspace(-0.2, 0.16, ridges)
    x = np.stack([left, left, left + 0.012, left + 0.012], 1).ravel()
    z = depth + np.tile([0, 0.03, 0.03, 0], ridges)
    outline = np.concatenate([[[-0.5, 0], [-0.5, depth]], np.stack([x, z], 1), [[0.5, depth], [0.5, 0]]])
    solid = to_arrays(manifold3d.CrossSection([outline[::-1]]).extrude(0.5))
    return without((solid[0][:, [2, 0, 1]], solid[1]), lambda c: c[:, 2] < 1e-6), outline


def test_a_wall_is_thinner_where_carvings_have_no_room_for_it():
    piece, _ = carved(0.2)
    vertices, _ = piece
    assert not bounds_solid(thicken(*piece, WALL))
    thickness = fit_wall(*piece, WALL)
    assert thickness.max() == WALL
    assert 0 < thickness.min() < WALL / 2
    closed, capped, openings = close(piece)
    assert (capped, openings) == (0, 1)
    assert bounds_solid(closed)
    assert distance(closed, vertices).max() < 1e-9  # the outside is kept
    assert closed[0].max(0) == pytest.approx(vertices.max(0))
    floor = WALL * (1 * 0.5 + 2 * 0.2 * (1 + 0.5))  # of a tray without ridges
    assert 0.5 * floor < signed_volume(*closed) < 1.2 * floor


def test_a_carved_board_that_is_less_deep_than_the_wall_is_solid():
    piece, outline = carved(0.002)
    assert not bounds_solid(thicken(*piece, WALL))
    closed, capped, openings = close(piece)
    assert (capped, openings) == (1, 0)
    assert bounds_solid(closed)
    x, z = outline.T
    assert signed_volume(*closed) == pytest.approx(0.5 * np.trapezoid(z, x))


def apron():
    """A flat panel with a rib along its lower edge, wound to -x: caps lie against its flat part."""
    profile = np.array([[0, 0], [-0.01, 0.005], [-0.01, 0.01], [0, 0.015], [0, 0.1]])
    points = np.stack(
        [np.broadcast_to(profile, (2, 5, 2))[..., 0], np.array([[-0.3], [0.3]]) + np.zeros(5)], -1
    )
    vertices = np.concatenate([points, np.broadcast_to(profile[:, 1], (2, 5))[..., None]], -1).reshape(-1, 3)
    k = np.arange(4)
    return vertices, np.concatenate([np.stack([k, k + 1, k + 6], 1), np.stack([k, k + 6, k + 5], 1)])


def test_a_panel_that_caps_lie_against_gets_a_wall_behind_the_side_that_is_seen():
    vertices, faces = apron()
    far, before = box((0.1, 0.1, 0.1), (1, 0, 0)), box((0.01, 1, 1), (0.01, 0, 0))
    for sides, around, ends in (
        (faces, far, (-0.01, WALL)),
        (faces[:, ::-1], far, (-0.01 - WALL, 0)),
        (faces, before, (-0.01, WALL)),
        (faces[:, ::-1], before, (-0.01, WALL)),
    ):
        scene = RayCaster(*join((vertices, sides), around))
        closed, capped, openings = close_piece((vertices, sides), scene, WALL, np.inf)
        assert (capped, openings) == (0, 1)
        assert bounds_solid(closed)
        assert (closed[0][:, 0].min(), closed[0][:, 0].max()) == pytest.approx(ends, abs=1e-3)
        assert signed_volume(*closed) == pytest.approx(WALL * 0.6 * 0.1, rel=0.25)
    scene = RayCaster(*join((vertices, faces), before, box((0.01, 1, 1), (-0.02, 0, 0))))
    hidden = close_piece((vertices, faces), scene, WALL, np.inf)
    assert hidden[1:] == (1, 0)
    assert abs(signed_volume(*hidden[0])) < 0.1 * WALL * 0.6 * 0.1


def drawer():
    """A block with a rectangular hole in its front face, at x = 0.2, and a panel 0.05 behind."""
    block = to_arrays(
        manifold3d.Manifold.cube((0.4, 0.6, 0.4), True)
        - manifold3d.Manifold.cube((0.1, 0.3, 0.2), True).translate((0.2, 0, 0))
    )
    block = without(block, lambda c: (np.abs(c[:, 1]) < 0.151) & (np.abs(c[:, 2]) < 0.101) & (c[:, 0] > 0.1))
    panel = np.array([[0.15, -0.2, -0.15], [0.15, 0.2, -0.15], [0.15, 0.2, 0.15], [0.15, -0.2, 0.15]])
    return block, (panel, np.array([[0, 1, 2], [0, 2, 3]]))


def test_a_hole_before_a_panel_is_a_recess_and_another_is_flush():
    block, panel = drawer()
    front = np.array([[1, 0.05, 0.05]]), np.array([[-1.0, 0, 0]])
    for parts, depth in (((block, panel), 0.05), ((block,), 0)):
        surface = close_surface(*join(*parts))
        assert surface.certificate.solid
        reached, _ = RayCaster(*surface.mesh).first_hit(*front)
        assert reached[0] == pytest.approx(1 - 0.2 + depth, abs=1e-3)
        assert surface.volume == pytest.approx(0.4 * 0.6 * 0.4 - depth * 0.3 * 0.2, rel=0.01)


def test_overlap_is_less_than_what_is_accepted():
    for piece in (carved(0.2)[0], carved(0.002)[0], frame(), frame(depth=0.2), board_with_open_ends()):
        closed, _, _ = close(piece)
        assert is_closed(closed[1])
        assert winding_certificate(*closed).outside_fraction <= MAX_OUTSIDE
