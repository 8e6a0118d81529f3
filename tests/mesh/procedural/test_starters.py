import numpy as np
import pytest
from assembled import check_charts, welded
from hypothesis import given, settings
from hypothesis import strategies as st

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.procedural import generate
from objectfolder.mesh.procedural.bell import profiles
from objectfolder.mesh.procedural.die import PIP_DEPTH, PIP_RADIUS
from objectfolder.mesh.textured import TexturedMesh

EULER = {"mug": 0, "die": 2, "bell": 2}
SMALL = 128  # texels: most tests ask about the geometry


@pytest.fixture(scope="module", params=list(EULER))
def made(request: pytest.FixtureRequest) -> tuple[str, TexturedMesh]:
    return request.param, generate(request.param, texture_size=256)


def assert_closed(name: str, mesh: TexturedMesh) -> None:
    surface = welded(mesh)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.body_count == 1
    assert surface.euler_number == EULER[name]
    assert surface.volume > 0


def test_surface_is_one_closed_manifold(made):
    assert_closed(*made)


def test_every_face_lies_in_one_chart(made):
    check_charts(made[1])


def test_budget_and_texture(made):
    name, mesh = made
    assert len(mesh.faces) <= 20_500
    assert mesh.texture.shape == (256, 256, 3)
    assert mesh.texture.dtype == np.uint8
    assert len(np.unique(mesh.texture.reshape(-1, 3), axis=0)) > 500, f"{name} has a painted texture"
    assert 0 < mesh.roughness < 1


def test_colours_agree_across_seams(made):
    """Both sides of a chart's border must show the same colour."""
    name, mesh = made
    height, width = mesh.texture.shape[:2]
    texel = np.clip(np.round(mesh.uv * [width, height] - 0.5), 0, [width - 1, height - 1]).astype(int)
    colour = mesh.texture[::-1][texel[:, 1], texel[:, 0]].astype(float)
    _, group = np.unique(mesh.vertices, axis=0, return_inverse=True)
    group = group.ravel()
    mean = np.stack([np.bincount(group, colour[:, k]) / np.bincount(group) for k in range(3)], 1)
    twins = np.bincount(group)[group] > 1
    if name == "mug":  # the handle meets the painted wall at a real edge of colour
        twins &= (mesh.vertices[:, 0] < 0.9 * 0.041) | (np.abs(mesh.vertices[:, 1]) < 1e-9)
    assert twins.sum() > 100
    assert np.mean(np.abs(colour - mean[group])[twins].max(1) < 25) > 0.95


def test_mug_is_hollow_and_has_the_asked_size():
    radius, height, wall, bottom, reach = 0.041, 0.095, 0.004, 0.006, 0.030
    mesh = generate("mug", texture_size=SMALL)
    np.testing.assert_allclose(
        mesh.bounds, [[-radius, -radius, 0], [radius + reach, radius, height]], atol=1e-5
    )
    shell = np.pi * (radius**2 - (radius - wall) ** 2) * (height - bottom)
    floor = np.pi * radius**2 * (bottom - 0.0007)
    handle = np.pi * (0.12 * reach) * (0.20 * reach) * 0.105
    volume = welded(mesh).volume
    assert volume == pytest.approx(shell + floor + handle, rel=0.05)
    assert volume < 0.3 * np.pi * radius**2 * height


def test_mug_holds_water_down_to_its_floor():
    surface = welded(generate("mug", texture_size=SMALL))
    hits, _, _ = surface.ray.intersects_location([[0.003, 0.002, 0.2]], [[0, 0, -1.0]])
    np.testing.assert_allclose(np.sort(hits[:, 2]), [0.0015, 0.006], atol=1e-5)


def test_die_volume_and_size():
    size, fillet = 0.05, 0.006
    mesh = generate("die", edge=size, fillet=fillet, texture_size=SMALL)
    half = size / 2
    np.testing.assert_allclose(mesh.bounds, [[-half, -half, 0], [half, half, size]], atol=1e-9)
    core, rim, depth = size - 2 * fillet, PIP_RADIUS * size, PIP_DEPTH * size
    block = core**3 + 6 * core**2 * fillet + 3 * np.pi * core * fillet**2 + 4 / 3 * np.pi * fillet**3
    pips = 21 * np.pi * depth * (3 * rim**2 + depth**2) / 6
    assert welded(mesh).volume == pytest.approx(block - pips, rel=0.002)


def test_opposite_faces_of_the_die_sum_to_seven():
    mesh = generate("die", texture_size=SMALL)
    middle = mesh.vertices - [0, 0, 0.025]
    floor = 0.025 - PIP_DEPTH * 0.05  # bottoms of dents: one vertex each, this far from the middle
    for axis in range(3):
        lateral = np.delete(middle, axis, axis=1)
        inside = np.abs(lateral).max(1) < 0.018
        counts = [
            len(
                np.unique(
                    np.round(middle[inside & (np.abs(sign * middle[:, axis] - floor) < 1e-7)], 7), axis=0
                )
            )
            for sign in (1, -1)
        ]
        assert sum(counts) == 7


def test_bell_volume_and_size():
    height, radius, wall = 0.09, 0.045, 0.003
    mesh = generate("bell", texture_size=SMALL)
    np.testing.assert_allclose(mesh.bounds, [[-radius, -radius, 0], [radius, radius, height]], atol=1e-6)
    section = np.concatenate(profiles(height, radius, wall))
    r, z = section.T
    r2, z2 = np.roll(section, -1, axis=0).T
    pappus = (
        2 * np.pi * np.sum((r * z2 - r2 * z) * (r + r2)) / 6
    )  # first moment of the section about the axis
    surface = welded(mesh)
    assert surface.volume == pytest.approx(pappus, rel=0.003)
    assert surface.volume < 0.35 * surface.convex_hull.volume


def test_bell_is_open_below_and_as_thick_as_asked():
    surface = welded(generate("bell", texture_size=SMALL))
    hits, _, _ = surface.ray.intersects_location([[0.2, 0.0002, 0.035]], [[-1.0, 0, 0]])
    x = np.sort(hits[:, 0])
    assert len(x) == 4, "through two walls"
    assert 0.003 <= x[3] - x[2] <= 0.0045
    up, _, _ = surface.ray.intersects_location([[0.0001, 0.0002, -0.1]], [[0, 0, 1.0]])
    assert up[:, 2].min() > 0.05


@pytest.mark.parametrize(
    ("generator", "parameters", "words"),
    [
        ("anvil", {}, "unknown generator 'anvil'.*bell, block.*wrench"),
        ("mug", {"colour": 3}, "unknown parameter 'colour'.*radius"),
        ("mug", {"radius": 0.0}, r"radius=0\.0.*positive"),
        ("mug", {"height": float("nan")}, "height=nan.*finite"),
        ("mug", {"wall": 0.03}, "wall=0.03.*expected"),
        ("mug", {"bottom": 0.09}, "bottom=0.09.*expected"),
        ("mug", {"handle_reach": 0.3}, "handle_reach=0.3.*handle"),
        ("mug", {"texture_size": 0}, "texture_size=0.*texels"),
        ("mug", {"texture_size": 100.5}, "texture_size=100.5.*texels"),
        ("die", {"edge": -0.05}, "edge=-0.05.*positive"),
        ("die", {"edge": "big"}, "edge='big'.*positive"),
        ("die", {"fillet": 0.02}, "fillet=0.02.*pips"),
        ("bell", {"wall": 0.02}, "wall=0.02.*expected"),
        ("bell", {"radius": 0.2}, "height=0.09.*expected"),
    ],
)
def test_impossible_requests_are_refused(generator, parameters, words):
    with pytest.raises(ObjectFolderError, match=words):
        generate(generator, **parameters)


def check(name: str, parameters: dict[str, float]) -> None:
    mesh = generate(name, texture_size=64, **parameters)
    assert_closed(name, mesh)
    check_charts(mesh)


unit = st.floats(0, 1)


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.floats(0.02, 0.08), unit, unit, unit, unit)
def test_any_sane_mug_is_closed(radius, slim, thick, deep, far):
    height = radius * (1.2 + 1.8 * slim)
    wall = radius * (0.05 + 0.10 * thick)
    bottom = radius * 0.10 + deep * (0.2 * height - radius * 0.10)
    reach = radius * (0.3 + 0.1 * far)
    sizes = {"radius": radius, "height": height, "wall": wall, "bottom": bottom, "handle_reach": reach}
    check("mug", sizes)


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.floats(0.01, 0.2), st.floats(0.02, 0.16))
def test_any_sane_die_is_closed(size, rounding):
    check("die", {"edge": size, "fillet": rounding * size})


@settings(max_examples=5, deadline=None, derandomize=True)
@given(st.floats(0.02, 0.15), st.floats(1.6, 3.0), st.floats(0.03, 0.08))
def test_any_sane_bell_is_closed(radius, slender, thickness):
    check("bell", {"radius": radius, "height": radius * slender, "wall": radius * thickness})
