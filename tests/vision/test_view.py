import numpy as np
import pytest
import torch
from solids import box, isosurface, join, sphere

from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at, project
from objectfolder.vision.trace import trace
from objectfolder.vision.view import draw

RADIUS = 0.45
LIGHT = np.array([0.3, -0.8, 0.6])


def white(samples, light):
    return torch.ones(len(samples.points), 3)


def lit_only(samples, light):
    return samples.lit[:, None].float().expand(-1, 3)


def lambert(samples, light):
    to_light = light - samples.points
    squared = to_light.square().sum(1)
    cosine = (to_light * samples.normals).sum(1) / squared.sqrt()
    return (samples.lit * cosine / squared)[:, None].expand(-1, 3)


@pytest.fixture(scope="module")
def ball():
    return isosurface(sphere(RADIUS, 5), 96)


def solid_angle_pixels(distance, focal):
    """Area of a centred sphere's silhouette in pixels: a disc of the tangent cone's angle."""
    return np.pi * (focal * np.tan(np.arcsin(RADIUS / distance))) ** 2


@pytest.mark.parametrize("position", [(2.5, 0, 0), (0.4, -1.6, 1.9), (0, 0, 2.5)])
def test_coverage_of_a_sphere_is_its_projected_area(ball, position):
    intrinsics = Intrinsics.square(128)
    alpha = draw(ball, white, look_at(np.array(position))[0], LIGHT, intrinsics)[..., 3]
    exact = solid_angle_pixels(np.linalg.norm(position), intrinsics.focal)
    assert alpha.sum(dtype=np.float64) == pytest.approx(exact, rel=3e-3)


def test_alpha_is_one_inside_and_zero_outside(ball):
    intrinsics = Intrinsics.square(128)
    image = draw(ball, white, look_at(np.array([2.5, 0, 0]))[0], LIGHT, intrinsics)
    rows, columns = np.mgrid[:128, :128] + 0.5
    r = np.hypot(rows - 64, columns - 64)
    edge = np.sqrt(solid_angle_pixels(2.5, intrinsics.focal) / np.pi)
    assert (image[r < edge - 1.5] == 1).all()
    assert (image[r > edge + 1.5] == 0).all()
    partial = image[..., 3]
    np.testing.assert_array_equal(image[..., :3], partial[..., None].repeat(3, -1))  # premultiplied white


def test_the_picture_is_the_right_way_round():
    surface = isosurface(box((0.1, 0.3, 0.2), (0, 0.2, 0.3)))
    pose, intrinsics = look_at(np.array([2.5, 0, 0]))[0], Intrinsics(96, 64, 110.0)
    alpha = draw(surface, white, pose, LIGHT, intrinsics)[..., 3]
    rows, columns = np.nonzero(alpha > 0.5)
    (centre,), _ = project(np.array([[0.05, 0.2, 0.3]]), pose, intrinsics)
    assert columns.mean() + 0.5 == pytest.approx(centre[0], abs=0.7)
    assert rows.mean() + 0.5 == pytest.approx(centre[1], abs=0.7)


def test_the_terminator_of_a_sphere(ball):
    """A point is lit where it is above the plane of tangency: p . l > r^2."""
    light = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(0)
    inward = rng.standard_normal((4000, 3))
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    samples = trace(ball, np.float32(-2 * inward), np.float32(inward), light)
    assert len(samples.ray) == 4000
    height = samples.points.numpy() @ light - RADIUS**2
    clear = np.abs(height) > 0.02
    np.testing.assert_array_equal(samples.lit.numpy()[clear], (height > 0)[clear])
    np.testing.assert_allclose(samples.points.norm(dim=1), RADIUS, atol=2e-3)


def test_a_shadow_falls_where_geometry_puts_it():
    """A small box above a plate hides the light from the homothetic rectangle on the plate."""
    surface = isosurface(join(box((0.9, 0.9, 0.1), (0, 0, -0.4)), box((0.2, 0.3, 0.04), (0, 0, 0))), 96)
    light = np.array([0.0, 0.0, 1.0])
    x, y = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 4000))
    target = np.stack([x, y, np.full_like(x, -0.35)], 1)
    origin = np.float32(target + np.array([0, 0, 0.2]))
    samples = trace(surface, origin, np.float32(np.tile([0.0, 0, -1], (4000, 1))), light)
    np.testing.assert_allclose(samples.points[:, 2], -0.35, atol=1e-3)
    grow = 1.35 / 1.02  # shadow of the lower rim is smaller: 1.35 / 1.02 at z = -0.02 from the light
    wide = 1.35 / (1 - 0.02)
    inner = (np.abs(x) < 0.1 * grow - 0.01) & (np.abs(y) < 0.15 * grow - 0.01)
    outer = (np.abs(x) > 0.1 * wide + 0.01) | (np.abs(y) > 0.15 * wide + 0.01)
    assert inner.sum() > 100
    assert not samples.lit[inner].any()
    assert samples.lit[outer].all()


def test_nothing_is_lit_from_behind(ball):
    pose, intrinsics = look_at(np.array([2.5, 0, 0]))[0], Intrinsics.square(64)
    behind = draw(ball, lit_only, pose, np.array([-1.0, 0, 0]), intrinsics)
    assert not behind[..., :3].any()
    assert behind[..., 3].max() == 1
    front = draw(ball, lit_only, pose, np.array([1.0, 0, 0]), intrinsics)
    assert front[32, 32].tolist() == [1, 1, 1, 1]


def test_a_white_lambertian_at_distance_one_has_radiance_one():
    surface = isosurface(box((0.2, 0.6, 0.6), (0, 0, 0)))
    image = draw(
        surface, lambert, look_at(np.array([2.5, 0, 0]))[0], np.array([1.1, 0, 0]), Intrinsics.square(63)
    )
    assert image[31, 31, 0] == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize(
    ("pose", "covered"),
    [
        (look_at(np.array([2.5, 0, 0]), (5, 0, 0))[0], 0),  # looks away
        (look_at(np.array([2.5, 0, 0]), (2.5, 3, 0.1))[0], 0),  # looks past it
        (look_at(np.array([0.5, 0, 0]))[0], 1),  # so near that it fills the picture
        (look_at(np.array([0.1, 0, 0]))[0], 1),  # inside
    ],
)
def test_pictures_without_an_edge(ball, pose, covered):
    image = draw(ball, lambert, pose, LIGHT, Intrinsics(24, 16, 40.0))
    assert image.shape == (16, 24, 4)
    assert (image[..., 3] == covered).all()
    assert np.isfinite(image).all()


def test_a_picture_of_one_pixel(ball):
    assert draw(ball, white, look_at(np.array([2.5, 0, 0]))[0], LIGHT, Intrinsics(1, 1, 10.0)).shape == (
        1,
        1,
        4,
    )


def test_resolution_converges(ball):
    """Averaging a fine picture gives the coarse one, except for aliasing at edges."""
    pose = look_at(np.array([2.1, -1.2, 0.6]))[0]
    coarse, fine = (draw(ball, lambert, pose, LIGHT, Intrinsics.square(r)) for r in (48, 192))
    mean = fine.reshape(48, 4, 48, 4, 4).mean((1, 3))
    assert np.abs(coarse - mean).mean() < 2e-3


def test_same_bytes_twice_and_rays_are_independent(ball):
    pose, intrinsics = look_at(np.array([2.1, -1.2, 0.6]))[0], Intrinsics.square(32)
    first, second = (draw(ball, lambert, pose, LIGHT, intrinsics) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    pixels = np.random.default_rng(2).random((200, 2)) * 32
    rays = camera_rays(pose, intrinsics, pixels)
    whole = trace(ball, *rays, LIGHT)
    part = trace(ball, rays[0][50:], rays[1][50:], LIGHT)
    kept = whole.ray >= 50
    for name in ("points", "normals", "lit"):
        assert torch.equal(getattr(part, name), getattr(whole, name)[kept])
