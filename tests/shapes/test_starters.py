import numpy as np
import pytest
from assembled import welded

from objectfolder.shapes import generate
from objectfolder.shapes.bell import profiles
from objectfolder.shapes.die import PIP_DEPTH, PIP_RADIUS

SMALL = 128  # texels: most tests ask about the geometry


def test_mug_is_hollow_and_has_the_asked_size():
    radius, height, wall, bottom, reach = 0.041, 0.095, 0.004, 0.006, 0.030
    mesh = generate("mug", texture_size=SMALL)
    expected = [[-radius, -radius, 0], [radius + reach, radius, height]]
    np.testing.assert_allclose(mesh.bounds, expected, atol=1e-5)
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
        dents = middle[inside & (np.abs(np.abs(middle[:, axis]) - floor) < 1e-7)]
        assert len(np.unique(np.round(dents, 7), axis=0)) == 7


def test_bell_volume_and_size():
    height, radius, wall = 0.09, 0.045, 0.003
    mesh = generate("bell", texture_size=SMALL)
    np.testing.assert_allclose(mesh.bounds, [[-radius, -radius, 0], [radius, radius, height]], atol=1e-6)
    section = np.concatenate(profiles(height, radius, wall))
    r, z = section.T
    r2, z2 = np.roll(section, -1, axis=0).T
    # Pappus: by the first moment of the section about the axis.
    pappus = 2 * np.pi * np.sum((r * z2 - r2 * z) * (r + r2)) / 6
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
