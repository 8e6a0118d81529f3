"""What an Object File hands out cannot change its answers."""

import numpy as np
import pytest
from refusals import refused

from objectfolder import ObjectFile

CAMERA, LIGHT = [2.0, 1.0, 1.0], [0.5, 0.5, 0.9]


def test_the_header_is_a_copy(brick):
    header, scale = brick.header, brick.scale
    header["scale"] = 5
    header["audio"]["kind"] = "none"
    assert brick.scale == scale
    assert brick.header["audio"]["kind"] == "gains"
    assert ObjectFile(brick.header, brick.tensors).scale == scale


def test_the_surface_is_read_only_and_still_answers(brick_path):
    brick, other = ObjectFile.load(brick_path), ObjectFile.load(brick_path)
    surface, shading = brick.surface, brick.surface.shading
    for array in (
        *(surface.vertices, surface.faces, surface.normals, surface.bounds),
        *(shading.vertices, shading.faces, shading.normals),
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    points = other.sample_surface(3)
    np.testing.assert_array_equal(brick.sample_surface(3), points)
    np.testing.assert_array_equal(brick.view(CAMERA, LIGHT, 16), other.view(CAMERA, LIGHT, 16))
    np.testing.assert_array_equal(brick.touch(points), other.touch(points))
    np.testing.assert_array_equal(brick.nearest(2 * points)[0], other.nearest(2 * points)[0])
    mesh = brick.to_mesh()
    mesh.vertices[:] = mesh.faces[:] = 0  # copies
    assert not np.shares_memory(mesh.vertex_normals, surface.normals)
    np.testing.assert_array_equal(brick.bounds, other.bounds)
    np.testing.assert_array_equal(surface.faces, other.surface.faces)


def test_points_are_drawn_with_a_seed_a_generator_or_fresh_entropy(brick):
    drawn = brick.sample_surface(4, seed=7)
    rng = np.random.default_rng(7)
    np.testing.assert_array_equal(brick.sample_surface(4, rng), drawn)
    assert (brick.sample_surface(4, rng) != drawn).any(), "the generator goes on"
    assert (brick.sample_surface(4, None) != brick.sample_surface(4, None)).any()
    for seed in (-1, 0.5, "7", True, [7], np.random.RandomState(7)):
        refused(r"^seed is .*, a numpy Generator or None$", brick.sample_surface, 4, seed=seed)
