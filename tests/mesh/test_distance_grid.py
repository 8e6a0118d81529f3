import numpy as np
import pytest
import torch
from solids import TURN, box, sphere

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.grid import BAND_VOXELS, BOUND, DistanceGrid, band_width, quantise
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sdf import check_resolved, distance_grid

RESOLUTION = 64
RADIUS = 0.42


@pytest.fixture(scope="module")
def ball():
    return DistanceGrid(*distance_grid(*sphere(RADIUS, 5), RESOLUTION))


def shell(rng, radius, count=2000):
    d = rng.standard_normal((count, 3))
    return torch.from_numpy(d / np.linalg.norm(d, axis=1, keepdims=True) * radius)


@pytest.mark.parametrize("voxels", [-1, -0.5, 0, 0.5, 1])
def test_distance_to_a_sphere_is_right_to_a_thirtieth_of_a_voxel(ball, rng, voxels):
    distance = ball.distance(shell(rng, RADIUS + voxels * ball.spacing))
    np.testing.assert_allclose(distance, voxels * ball.spacing, atol=ball.spacing / 30)


def test_distance_is_clipped_to_the_band_with_the_right_sign(ball):
    assert ball.band == pytest.approx(BAND_VOXELS * ball.spacing)
    centre, corner, beyond = ball.distance(torch.tensor([[0.0, 0, 0], [0.5, 0.5, 0.5], [2.0, 2, 2]]))
    assert centre == pytest.approx(-ball.band)
    assert corner == pytest.approx(ball.band)
    assert beyond == pytest.approx(ball.band)


def test_normals_of_a_sphere_point_outward(ball, rng):
    points = shell(rng, RADIUS)
    cosine = (ball.normals(points).double() * points / RADIUS).sum(1)
    assert cosine.min() > np.cos(np.radians(1.5))
    np.testing.assert_allclose(ball.normals(points).norm(dim=1), 1, atol=1e-6)


def test_samples_of_a_rotated_box_match_its_exact_distance():
    sides, centre = np.array([0.6, 0.5, 0.3]), np.array([0.03, -0.02, 0.01])
    values, band = distance_grid(*box(sides, centre, TURN), RESOLUTION)
    axis = np.linspace(-BOUND, BOUND, RESOLUTION)
    local = (np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1) - centre) @ TURN
    q = np.abs(local) - sides / 2
    exact = np.linalg.norm(q.clip(0), axis=-1) + q.max(-1).clip(max=0)
    np.testing.assert_allclose(values * (band / 127), exact.clip(-band, band), atol=band / 127 / 2 + 1e-9)


def test_axes_are_x_y_z():
    values, band = distance_grid(*box((0.9, 0.5, 0.2), (0.01, 0.1, 0.25)), RESOLUTION)
    inside = np.argwhere(values < 0)
    spacing = 2 * BOUND / (RESOLUTION - 1)
    np.testing.assert_allclose(np.ptp(inside, axis=0) * spacing, [0.9, 0.5, 0.2], atol=2 * spacing)
    np.testing.assert_allclose(inside.mean(0) * spacing - BOUND, [0.01, 0.1, 0.25], atol=spacing / 2)
    grid = DistanceGrid(values, band)
    assert (
        grid.distance(torch.tensor([[0.01, 0.1, 0.25]]))
        < 0
        < grid.distance(torch.tensor([[0.25, 0.1, 0.01]]))
    )


def test_quantisation_is_symmetric_and_within_half_a_step():
    band = band_width(RESOLUTION)
    d = np.linspace(-2 * band, 2 * band, 4001)
    q = quantise(d, band)
    np.testing.assert_array_equal(q, -quantise(-d, band))
    assert (np.abs(q * (band / 127) - d.clip(-band, band)) <= band / 254 * (1 + 1e-9)).all()


def test_a_row_does_not_depend_on_its_batch(ball, rng):
    points = torch.from_numpy(rng.uniform(-0.5, 0.5, (301, 3)))
    order = rng.permutation(301)
    for function in (ball.distance, ball.normals):
        whole = function(points)
        assert torch.equal(function(points[order]), whole[order])
        assert torch.equal(torch.cat([function(points[i : i + 7]) for i in range(0, 301, 7)]), whole)


def test_same_bytes_twice():
    a, b = (distance_grid(*sphere(0.3, 3), 32)[0].tobytes() for _ in range(2))
    assert a == b


@pytest.mark.parametrize(("thickness", "kept"), [(0.1, True), (0.03, True), (0.012, False)])
def test_walls_thinner_than_the_spacing_are_refused(thickness, kept):
    plate = box((1, 1, thickness))  # centred: no sample of an even grid lies inside a thin one
    values, band = distance_grid(*plate, RESOLUTION)
    if kept:
        check_resolved(values, *plate, "plate")
        return
    with pytest.raises(ObjectFolderError, match="plate: walls are too thin for the 64\\^3 distance grid"):
        check_resolved(values, *plate, "plate")
    with pytest.raises(ObjectFolderError, match="holds no surface"):
        Isosurface(DistanceGrid(values, band))
