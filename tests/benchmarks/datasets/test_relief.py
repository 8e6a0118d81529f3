import numpy as np
import pytest
from solids import box, sphere

from objectfolder.benchmarks.datasets.sampling import BELOW, RAYS, SPAN, surface_relief
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sdf import distance_grid

ACROSS = np.linspace(-SPAN / 2, SPAN / 2, RAYS)
SCALE = 0.1  # of a ball of radius 40 mm, and of a cube of side 80 mm


@pytest.fixture(scope="module")
def ball():
    return Isosurface(DistanceGrid(*distance_grid(*sphere(0.4, 5), 96)))


@pytest.fixture(scope="module")
def cube():
    return Isosurface(DistanceGrid(*distance_grid(*box((0.8, 0.8, 0.8)), 96)))


def _residual(height):
    """Root mean square of a height over the square, without its mean plane."""
    across, up = np.meshgrid(ACROSS, ACROSS)
    plane = np.stack([np.ones_like(across), across, up], -1).reshape(-1, 3)
    values = height(across, up).ravel()
    return np.sqrt(np.mean((values - plane @ np.linalg.lstsq(plane, values, rcond=None)[0]) ** 2))


def test_a_ball_has_the_relief_of_its_curvature(ball):
    directions = np.random.default_rng(0).standard_normal((20, 3))
    points = 0.04 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    expected = _residual(lambda x, y: np.sqrt(0.04**2 - x**2 - y**2))
    np.testing.assert_allclose(surface_relief(ball, points, SCALE), expected, rtol=0.05)


def test_a_face_has_none_and_its_edge_the_fall_beside_it(cube):
    points = np.array([[0.0, 0.04, 0.0], [0.02, -0.01, 0.04], [0.04 - SPAN / 3, 0.0, 0.04]])
    face, elsewhere, edge = surface_relief(cube, points, SCALE)
    assert max(face, elsewhere) < 1e-6
    assert edge == pytest.approx(_residual(lambda x, y: np.where(x > SPAN / 3, -BELOW, 0)), rel=0.02)
