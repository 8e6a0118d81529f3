import inspect

import numpy as np
import pytest
from assembled import crossings, welded

from objectfolder.shapes.pan import pan
from objectfolder.shapes.section import half_outline, wall_about
from objectfolder.shapes.teapot import teapot
from objectfolder.shapes.vessels import bottle, bowl, cup, plate, vase

TEXELS = 256


@pytest.mark.parametrize("build", [bowl, cup, plate, bottle, vase])
def test_bounds_are_the_asked_dimensions(build):
    asked = inspect.signature(build).parameters
    radius, height = asked["radius"].default, asked["height"].default
    bounds = build(texture_size=64).bounds
    np.testing.assert_allclose(bounds, [[-radius, -radius, 0], [radius, radius, height]], atol=5e-6)


def test_straight_cup_has_the_volume_of_tube_and_floor():
    radius, height, wall, rounding = 0.04, 0.12, 0.004, 0.004
    surface = welded(cup(radius, height, wall, radius, rounding, texture_size=64))
    tube = np.pi * (radius**2 - (radius - wall) ** 2) * height
    floor = np.pi * (radius - wall) ** 2 * wall
    assert surface.volume == pytest.approx(tube + floor, rel=0.03)


def test_bowl_has_the_volume_of_an_even_wall_about_a_spheroid():
    """Wall times area of the half spheroid midway between its sides (the foot ring adds a little)."""
    radius, wall, foot = 0.08, 0.002, 0.0005
    surface = welded(bowl(radius, radius, wall, 0.02, foot, fullness=2, texture_size=64))
    a = radius - wall / 2
    c = radius - wall - foot
    e = np.sqrt(1 - c**2 / a**2)
    area = np.pi * a**2 * (1 + (1 - e**2) / e * np.arctanh(e))
    assert surface.volume == pytest.approx(area * wall, rel=0.02)


def test_plate_has_the_volume_of_its_cone_and_disc():
    radius, height, wall, well, foot = 0.12, 0.03, 0.004, 0.07, 0.001
    surface = welded(plate(radius, height, wall, well, 0, foot, texture_size=64))
    edge, rise = radius - wall / 2, height - wall - foot
    cone = np.pi * (well + edge) * np.hypot(edge - well, rise)
    assert surface.volume == pytest.approx(wall * (np.pi * well**2 + cone), rel=0.04)


def test_wall_section_is_even_about_any_curve():
    """Area of an even wall is thickness times length of its middle, with the round end's half disc."""
    t = np.linspace(0, 1, 800)
    middle = np.stack([0.1 * t, 0.02 + 0.03 * np.sin(2.5 * t) ** 2], 1)
    length = np.linalg.norm(np.diff(middle, axis=0), axis=1).sum()
    section = wall_about(middle, 0.004)
    assert section.area() / 2 == pytest.approx(0.004 * length + np.pi * 0.002**2 / 2, rel=1e-3)
    profile = half_outline(section, "test")
    np.testing.assert_allclose(profile[[0, -1]], [[0, 0.018], [0, 0.022]], atol=1e-5)


@pytest.mark.parametrize(
    ("build", "parameters", "origin", "direction", "wall"),
    [
        (cup, {"base_radius": 0.036}, [0.2, 0, 0.06], [-1, 0, 0], 0.003),
        (cup, {}, [0.002, 0.003, 0.3], [0, 0, -1], 0.003),
        (bowl, {}, [0.004, 0.005, 0.3], [0, 0, -1], 0.004),
        (plate, {}, [0.004, 0.005, 0.3], [0, 0, -1], 0.005),
        (bottle, {}, [0.2, 0, 0.06], [-1, 0, 0], 0.0025),
        (bottle, {}, [0.2, 0, 0.19], [-1, 0, 0], 0.0025),
        (pan, {"base_radius": 0.125}, [-0.3, 0, 0.032], [1, 0, 0], 0.003),
        (pan, {}, [0.01, 0.02, 0.3], [0, 0, -1], 0.003),
        (teapot, {}, [0.0, 0.2, 0.74 * 0.135 * 0.45], [0, -1, 0], 0.004),
    ],
)
def test_wall_is_as_thick_as_asked(build, parameters, origin, direction, wall):
    at = crossings(build(texture_size=TEXELS, **parameters), origin, direction)
    assert len(at) in (2, 4), "through a floor or two walls"
    assert at[1] - at[0] == pytest.approx(wall, rel=0.02)


def test_vase_wall_is_even_along_its_normals():
    mesh = vase(texture_size=64, wall=0.003)
    surface = welded(mesh)
    centre = surface.triangles_center
    radial = np.sum(surface.face_normals[:, :2] * centre[:, :2], axis=1)
    outer = np.flatnonzero((radial > 0) & (centre[:, 2] > 0.02) & (centre[:, 2] < 0.19))[::37]
    inward = -surface.face_normals[outer]
    hits, ray, _ = surface.ray.intersects_location(centre[outer] + 1e-6 * inward, inward, multiple_hits=True)
    distance = np.linalg.norm(hits - centre[outer][ray], axis=1)
    first = np.full(len(outer), np.inf)
    np.minimum.at(first, ray, distance)
    np.testing.assert_allclose(first, 0.003, rtol=0.04)


@pytest.mark.parametrize("build", [bowl, cup, bottle, vase, pan])
def test_vessels_are_open_above_and_closed_below(build):
    mesh = build(texture_size=TEXELS)
    at = crossings(mesh, [0.002, 0.003, 1.0], [0, 0, -1])
    assert len(at) == 2, "nothing but the floor on the axis"
    assert 1.0 - at[0] < 0.25 * mesh.bounds[1, 2]


def test_teapot_is_hollow_and_pours():
    """Its inside is one surface with its outside: the bore joins them."""
    mesh = teapot(texture_size=TEXELS)
    surface = welded(mesh)
    assert surface.volume < 0.35 * surface.convex_hull.volume
    inside = crossings(mesh, [0.0, 0.2, 0.04], [0, -1, 0])
    assert len(inside) == 4, "two walls and air between"
    assert inside[2] - inside[1] > 0.1


def test_lobes_draw_the_lip_out_and_in():
    mesh = plate(lobes=4, lobe_depth=0.06, texture_size=64)
    lip = mesh.vertices[mesh.vertices[:, 2] > 0.022]
    radius = np.hypot(lip[:, 0], lip[:, 1])
    angle = np.arctan2(lip[:, 1], lip[:, 0])
    assert radius[np.abs(np.cos(4 * angle) - 1) < 0.01].max() == pytest.approx(0.13 * 1.06, rel=0.01)
    assert radius[np.abs(np.cos(4 * angle) + 1) < 0.01].max() == pytest.approx(0.13 * 0.94, rel=0.01)
