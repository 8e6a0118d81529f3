"""Zero level sets of sampled functions."""

import numpy as np
import pytest

from objectfolder.mesh.closing.contour import BLOCK, contour
from objectfolder.mesh.topology import is_closed, signed_volume


def level_set(values):
    """The surface around the negative ones of 8^3 samples, one unit apart."""
    sampled = lambda points: values[tuple(np.rint(points).astype(int).T)]  # noqa: E731
    return contour(sampled, np.zeros(3), 1.0, np.ones(3, int), np.array([0]), 1.0)


@pytest.mark.parametrize("seed", [260, 942, 1804, 2526, 2972])
def test_a_surface_that_passes_through_samples_is_closed(seed):
    """Of these values, many near 0, vertices coincide: welded, three or more faces share an edge."""
    rng = np.random.default_rng(seed)
    values = np.ones((BLOCK,) * 3)
    corner = rng.integers(1, 6, 3)
    values[tuple(slice(i, i + 2) for i in corner)] = rng.normal(size=(2, 2, 2))
    values = np.where(rng.random(values.shape) < 0.3, values * 1e-9, values)
    vertices, faces = level_set(values)
    assert is_closed(faces)
    assert 0 < signed_volume(vertices, faces) < 8
    assert (vertices.min(0) >= corner - 1).all()
    assert (vertices.max(0) <= corner + 2).all()


def test_a_function_that_is_hardly_negative_has_no_surface():
    values = np.ones((BLOCK,) * 3)
    values[3, 3, 3] = -1e-12
    assert level_set(values)[1].shape == (0, 3)
