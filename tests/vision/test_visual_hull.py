"""Visual hulls of a ball, whose silhouettes are known exactly."""

import numpy as np
import pytest

from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, project, sphere_points
from objectfolder.vision.visual_hull import visual_hull

HALF, CELLS, RADIUS = 0.52, 32, 0.3
CENTRE = np.array([0.1, -0.05, 0.0])


def silhouettes(count, resolution=64, radius=2.5):
    """Views of a ball away from the origin; alpha is 1 where the ray through a pixel's centre meets it."""
    poses = look_at(sphere_points(count, radius, np.random.default_rng(0)))
    intrinsics = Intrinsics.square(resolution)
    rows, columns = np.mgrid[:resolution, :resolution]
    pixels = np.stack([columns.ravel(), rows.ravel()], 1) + 0.5
    rgba = np.zeros((count, resolution, resolution, 4), np.float16)
    for image, pose in zip(rgba, poses):
        origins, directions = (a.astype(float) for a in camera_rays(pose, intrinsics, pixels))
        along = ((CENTRE - origins) * directions).sum(1, keepdims=True)
        nearest = np.linalg.norm(origins + along * directions - CENTRE, axis=1)
        image[..., 3] = (nearest < RADIUS).reshape(resolution, resolution)
    optics = {"focal": np.float64(intrinsics.focal), "center": np.full((count, 2), resolution / 2)}
    return {"rgba": rgba, "camera_to_world": poses} | optics


def distances():
    """Return how far the centre of each cell is from the ball's."""
    axis = (np.arange(CELLS) + 0.5) * (2 * HALF / CELLS) - HALF
    return np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1) - CENTRE, axis=-1)


@pytest.mark.parametrize("count", [1, 8, 60])
def test_the_object_is_never_cut(count):
    """Every cell that the ball reaches into, within half a pixel: that its silhouettes leave open."""
    reach = np.sqrt(3) * HALF / CELLS
    touched = distances() < RADIUS + reach - 0.5 * 2.5 / Intrinsics.square(64).focal
    assert visual_hull(silhouettes(count), CELLS, HALF)[touched].all()


def test_cells_seen_in_the_corner_of_a_wide_image_stay():
    """There, spheres project to ellipses longer than disks on the axis."""
    pose, intrinsics = look_at(np.array([0.7, 0.5, 0.5])), Intrinsics(512, 512, 200.0)
    corners = np.stack(np.meshgrid(*[np.linspace(-HALF, HALF, 65)] * 3, indexing="ij"), -1).reshape(-1, 3)
    position, depth = project(corners, pose[0], intrinsics)
    seen = np.flatnonzero((position > 0).all(1) & (position < 512).all(1) & (depth > 0.2))
    outermost = seen[np.argsort(-np.abs(position[seen] - 256).max(1))[:200:10]]
    for corner in outermost:
        alpha = np.zeros((1, 512, 512, 4))
        column, row = position[corner].astype(int)
        alpha[0, row, column, 3] = 1
        views = {"rgba": alpha, "camera_to_world": pose, "focal": np.float64(200)}
        hull = visual_hull({**views, "center": np.full((1, 2), 256.0)}, 64, HALF)
        around = np.argwhere(np.ones((2, 2, 2))) - 1 + np.array(np.unravel_index(corner, (65,) * 3))
        around = around[((around >= 0) & (around < 64)).all(1)]
        assert hull[tuple(around.T)].all()


def test_hulls_of_many_views_are_tight():
    """Within a cell's sphere and one pixel (0.028); one view leaves the whole cone."""
    distance, reach = distances(), np.sqrt(3) * HALF / CELLS
    one, many = (visual_hull(silhouettes(count), CELLS, HALF) for count in (1, 60))
    assert distance[many].max() < RADIUS + 2 * reach + 0.03
    assert distance[one].max() > RADIUS + 0.2
    assert (one | ~many).all()


def test_what_no_image_shows_stays():
    """A narrow image, in which the object fills everything or nothing."""
    views = silhouettes(4)
    crop = slice(28, 36)
    narrow = {**views, "rgba": views["rgba"][:, crop, crop], "center": np.full((4, 2), 4.0)}
    hull = visual_hull({**narrow, "rgba": np.zeros_like(narrow["rgba"])}, CELLS, HALF)
    assert not hull[15:17, 15:17, 15:17].any()
    assert hull[0, 0, 0]
    assert hull.mean() > 0.5


def test_cells_that_reach_out_of_the_image_stay():
    """Of a narrow view that shows nothing, only cells are emptied whose corners are all in it."""
    pose, intrinsics = look_at(np.array([2.5, 0.3, 0.2])), Intrinsics(16, 16, 355.56)
    views = {"rgba": np.zeros((1, 16, 16, 4)), "camera_to_world": pose}
    views |= {"focal": np.float64(intrinsics.focal), "center": np.full((1, 2), 8.0)}
    empty = np.argwhere(~visual_hull(views, 64, HALF))
    assert len(empty) > 100
    corners = (empty[:, None] + np.indices((2, 2, 2)).reshape(3, 8).T) * (2 * HALF / 64) - HALF
    position, _ = project(corners.reshape(-1, 3), pose[0], intrinsics)
    assert position.min() >= 0
    assert position.max() <= 16


def test_cameras_inside_the_cube_tell_about_what_is_before_them_only():
    views = silhouettes(1)
    pose = look_at(np.array([0.2, 0, 0]))  # looks along -x
    empty = {**views, "rgba": np.zeros_like(views["rgba"]), "camera_to_world": pose}
    hull = visual_hull(empty, CELLS, HALF)
    assert hull[22:].all()
    assert not hull[:8, 15:17, 15:17].any()
