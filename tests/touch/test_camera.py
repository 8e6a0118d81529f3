from dataclasses import replace

import numpy as np
import pytest

from objectfolder.touch.camera import gel_depth, gel_normals, ray_directions


def on_gel(profile):
    """Depth and distance from the optical axis of every pixel's gel point."""
    depth = gel_depth(profile)
    return depth, depth * np.hypot(*np.moveaxis(ray_directions(profile)[..., 1:], -1, 0))


@pytest.mark.parametrize("radius", [0.02, 0.05, 1.0])
def test_curvature_of_one_over_the_dome_radius_is_a_sphere(digit, radius):
    depth, r = on_gel(replace(digit, gel_curvature=1 / radius, gel_dome_radius=radius))
    np.testing.assert_allclose(np.hypot(depth - (0.022 - radius), r), radius, rtol=1e-12)


def test_other_domes_are_tactos_a_paraboloid_and_flat(digit, flat):
    depth, r = on_gel(digit)
    corner = np.hypot(0.010, 0.015)  # of the gel, where TACTO's sinks five millimetres
    sag = 0.005 * (0.1 - np.sqrt(0.01 - r**2)) / (0.1 - np.sqrt(0.01 - corner**2))
    np.testing.assert_allclose(depth, 0.022 - sag, atol=2e-8)
    depth, r = on_gel(replace(digit, gel_dome_radius=1e4))
    np.testing.assert_allclose(depth, 0.022 - digit.gel_curvature * r**2 / 2, atol=1e-11)
    np.testing.assert_array_equal(gel_depth(flat), flat.camera_to_gel)


def test_normals_of_the_gel_at_rest_are_those_of_the_dome(digit, flat):
    still = np.zeros((1, digit.height, digit.width), np.float32)
    np.testing.assert_allclose(
        gel_normals(still, flat)[0], np.broadcast_to([-1, 0, 0], (160, 120, 3)), atol=1e-5
    )
    normals = gel_normals(still, digit)[0]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-6)
    depth, _ = on_gel(digit)
    y, z = (depth * ray_directions(digit)[..., axis] for axis in (1, 2))
    slope = digit.gel_curvature * digit.gel_dome_radius / np.sqrt(0.01 - y**2 - z**2)
    expected = np.stack([-np.ones_like(y), -slope * y, -slope * z], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(normals[inner], expected[inner], atol=2e-4)


def test_normals_of_a_plate_that_leans_in_the_gel_are_the_plates(flat):
    """The camera's perspective must not bend them."""
    lean = np.array([-1.0, 0.1, -0.2]) / np.linalg.norm([-1.0, 0.1, -0.2])
    rays = ray_directions(flat)
    distance = -0.022 * lean[0] / -(rays @ lean)  # of the plane through (0.022, 0, 0)
    normals = gel_normals((flat.camera_to_gel - distance)[None], flat)[0]
    np.testing.assert_allclose(normals[1:-1, 1:-1], np.broadcast_to(lean, (158, 118, 3)), atol=2e-4)
