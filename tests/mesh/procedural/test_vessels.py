from collections.abc import Callable
from typing import Any

import igl
import numpy as np
import pytest
from assembled import check_charts, crossings, welded
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.procedural.bottle import bottle
from objectfolder.mesh.procedural.bowl import bowl
from objectfolder.mesh.procedural.cup import cup
from objectfolder.mesh.procedural.pan import pan
from objectfolder.mesh.procedural.plate import plate
from objectfolder.mesh.procedural.section import half_outline, wall_about
from objectfolder.mesh.procedural.teapot import teapot
from objectfolder.mesh.procedural.vase import vase
from objectfolder.mesh.textured import TexturedMesh

FAMILIES: dict[str, Callable[..., TexturedMesh]] = {
    f.__name__: f for f in (bowl, cup, plate, bottle, vase, pan, teapot)
}
EULER = dict.fromkeys(FAMILIES, 2) | {"pan": 0, "teapot": 0}  # the hole in a handle, the loop of another
TEXELS = 256


@pytest.fixture(scope="module", params=list(FAMILIES))
def made(request: pytest.FixtureRequest) -> tuple[str, TexturedMesh]:
    return request.param, FAMILIES[request.param](texture_size=TEXELS)


def assert_solid(name: str, mesh: TexturedMesh) -> None:
    surface = welded(mesh)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.body_count == 1
    assert surface.euler_number == EULER[name]
    assert surface.volume > 0
    assert mesh.bounds[0, 2] == pytest.approx(0, abs=1e-9), "it stands on the table"


def test_surface_is_one_closed_manifold(made):
    assert_solid(*made)


def test_every_face_lies_in_one_chart(made):
    check_charts(made[1])


def test_winding_is_zero_or_one(made):
    surface = welded(made[1])
    low, high = surface.bounds
    points = np.random.default_rng(0).uniform(low - 0.01, high + 0.01, (3000, 3))
    winding = igl.winding_number(surface.vertices, surface.faces.astype(np.int64), points)
    assert np.abs(winding - winding.round()).max() < 1e-6
    assert set(np.unique(winding.round())) == {0.0, 1.0}
    extent = np.prod(high - low + 0.02)
    assert winding.mean() * extent == pytest.approx(surface.volume, rel=0.3)


def test_budget_and_texture(made):
    name, mesh = made
    assert 4_000 <= len(mesh.faces) <= 23_000
    assert mesh.texture.shape == (TEXELS, TEXELS, 3)
    assert len(np.unique(mesh.texture.reshape(-1, 3), axis=0)) > 30, f"{name} has a painted texture"


def test_colours_agree_across_seams(made):
    """Both sides of a chart's border must show the same colour."""
    _, mesh = made
    texel = np.clip(np.round(mesh.uv * TEXELS - 0.5), 0, TEXELS - 1).astype(int)
    colour = mesh.texture[::-1][texel[:, 1], texel[:, 0]].astype(float)
    _, group = np.unique(mesh.vertices, axis=0, return_inverse=True)
    group = group.ravel()
    mean = np.stack([np.bincount(group, colour[:, k]) / np.bincount(group) for k in range(3)], 1)
    twins = np.bincount(group)[group] > 1
    assert twins.sum() > 100
    assert np.mean(np.abs(colour - mean[group])[twins].max(1) < 30) > 0.93


@pytest.mark.parametrize("name", ["bowl", "cup", "plate", "bottle", "vase"])
def test_bounds_are_the_asked_dimensions(name):
    sizes = {"bowl": (0.075, 0.065), "cup": (0.036, 0.095), "plate": (0.13, 0.024)}
    radius, height = (sizes | {"bottle": (0.036, 0.22), "vase": (0.055, 0.20)})[name]
    bounds = FAMILIES[name](texture_size=64).bounds
    np.testing.assert_allclose(bounds, [[-radius, -radius, 0], [radius, radius, height]], atol=5e-6)


def test_straight_cup_has_the_volume_of_tube_and_floor():
    radius, height, wall, rounding = 0.04, 0.12, 0.004, 0.004
    surface = welded(
        cup(radius=radius, base_radius=radius, height=height, wall=wall, rounding=rounding, texture_size=64)
    )
    tube = np.pi * (radius**2 - (radius - wall) ** 2) * height
    floor = np.pi * (radius - wall) ** 2 * wall
    assert surface.volume == pytest.approx(tube + floor, rel=0.03)


def test_bowl_has_the_volume_of_an_even_wall_about_a_spheroid():
    """Wall times area of the half spheroid midway between its sides (the foot ring adds a little)."""
    radius, wall, foot = 0.08, 0.002, 0.0005
    surface = welded(
        bowl(
            radius=radius,
            height=radius,
            wall=wall,
            fullness=2,
            foot_height=foot,
            foot_radius=0.02,
            texture_size=64,
        )
    )
    a = radius - wall / 2
    c = radius - wall - foot
    e = np.sqrt(1 - c**2 / a**2)
    area = np.pi * a**2 * (1 + (1 - e**2) / e * np.arctanh(e))
    assert surface.volume == pytest.approx(area * wall, rel=0.02)


def test_plate_has_the_volume_of_its_cone_and_disc():
    radius, height, wall, well, foot = 0.12, 0.03, 0.004, 0.07, 0.001
    surface = welded(
        plate(
            radius=radius,
            height=height,
            wall=wall,
            well_radius=well,
            rim=0,
            foot_height=foot,
            texture_size=64,
        )
    )
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


@pytest.mark.parametrize("name", ["bowl", "cup", "bottle", "vase", "pan"])
def test_vessels_are_open_above_and_closed_below(name):
    mesh = FAMILIES[name](texture_size=TEXELS)
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


@pytest.mark.parametrize(
    ("build", "parameters", "words"),
    [
        (bowl, {"radius": 0.0}, r"bowl: radius=0\.0.*positive"),
        (bowl, {"wall": 0.03}, "bowl: wall=0.03.*expected"),
        (bowl, {"foot_radius": 0.07}, "bowl: foot_radius=0.07.*70 %"),
        (bowl, {"fullness": 1.0}, r"bowl: fullness=1\.0.*cone to cylinder"),
        (bowl, {"lobes": 2}, "bowl: lobes=2.*from 3 to 12"),
        (bowl, {"finish": "velvet"}, "unknown finish 'velvet'"),
        (bowl, {"texture_size": 3}, "bowl: texture_size=3.*texels"),
        (cup, {"rounding": 0.05}, "cup: rounding=0.05.*radius of the base"),
        (cup, {"stem": 0.09}, "cup: stem=0.09.*65 %"),
        (cup, {"stem": -1.0}, r"cup: stem=-1\.0.*positive"),
        (plate, {"rim": 0.045}, "plate: rim=0.045.*what the well leaves"),
        (plate, {"height": 0.001}, "plate: height=0.001.*above the well"),
        (bottle, {"neck_radius": 0.05}, "bottle: neck_radius=0.05.*90 %"),
        (bottle, {"height": 0.1}, "bottle: height=0.1.*neck, shoulder and a body"),
        (vase, {"neck": 0.3}, "vase: neck=0.3.*above the belly"),
        (vase, {"base_radius": float("nan")}, "vase: base_radius=nan.*finite"),
        (pan, {"handle_width": 0.2}, "pan: handle_width=0.2.*wall can hold"),
        (pan, {"handle_length": 2.0}, r"pan: handle_length=2\.0.*0.5 to 3 radii"),
        (teapot, {"lid_radius": 0.06}, "teapot: lid_radius=0.06.*35 %"),
        (teapot, {"height": 0.5}, "teapot: height=0.5.*1.3 to 3 radii"),
        (teapot, {"texture_size": 64}, "texture_size=64.*charts.*larger"),
    ],
)
def test_impossible_requests_are_refused(build, parameters, words):
    with pytest.raises(ObjectFolderError, match=words):
        build(**parameters)


unit = st.floats(0, 1)


def check(name: str, **parameters: Any) -> None:
    texels = TEXELS if name in ("pan", "teapot") else 64
    mesh = FAMILIES[name](texture_size=texels, finish="plastic", **parameters)
    assert_solid(name, mesh)
    check_charts(mesh)


@settings(max_examples=6, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.02, 0.15), unit, unit, unit, st.floats(-0.4, 0.6), st.sampled_from([0, 3, 12]))
def test_any_sane_bowl_is_closed(radius, tall, thick, full, flare, lobes):
    height = radius * (0.25 + 2.25 * tall)
    wall = 0.015 * radius + thick * (min(0.15 * radius, 0.2 * height) - 0.015 * radius)
    foot = {"foot_radius": (0.25 + 0.45 * full) * radius, "foot_height": 0.2 * height}
    check(
        "bowl",
        radius=radius,
        height=height,
        wall=wall,
        fullness=1.6 + 6 * full,
        flare=flare,
        lobes=lobes,
        **foot,
    )


@settings(max_examples=6, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.02, 0.08), unit, unit, st.floats(-0.25, 0.4), st.floats(0.25, 0.6))
def test_any_sane_goblet_is_closed(radius, thick, wide, bulge, stem):
    base = radius * (0.5 + wide)
    wall = 0.02 * radius + thick * (0.15 * min(radius, base) - 0.02 * radius)
    check(
        "cup",
        radius=radius,
        height=4 * radius,
        wall=wall,
        base_radius=base,
        rounding=0.9 * base,
        bulge=bulge,
        stem=4 * radius * stem,
        foot_radius=radius * (0.5 + 0.8 * wide),
    )


@settings(max_examples=6, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.02, 0.1), unit, unit, unit, st.floats(0, 0.35), st.sampled_from([0, 4]))
def test_any_sane_bottle_is_closed(radius, narrow, thick, proud, waist, lobes):
    neck = radius * (0.2 + 0.7 * narrow)
    check(
        "bottle",
        radius=radius,
        height=5 * radius,
        wall=0.02 * radius + thick * (0.3 * neck - 0.02 * radius),
        neck_radius=neck,
        neck_height=1.2 * radius,
        shoulder=radius,
        collar=proud * (radius - neck),
        waist=waist,
        lobes=lobes,
    )


@settings(max_examples=6, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.02, 0.1), unit, unit, unit, unit, st.floats(0.2, 0.8))
def test_any_sane_vase_is_closed(radius, base, neck, lip, thick, belly):
    radii = [radius * (0.2 + 0.8 * share) for share in (base, neck, lip)]
    wall = 0.02 * radius + thick * (0.25 * min(radii) - 0.02 * radius)
    names = ("base_radius", "neck_radius", "lip_radius")
    check(
        "vase", radius=radius, height=3 * radius, wall=wall, belly=belly, neck=0.93, **dict(zip(names, radii))
    )


@settings(max_examples=4, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.05, 0.15), unit, unit, unit)
def test_any_sane_pan_is_closed(radius, deep, wide, rise):
    height = radius * (0.25 + 1.3 * deep)
    check(
        "pan",
        radius=radius,
        height=height,
        wall=0.02 * radius,
        base_radius=radius * (0.6 + 0.4 * wide),
        rounding=0.3 * height,
        handle_length=1.5 * radius,
        handle_width=0.2 * radius,
        handle_thickness=min(0.1 * radius, 0.3 * height),
        handle_rise=0.7 * rise * radius,
    )


@settings(max_examples=4, deadline=None, derandomize=True, phases=[Phase.generate])
@given(st.floats(0.04, 0.12), st.floats(1.3, 3.0), st.floats(0.03, 0.09), st.floats(1.8, 5), unit)
def test_any_sane_teapot_is_closed(radius, slim, thick, full, reach):
    check(
        "teapot",
        radius=radius,
        height=slim * radius,
        wall=thick * radius,
        fullness=full,
        lid_radius=radius * (0.35 + 0.3 * reach),
        spout_reach=radius * (0.5 + 0.8 * reach),
        handle_reach=radius * (0.45 + 0.75 * reach),
    )
