import re

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from objectfolder.vision.cameras import Intrinsics, PixelRays, camera_rays, look_at, project, sphere_points

positions = st.lists(st.floats(-5, 5), min_size=3, max_size=3).filter(lambda p: np.linalg.norm(p) > 1e-2)


CAMERAS = [Intrinsics(320, 200, 250.0), Intrinsics(320, 200, 250.0, center=(-20.0, 130.5), focal_y=300.0)]


@given(positions, st.integers(0, 2**31), st.sampled_from(CAMERAS))
def test_projection_inverts_rays(position, seed, intrinsics):
    rng = np.random.default_rng(seed)
    pose = look_at(np.array(position))[0]
    pixels = rng.random((50, 2)) * [320, 200]
    origins, directions = camera_rays(pose, intrinsics, pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    distance = rng.uniform(0.1, 10, (50, 1))
    back, depth = project(origins.astype(float) + directions * distance, pose, intrinsics)
    np.testing.assert_allclose(back, pixels, atol=0.02)
    assert (depth > 0).all()


@given(positions, positions)
def test_look_at_is_a_rotation_that_looks_at_the_target(position, target):
    position, target = np.array(position), np.array(target)
    if np.linalg.norm(position - target) < 1e-3:
        return
    pose = look_at(position, target)[0]
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    np.testing.assert_array_equal(pose[:3, 3], position)
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])
    pixel, depth = project(target[None], pose, Intrinsics())
    np.testing.assert_allclose(pixel, [[128, 128]], atol=1e-6)
    assert depth[0] == pytest.approx(np.linalg.norm(position - target))


def test_z_is_up_in_the_image_and_x_to_the_right_seen_from_minus_y():
    pose = look_at(np.array([0, -2.5, 0]))[0]
    points = np.array([[0, 0, 0.3], [0.3, 0, 0]])
    (above, right), _ = project(points, pose, Intrinsics())
    assert (above[0], right[1]) == pytest.approx((128, 128))
    assert above[1] < 128 < right[0]


@pytest.mark.parametrize("z", [2.5, -2.5])
def test_the_poles_take_y_as_up(z):
    pose = look_at(np.array([0, 0, z]))[0]
    (above,), _ = project(np.array([[0, 0.3, 0]]), pose, Intrinsics())
    assert above[1] < 128
    # 11.5 degrees away from it z is up again.
    (above,), _ = project(np.array([[0, 0, 0.3]]), look_at(np.array([0.6, 0, z]))[0], Intrinsics())
    assert (above[1] < 128) == (abs(above[0] - 128) < 1e-6)


def test_the_default_camera_sees_the_whole_unit_cube():
    assert 2 * np.degrees(np.arctan(128 / 355.56)) == pytest.approx(39.6, abs=0.1)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    for resolution in (64, 256):
        for pose in look_at(sphere_points(50, 2.5, np.random.default_rng(0))):
            pixels, _ = project(corners, pose, Intrinsics.square(resolution))
            centre = np.abs(pixels / resolution - 0.5)
            assert centre.max() < 0.65  # corners of the cube may stick out, the inscribed sphere does not


def test_sphere_points_are_uniform(rng):
    points = sphere_points(20000, 2.5, rng)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 2.5)
    # Archimedes: each coordinate is uniform.
    for coordinate in points.T:
        np.testing.assert_allclose(np.quantile(coordinate, [0.1, 0.5, 0.9]), [-2, 0, 2], atol=0.07)


@pytest.mark.parametrize("position", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
def test_a_camera_at_its_target_or_nowhere_is_refused(position):
    named = f"camera: row 1 is {np.array(position, float).tolist()}, expected a place that is finite"
    refused(re.escape(named), look_at, np.array([[2, 1, 1], position]))


IMPOSSIBLE = (0, 1, 1.0), (1, -1, 1.0), (1, 1, 0.0), (1, 1, np.nan), (1, 1, np.inf)


@pytest.mark.parametrize("values", [*IMPOSSIBLE, (1, 1, 1.0, None, -1.0), (4, 4, 1.0, (np.nan, 0))])
def test_impossible_intrinsics_are_refused(values):
    refused(r"must be positive|expected a (whole|finite) number", Intrinsics, *values)


@pytest.mark.parametrize("kind", [np.float32, np.array, torch.tensor])
def test_numbers_of_intrinsics_are_pythons(kind):
    k = kind([[4.5, 8.0], [1.5, 2.25]])
    side = torch.tensor(6, dtype=torch.int8) if kind is torch.tensor else np.int8(6)
    made = Intrinsics(side, side, k[0, 0], k[1], k[0, 1])
    assert made == Intrinsics(6, 6, 4.5, (1.5, 2.25), 8.0)
    assert {type(value) for value in (made.width, made.height)} == {int}
    assert {type(value) for value in (made.fx, made.fy, made.cx, made.cy)} == {float}
    assert hash(made) == hash(Intrinsics(6, 6, 4.5, (1.5, 2.25), 8.0))


def test_a_camera_matrix_projects_as_it_says():
    k = np.array([[250.0, 0, 100.5], [0, 260, 90], [0, 0, 1]])
    intrinsics = Intrinsics.from_matrix(k, 200, 150)
    assert (intrinsics.width, intrinsics.height) == (200, 150)
    pose, points = look_at(np.array([2.0, 1, 1]))[0], np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    # Its camera looks along z with y down.
    local = (points - pose[:3, 3]) @ pose[:3, :3] * [1, -1, -1]
    homogeneous = local @ k.T
    pixels, depth = project(points, pose, intrinsics)
    np.testing.assert_allclose(pixels, homogeneous[:, :2] / homogeneous[:, 2:], rtol=1e-12)
    np.testing.assert_allclose(depth, local[:, 2])
    centred = Intrinsics.from_matrix([[9, 0, 2], [0, 9, 1.5], [0, 0, 1]], 4, 3)
    np.testing.assert_array_equal(
        project(points, pose, centred)[0], project(points, pose, Intrinsics(4, 3, 9.0))[0]
    )


@pytest.mark.parametrize(
    ("matrix", "reason"),
    [
        ([[9, 0.1, 2], [0, 9, 2], [0, 0, 1]], "has skew"),
        ([[9, 0, 2], [0, 9, 2], [0, 0, 2]], "last row"),
        ([[9, 0, 2, 0], [0, 9, 2, 0], [0, 0, 1, 0]], "3 x 3"),
        ([[np.nan, 0, 2], [0, 9, 2], [0, 0, 1]], "finite"),
        ([[-9, 0, 2], [0, 9, 2], [0, 0, 1]], "must be positive"),
    ],
)
def test_a_matrix_of_no_pinhole_camera_is_refused(matrix, reason):
    refused(reason, Intrinsics.from_matrix, matrix, 4, 4)


def test_rays_of_part_of_an_image_are_its_rays_at_unit_depth(rng):
    intrinsics = Intrinsics(120, 80, 150.0, center=(31.5, 70.25), focal_y=130.0)
    pose = look_at(np.array([1.9, -1.2, 0.8]))[0]
    rays = PixelRays(pose, intrinsics, 20, 7, 90, 60)
    assert rays.shape == (53, 70)
    columns, rows = np.meshgrid(np.arange(20, 90), np.arange(7, 60))
    corner = np.stack([columns.ravel(), rows.ravel()], 1)
    pixels = rng.integers(0, 53 * 70, 500)
    x, y = rng.random((2, 500), np.float32)
    for found, places in (
        (rays.centres(), corner + 0.5),
        (rays.through(pixels, x, y), corner[pixels] + np.stack([x, y], 1)),
    ):
        origins, expected = camera_rays(pose, intrinsics, places)
        np.testing.assert_array_equal(origins, np.broadcast_to(rays.origin, origins.shape))
        np.testing.assert_allclose(found / np.linalg.norm(found, axis=1, keepdims=True), expected, atol=5e-7)
        np.testing.assert_allclose(found @ -pose[:3, 2], 1, atol=1e-6)


@pytest.mark.parametrize(
    ("left", "top", "right", "bottom"), [(0, 0, 9, 7), (3, 2, 8, 7), (4, 5, 9, 6), (5, 3, 6, 4)]
)
def test_squares_of_pixels_are_those_of_the_whole_image(left, top, right, bottom):
    rays = PixelRays(np.eye(4), Intrinsics(9, 7, 9.0), left, top, right, bottom)
    row, column = np.mgrid[top:bottom, left:right].reshape(2, -1)
    for side in (2, 3):
        number = rays.by_squares(np.arange(row.size), side)
        assert len(set(number)) == len(number)
        same = (row[:, None] // side == row // side) & (column[:, None] // side == column // side)
        np.testing.assert_array_equal(number[:, None] // side**2 == number // side**2, same)


@pytest.mark.parametrize(("top", "bottom"), [(0, 7), (2, 9), (5, 6), (4, 4)])
def test_strips_hold_every_pixel_once_in_the_order_of_the_whole_image(top, bottom):
    whole = PixelRays(np.eye(4), Intrinsics(9, 9, 9.0), 0, 0, 9, 9).in_strips(4)
    np.testing.assert_array_equal(whole[:9], [0, 9, 18, 27, 1, 10, 19, 28, 2])
    part = PixelRays(np.eye(4), Intrinsics(9, 9, 9.0), 3, top, 8, bottom).in_strips(4)
    row, column = np.divmod(whole, 9)
    inside = (row >= top) & (row < bottom) & (column >= 3) & (column < 8)
    np.testing.assert_array_equal(part, ((row - top) * 5 + column - 3)[inside])
