import numpy as np
import pytest
import torch
import trimesh
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes
from solids import TURN, box, isosurface, sharp_isosurface, sphere

from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.topology import is_closed, signed_volume

SOLIDS = {
    "sphere": (sphere(0.42, 5), 4 / 3 * np.pi * 0.42**3),
    "box": (box((0.6, 0.5, 0.4), turn=TURN), 0.12),
    "box on the samples": (box((1.04 * 40 / 63, 1.04 * 20 / 63, 1.04 * 20 / 63)), 1.04**3 * 16000 / 63**3),
}


@pytest.fixture(scope="module", params=SOLIDS)
def case(request):
    solid, volume = SOLIDS[request.param]
    return isosurface(solid), volume


def test_is_closed_outward_and_of_the_right_volume(case):
    surface, volume = case
    assert is_closed(surface.faces)
    assert signed_volume(surface.vertices, surface.faces) == pytest.approx(volume, rel=5e-3)


def test_vertices_lie_on_the_zero_level(case):
    surface, _ = case
    distance = surface.grid.distance(torch.tensor(surface.vertices))
    assert distance.abs().max() < 1e-3 * surface.grid.spacing


def test_rays_from_outside_meet_it_and_leave_it(case, rng):
    surface, _ = case
    directions = rng.standard_normal((500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    inward, _ = surface.caster.first_hit(2 * directions, -directions)
    outward, _ = surface.caster.first_hit(np.zeros((500, 3)), directions)
    assert np.isfinite(inward).all()
    np.testing.assert_allclose(2 - inward, outward, atol=1e-5)  # convex


def test_nearest_projects_to_a_sphere(rng):
    surface, radius = isosurface(SOLIDS["sphere"][0]), 0.42
    direction = rng.standard_normal((400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    r = rng.uniform(0.25, 0.6, (400, 1))
    projected, distance = surface.nearest(direction * r)
    off = np.abs(surface.grid.distance(torch.from_numpy(projected)).numpy())
    assert off.max() < 0.02 * surface.grid.spacing
    near = np.abs(r[:, 0] - radius) < surface.grid.spacing
    np.testing.assert_allclose(projected[near], direction[near] * radius, atol=surface.grid.spacing / 10)
    np.testing.assert_allclose(distance, np.abs(r[:, 0] - radius), atol=surface.grid.spacing / 30)


@pytest.mark.parametrize("wall", [0.6, 1.5, 3.0, 6.0])
def test_nearest_is_the_nearest_point_of_a_wall(rng, wall):
    """Between two walls, where the gradient of the distance has a kink, too; walls in voxels."""
    thickness = wall * 2 * BOUND / 63
    surface = sharp_isosurface(box((0.8, 0.8, thickness), turn=TURN))
    points = rng.uniform(-0.35, 0.35, (60, 3)) * [1, 1, 2 * thickness / 0.7]
    _, distance = surface.nearest(points @ TURN.T)
    true = np.abs(np.abs(points[:, 2]) - thickness / 2)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    _, on_triangles, _ = trimesh.proximity.closest_point_naive(mesh, points @ TURN.T)
    np.testing.assert_allclose(distance, on_triangles, atol=0.1 * surface.grid.spacing)
    np.testing.assert_allclose(distance, true, atol=0.5 * surface.grid.spacing)


def test_nearest_is_idempotent_and_leaves_its_argument_alone(case, rng):
    surface, _ = case
    points = rng.uniform(-0.5, 0.5, (200, 3))
    given = points.copy()
    once, _ = surface.nearest(points)
    np.testing.assert_array_equal(points, given)
    _, moved = surface.nearest(once)
    assert moved.max() < 0.25 * surface.grid.spacing


def test_nearest_of_a_row_does_not_depend_on_its_batch(case, rng):
    surface, _ = case
    points = rng.uniform(-0.5, 0.5, (65, 3))
    whole = surface.nearest(points)
    order = rng.permutation(65)
    for a, b in zip(surface.nearest(points[order]), whole):
        np.testing.assert_array_equal(a, b[order])
    for i in (0, 7, 64):
        for a, b in zip(surface.nearest(points[i : i + 1]), whole):
            np.testing.assert_array_equal(a[0], b[i])


@pytest.mark.parametrize("resolution", [31, 32, 41])
def test_cells_that_are_passed_over_hold_no_surface(rng, resolution):
    """Marching cubes that looks at every cell finds the same triangles, to the bit."""
    noise = gaussian_filter(rng.standard_normal((resolution,) * 3), 1.5)
    values = np.clip(np.rint(400 * noise), -127, 127).astype(np.int8)
    surface = Isosurface(DistanceGrid(values, 0.05))
    vertices, faces, _, _ = marching_cubes(values.astype(np.float32), 0.0, allow_degenerate=False)
    np.testing.assert_array_equal(surface.faces, faces)
    np.testing.assert_array_equal(
        surface.vertices, vertices.astype(np.float64) * surface.grid.spacing - BOUND
    )


def test_points_near_the_surface_are_projected_without_extracting_it(rng):
    surface = isosurface(SOLIDS["sphere"][0])
    direction = rng.standard_normal((20, 3))
    direction *= 0.421 / np.linalg.norm(direction, axis=1, keepdims=True)
    surface.nearest(direction)
    assert set(vars(surface)) == {"grid"}
