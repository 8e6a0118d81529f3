"""Hollow solids against closed forms."""

import numpy as np
import pytest
import trimesh
from refusals import refused
from solids import box, sphere

from objectfolder.mesh.hollow import hollow_out, thickest_part
from objectfolder.mesh.normalize import mass_properties

SIDES = np.array([1.0, 0.6, 0.4])


SECTIONS = 24


def can(radius=0.3, height=1.0):
    """A prism, whose wall is a difference of prisms."""
    mesh = trimesh.creation.cylinder(radius, height, sections=SECTIONS)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int64)


def box_moments(sides):
    """Volume and moments of inertia of a box at density 1."""
    volume = np.prod(sides)
    return volume, volume / 12 * (np.square(sides).sum() - np.square(sides))


def test_a_box_is_the_difference_of_two_boxes():
    wall = 0.01
    found = mass_properties(hollow_out(box(SIDES), wall))
    (outer, outside), (inner, inside) = box_moments(SIDES), box_moments(SIDES - 2 * wall)
    assert found["volume"] == pytest.approx(outer - inner, rel=0.01)
    np.testing.assert_allclose(found["inertia"][:3], outside - inside, rtol=0.01)
    np.testing.assert_allclose(found["centre"], 0, atol=1e-4)


def test_a_can_has_the_volume_of_its_wall():
    wall = 0.005
    apothem, angle = 0.3 * np.cos(np.pi / SECTIONS), np.pi / SECTIONS
    within = SECTIONS * np.tan(angle) * (apothem**2 - (apothem - wall) ** 2 * (1 - 2 * wall))
    assert mass_properties(hollow_out(can(), wall))["volume"] == pytest.approx(within, rel=0.01)


def test_thin_parts_stay_solid():
    """A plate of twice the wall beside a block: only the block is hollow."""
    whole = trimesh.boolean.union(
        [
            trimesh.creation.box(bounds=[[-0.5, -0.2, -0.2], [0, 0.2, 0.2]]),
            trimesh.creation.box(bounds=[[-0.1, -0.2, -0.01], [0.5, 0.2, 0.01]]),
        ]
    )
    left = mass_properties(hollow_out((whole.vertices, np.int64(whole.faces)), 0.02))["volume"]
    assert left == pytest.approx(0.08 - 0.46 * 0.36 * 0.36 + 0.5 * 0.4 * 0.02, rel=0.01)


def test_the_thickest_part_is_the_largest_ball():
    assert thickest_part(sphere(0.5)) == pytest.approx(1, abs=0.005)
    assert thickest_part(box(SIDES)) == pytest.approx(0.4, abs=0.005)
    assert thickest_part(can(0.1)) == pytest.approx(0.2, abs=0.005)


def test_a_wall_that_fills_the_solid_is_refused():
    text = refused(
        "brick: a wall of 25.00% of the size fills the solid", hollow_out, box(SIDES), 0.25, "brick"
    )
    assert "at most 40.0" in text or "at most 39." in text
