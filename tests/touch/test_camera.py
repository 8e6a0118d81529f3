from dataclasses import replace

import numpy as np
import pytest

from objectfolder.touch.camera import gel_depth, ray_directions


def on_gel(profile):
    """Depth and distance from the optical axis of every pixel's gel point."""
    depth = gel_depth(profile)
    return depth, depth * np.hypot(*np.moveaxis(ray_directions(profile)[..., 1:], -1, 0))


def test_tacto_dome_sinks_five_millimetres_at_the_corner_of_the_gel(digit):
    depth, r = on_gel(digit)
    corner = np.hypot(0.010, 0.015)
    sag = 0.005 * (0.1 - np.sqrt(0.01 - r**2)) / (0.1 - np.sqrt(0.01 - corner**2))
    np.testing.assert_allclose(depth, 0.022 - sag, atol=2e-8)


@pytest.mark.parametrize("radius", [0.02, 0.05, 1.0])
def test_curvature_of_one_over_the_dome_radius_is_a_sphere(digit, radius):
    depth, r = on_gel(replace(digit, gel_curvature=1 / radius, gel_dome_radius=radius))
    np.testing.assert_allclose(np.hypot(depth - (0.022 - radius), r), radius, rtol=1e-12)


def test_wide_dome_is_a_paraboloid(digit):
    depth, r = on_gel(replace(digit, gel_dome_radius=1e4))
    np.testing.assert_allclose(depth, 0.022 - digit.gel_curvature * r**2 / 2, atol=1e-11)


def test_gel_without_curvature_is_flat(flat):
    np.testing.assert_array_equal(gel_depth(flat), flat.camera_to_gel)
