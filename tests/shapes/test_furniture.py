from typing import Any

import numpy as np
import pytest
from assembled import crossings, welded
from procedural_cases import SMALL
from refusals import refused

from objectfolder.mesh.normalize import normalize
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, frame, union
from objectfolder.shapes.extrusion import (
    area,
    extrude_y,
    inset,
    polygon,
    prism,
    rectangle,
    round_corners,
    triangulate,
)
from objectfolder.shapes.furniture import shelf, shelf_levels, stool, table
from objectfolder.shapes.sweep import bar


def test_a_board_of_another_seed_is_another_piece_of_wood():
    one, other = (stool(seed=seed, texture_size=SMALL) for seed in (0, 1))
    assert np.array_equal(one.vertices, other.vertices)
    assert np.mean(one.texture != other.texture) > 0.5


def test_rounded_square_has_arcs_in_its_corners():
    side, radius = 0.2, 0.05
    outline = round_corners(rectangle(side, side), radius)
    circle = area(polygon(32, radius))
    assert area(outline) == pytest.approx(side**2 - (2 * radius) ** 2 + circle, rel=1e-5)
    np.testing.assert_allclose(np.abs(outline).max(0), side / 2, atol=1e-9)


def test_plate_across_stands_upright_between_its_faces():
    low, high = np.reshape(extrude_y([rectangle(0.3, 0.2)], 0.05, 0.1).bounding_box(), (2, 3))
    np.testing.assert_allclose(high, [0.15, 0.025, 0.1], atol=1e-12)
    np.testing.assert_allclose(low, -high, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 3])
def test_prism_has_the_volume_of_its_rounded_edges(steps):
    length, width, height, bevel = 0.3, 0.2, 0.05, 0.01
    plate = prism([rectangle(length, width)], height, 0.02, bevel, steps)

    def section(depth):
        return (length - 2 * depth) * (width - 2 * depth)

    turn = np.linspace(0, np.pi / 2, steps + 1)
    depth, rise = bevel * (1 - np.sin(turn)), bevel * (1 - np.cos(turn))
    # Simpson's rule is exact: sections are quadratic in height.
    middle = (depth[1:] + depth[:-1]) / 2
    edges = np.sum(np.diff(rise) / 6 * (section(depth[1:]) + 4 * section(middle) + section(depth[:-1])))
    assert plate.volume() == pytest.approx(length * width * (height - 2 * bevel) + 2 * edges, rel=1e-12)


def test_prism_with_holes_has_their_genus_and_an_even_mesh():
    holes = [polygon(32, 0.03)[::-1], polygon(6, 0.02)[::-1] + np.array([0.1, 0.03])]
    rings = [rectangle(0.3, 0.2, 0.02), *holes]
    plate = prism(rings, 0.02, 0.01)
    assert plate.genus() == 2
    assert plate.volume() == pytest.approx(0.02 * sum(map(area, rings)), rel=1e-12)
    mesh = plate.to_mesh64()
    corners = np.asarray(mesh.vert_properties)[np.asarray(mesh.tri_verts, int)]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() < 1.8 * 0.01


def test_triangulation_of_a_thin_web_keeps_the_outline():
    ring = np.array([[0, 0], [1, 0], [1, 1], [0.5, 0.01], [0, 1]])  # narrower than the spacing
    inner, faces = triangulate([ring], 0.3)
    points = np.concatenate([ring, inner])
    assert sum(area(points[f]) for f in faces) == pytest.approx(area(ring), rel=1e-12)


def test_inset_moves_every_side_by_the_distance():
    moved = inset(polygon(6, 1.0), 0.1)
    assert np.linalg.norm(moved, axis=1) == pytest.approx(1 - 0.1 / np.cos(np.pi / 6))
    refused("shortest side", inset, rectangle(1, 0.1), 0.06)


def test_bar_is_a_cone_between_its_ends():
    ends = np.array([[0.1, -0.2, 0.3], [0.3, 0.4, -0.5]])
    length = np.linalg.norm(ends[1] - ends[0])
    made = bar(ends[0], ends[1], (0.04, 0.02), 0.05, 32)
    polygon = 32 / 2 * np.sin(2 * np.pi / 32)
    cone = length / 3 * polygon * (0.02**2 + 0.01**2 + 0.02 * 0.01)
    assert made.volume() == pytest.approx(cone, rel=1e-9)


def test_texture_shows_the_paint_of_each_point():
    """Everywhere on slanting and level charts, right up to the seams."""

    def paint(points):
        return 0.5 + 0.45 * np.sin(points * [7, 9, 8])

    axes = frame([0.3, 0.2, -0.9])
    plate = prism([rectangle(0.5, 0.3, 0.04)], 0.06, 0.03, 0.01)
    leg = bar((0, 0, 0.03), (0.3, 0.2, -0.87), (0.1, 0.06), 0.04)
    parts = [PaintedPart.of(plate, paint), PaintedPart.of(leg, paint, axes)]
    mesh: Any = assemble(union(parts), parts, Look("plastic", 1.0), 512)
    rng = np.random.default_rng(1)
    weights = rng.dirichlet([0.4] * 3, len(mesh.faces))[:, :, None]
    points = (weights * mesh.vertices[mesh.faces]).sum(1)
    uv = (weights * mesh.uv[mesh.faces]).sum(1) * 512 - 0.5
    low = np.floor(uv).astype(int)
    image = mesh.texture[::-1] / 255
    shown = np.zeros((len(uv), 3))
    for step in np.ndindex(2, 2):
        share = np.prod(1 - np.abs(uv - low - step), axis=1)
        column, row = np.clip(low + np.array(step), 0, 511).T
        shown += share[:, None] * image[row, column]
    assert np.abs(shown - paint(points)).max() < 0.02


@pytest.mark.parametrize("apron", [0.0, 0.09])
def test_table_has_the_volume_of_its_boards(apron):
    length, width, height, top, leg = 1.5, 0.8, 0.74, 0.032, 0.065
    mesh = table(length, width, height, top, leg, apron, taper=1.0, bevel=0, texture_size=SMALL)
    np.testing.assert_allclose(mesh.bounds, [[-0.75, -0.4, 0], [0.75, 0.4, height]], atol=1e-9)
    legs = 4 * leg**2 * (height - top)
    between = 2 * (length - 2 * 0.04 - 2 * leg) + 2 * (width - 2 * 0.04 - 2 * leg)
    aprons = between * apron * 0.34 * leg
    assert welded(mesh).volume == pytest.approx(length * width * top + legs + aprons, rel=1e-9)
    down = crossings(mesh, (0.01, 0.02, 1.0), (0, 0, -1))
    np.testing.assert_allclose(down, [1 - height, 1 - height + top], atol=1e-7)


def test_rounded_edges_take_away_less_than_their_square():
    sharp, rounded = (welded(table(bevel=bevel, texture_size=SMALL)).volume for bevel in (0.0, 0.003))
    assert sharp - 30 * 2 * 1.5 * 0.003**2 < rounded < sharp


def test_bookcase_has_the_volume_of_its_boards():
    w, d, h, t, back, bays, plinth = 0.8, 0.3, 1.2, 0.022, 0.010, 4, 0.05
    mesh = shelf(w, d, h, t, back, bays, plinth=plinth, bevel=0, texture_size=SMALL)
    levels = shelf_levels(h, t, bays, plinth)
    sides = 2 * t * d * h
    level = (bays + 1) * (w - 2 * t) * (d - 0.2 * t) * t
    panel = back * (w - 2 * t) * (levels[-1] - levels[0] - bays * t)
    assert welded(mesh).volume == pytest.approx(sides + level + panel, rel=1e-9)
    across = crossings(mesh, (-1.0, 0.0, 0.2), (1, 0, 0))
    np.testing.assert_allclose(across, np.array([-0.4, -0.4 + t, 0.4 - t, 0.4]) + 1, atol=1e-7)
    through = crossings(mesh, (0.013, -1.0, 0.2), (0, 1, 0))
    assert np.diff(through) == pytest.approx([back], abs=1e-7)


@pytest.mark.parametrize("front", ["doors", "drawers"])
def test_closed_furniture_is_hollow_and_its_hollow_can_be_reached(front):
    mesh = shelf(front=front, depth=0.4, bays=3, texture_size=SMALL)
    surface = welded(mesh)
    # A sealed hollow would be a shell of its own.
    assert surface.body_count == 1
    assert surface.volume < 0.35 * np.prod(np.ptp(mesh.bounds, axis=0))
    through = crossings(mesh, (0.1, -1.0, 0.25), (0, 1, 0))
    np.testing.assert_allclose(np.diff(through)[::2], [0.022, 0.010], atol=1e-7)


def test_separate_boards_overlap_and_unite_to_the_joined_case():
    joined, boards = (
        shelf(front="doors", depth=0.4, bays=1, bevel=0, joined=joined, texture_size=SMALL)
        for joined in (True, False)
    )
    assert welded(boards).body_count == 2 + 2 + 1 + 2 + 2  # sides, levels, back, doors, knobs
    assert welded(boards).volume > 1.01 * welded(joined).volume
    united = normalize(boards, "case").surface
    assert united.last_step == "union"
    np.testing.assert_allclose(boards.bounds, joined.bounds, atol=1e-12)
    size = np.ptp(boards.bounds, axis=0).max()
    assert united.volume * size**3 == pytest.approx(welded(joined).volume, rel=1e-6)


def test_stool_stands_on_its_legs_and_has_a_seat_as_thick_as_asked():
    mesh = stool(diameter=0.34, height=0.46, seat=0.036, legs=3, dish=0.006, texture_size=SMALL)
    feet = np.unique(np.round(mesh.vertices[mesh.vertices[:, 2] == 0], 9), axis=0)
    turn = np.round(np.arctan2(feet[:, 1], feet[:, 0]) / (2 * np.pi / 3) - 0.5).astype(int) % 3
    assert set(turn) == {0, 1, 2}
    for k in range(3):
        assert np.ptp(feet[turn == k], axis=0).max() < 0.04
    down = crossings(mesh, (0.0001, 0.0002, 1.0), (0, 0, -1))
    np.testing.assert_allclose(down, [0.546, 0.576], atol=1e-4)
    assert mesh.bounds[1, 2] == pytest.approx(0.46, abs=1e-9)
