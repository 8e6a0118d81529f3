import numpy as np
import pytest
import torch
from solids import TURN, box, isosurface, join, sharp_isosurface, sphere

from objectfolder.mesh.raycast import RayCaster
from objectfolder.vision import view
from objectfolder.vision.cameras import Intrinsics, camera_rays, look_at
from objectfolder.vision.trace import trace
from objectfolder.vision.view import draw

RADIUS = 0.45
LIGHT = np.array([0.3, -0.8, 0.6])


def white(samples, light, pixel):
    return torch.ones(len(samples.points), 3)


def lambert(samples, light, pixel):
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


def exact_coverage(caster, pose, intrinsics, fine):
    """Share of each pixel's ``fine`` x ``fine`` rays that hit."""
    height, width = intrinsics.height, intrinsics.width
    rows, columns = (np.mgrid[: height * fine, : width * fine] + 0.5) / fine
    _, face = caster.first_hit(*camera_rays(pose, intrinsics, np.stack([columns.ravel(), rows.ravel()], 1)))
    return (face >= 0).reshape(height, fine, width, fine).mean((1, 3))


@pytest.mark.parametrize("position", [(2.5, 0, 0), (0.4, -1.6, 1.9), (0, 0, 2.5)])
def test_coverage_of_a_sphere_is_its_projected_area(ball, position):
    intrinsics = Intrinsics.square(128)
    alpha = draw(ball, white, look_at(np.array(position))[0], LIGHT, intrinsics).rgba[..., 3]
    exact = solid_angle_pixels(np.linalg.norm(position), intrinsics.focal)
    assert alpha.sum(dtype=np.float64) == pytest.approx(exact, rel=3e-3)


@pytest.mark.parametrize(
    ("sides", "mean", "worst"), [((0.5, 0.6, 0.7), 0.006, 0.03), ((0.9, 0.03, 0.03), 0.01, 0.07)]
)
def test_coverage_is_that_of_many_rays(sides, mean, worst):
    """A board whose silhouettes are straight, and a needle that is narrower than two pixels."""
    surface = isosurface(box(sides, turn=TURN), 96)
    pose, intrinsics = look_at(np.array([1.5, -1.6, 1.2]))[0], Intrinsics.square(64)
    alpha = draw(surface, white, pose, LIGHT, intrinsics).rgba[..., 3]
    exact = exact_coverage(surface.caster, pose, intrinsics, 24)
    partly = (exact > 0) & (exact < 1) & (alpha > 0)  # what no sample meets is left out
    assert partly.sum() > 50
    error = np.abs(alpha - exact)[partly]
    assert error.mean() < mean
    assert error.max() < worst


def test_alpha_is_one_inside_and_zero_outside(ball):
    intrinsics = Intrinsics.square(128)
    image = draw(ball, white, look_at(np.array([2.5, 0, 0]))[0], LIGHT, intrinsics).rgba
    rows, columns = np.mgrid[:128, :128] + 0.5
    r = np.hypot(rows - 64, columns - 64)
    edge = np.sqrt(solid_angle_pixels(2.5, intrinsics.focal) / np.pi)
    assert (image[r < edge - 1.5] == 1).all()
    assert (image[r > edge + 1.5] == 0).all()
    partial = image[..., 3]
    np.testing.assert_array_equal(image[..., :3], partial[..., None].repeat(3, -1))  # premultiplied white


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
    for intrinsics in (Intrinsics(24, 16, 40.0), Intrinsics(1, 1, 10.0)):
        picture = draw(ball, lambert, pose, LIGHT, intrinsics)
        assert picture.rgba.shape == (intrinsics.height, intrinsics.width, 4)
        assert (picture.rgba[..., 3] == covered).all()
        assert np.isfinite(picture.rgba).all()
        assert (np.isfinite(picture.depth) == covered).all()
        assert (np.linalg.norm(picture.normals, axis=-1).round(5) == covered).all()


OFF_CENTER = Intrinsics(120, 80, 150.0, center=(31.5, 70.25), focal_y=130.0)


def seen_sphere(position, pose, intrinsics):
    """Where rays through the pixels' centres meet a sphere: hit or not (H, W), depth, outward normals."""
    rows, columns = np.mgrid[: intrinsics.height, : intrinsics.width] + 0.5
    _, direction = camera_rays(pose, intrinsics, np.stack([columns.ravel(), rows.ravel()], 1))
    direction = direction.astype(float)
    along = -direction @ position
    below = along**2 - (position @ position - RADIUS**2)
    distance = along - np.sqrt(below.clip(min=0))
    normal = (position + direction * distance[:, None]) / RADIUS
    size = intrinsics.height, intrinsics.width
    depth = distance * (direction @ -pose[:3, 2])
    return (below > 0).reshape(size), depth.reshape(size), normal.reshape(*size, 3)


@pytest.mark.parametrize("intrinsics", [Intrinsics.square(128), OFF_CENTER], ids=["default", "off centre"])
@pytest.mark.parametrize("supersample", [True, False])
def test_depth_and_normals_of_a_sphere(ball, intrinsics, supersample):
    position = np.array([1.9, -1.2, 0.8])
    pose = look_at(position)[0]
    picture = draw(ball, white, pose, LIGHT, intrinsics, supersample)
    hit, depth, normals = seen_sphere(position, pose, intrinsics)
    grazing = (normals * (position - normals * RADIUS)).sum(-1) < 0.3 * np.linalg.norm(position)
    inner = hit & ~grazing
    assert inner.sum() > 500
    np.testing.assert_allclose(picture.depth[inner], depth[inner], atol=1e-3)  # a tenth of a voxel
    cosine = (picture.normals * normals).sum(-1)
    assert np.degrees(np.arccos(cosine[inner].clip(max=1))).max() < 1.5
    alpha = picture.rgba[..., 3]
    np.testing.assert_array_equal(np.isinf(picture.depth), alpha == 0)
    np.testing.assert_array_equal((picture.normals == 0).all(-1), alpha == 0)
    np.testing.assert_allclose(np.linalg.norm(picture.normals[alpha > 0], axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("side", [32, 96])
def test_depth_at_a_silhouette_is_never_between_near_and_far(side):
    """A small box before a large one: each pixel has the depth of either or none."""
    surface = isosurface(join(box((0.1, 0.9, 0.9), (-0.4, 0, 0)), box((0.1, 0.3, 0.3), (0.4, 0, 0))))
    pose = look_at(np.array([2.5, 0.01, 0.02]))[0]
    picture = draw(surface, white, pose, LIGHT, Intrinsics.square(side))
    depth = picture.depth[picture.rgba[..., 3] > 0]
    near, far = np.abs(depth - 2.05) < 0.02, np.abs(depth - 2.85) < 0.02
    assert (near | far).mean() > 0.97  # the others see the sides of the boxes
    assert min(near.sum(), far.sum()) > 20
    partial = picture.depth[(picture.rgba[..., 3] > 0) & (picture.rgba[..., 3] < 1)]
    assert len(partial) > 20
    assert np.isfinite(partial).all()


def test_without_supersampling_pixels_are_covered_or_not(ball):
    pose, intrinsics = look_at(np.array([2.1, -1.2, 0.6]))[0], Intrinsics.square(64)
    fine, coarse = (draw(ball, lambert, pose, LIGHT, intrinsics, each).rgba for each in (True, False))
    assert set(np.unique(coarse[..., 3])) == {0, 1}
    hit, _, _ = seen_sphere(pose[:3, 3], pose, intrinsics)
    assert (coarse[..., 3] != hit).mean() < 2e-3
    assert np.abs(fine - coarse).mean() < 0.01
    same = (fine == coarse).all(-1)
    assert same.mean() > 0.8  # away from edges, and from the shadow's


@pytest.mark.parametrize("supersample", [True, False])
def test_a_picture_that_is_drawn_in_tiles_is_the_same_to_the_bit(ball, monkeypatch, supersample):
    pose, intrinsics = look_at(np.array([2.1, -1.2, 0.6]))[0], Intrinsics(90, 80, 110.0)
    whole = draw(ball, lambert, pose, LIGHT, intrinsics, supersample)
    for pixels in (1, 500, 2000):  # rows of one, of a few, and of many
        monkeypatch.setattr(view, "TILE", pixels)
        tiled = draw(ball, lambert, pose, LIGHT, intrinsics, supersample)
        for name in ("rgba", "depth", "normals"):
            np.testing.assert_array_equal(getattr(tiled, name), getattr(whole, name))


def test_a_large_picture_is_shaded_in_parts(ball):
    """What is shaded at once does not grow with the picture."""
    shaded = []

    def counting(samples, light, pixel):
        shaded.append(len(pixel))
        return white(samples, light, pixel)

    pose = look_at(np.array([2.1, -1.2, 0.6]))[0]
    alpha = draw(ball, counting, pose, LIGHT, Intrinsics.square(2048)).rgba[..., 3]
    assert (alpha > 0).sum() > 3 * view.TILE
    assert max(shaded) < 1.3 * view.TILE


def test_resolution_converges(ball):
    """Averaging a fine picture gives the coarse one, except for aliasing at edges."""
    pose = look_at(np.array([2.1, -1.2, 0.6]))[0]
    coarse, fine = (draw(ball, lambert, pose, LIGHT, Intrinsics.square(r)).rgba for r in (48, 192))
    mean = fine.reshape(48, 4, 48, 4, 4).mean((1, 3))
    assert np.abs(coarse - mean).mean() < 2e-3


@pytest.mark.parametrize("turn", [None, TURN])
def test_a_lit_panel_has_no_shadow_of_its_own_where_light_grazes(turn):
    """Light one degree above a panel, camera above: its pixels are lit, up to its edges."""
    turn = np.eye(3) if turn is None else turn
    sides = np.array([0.9, 0.7, 0.08])
    surface = sharp_isosurface(box(sides, turn=turn), 96)
    up, ahead = turn[:, 2], turn[:, 0]
    light = 2.0 * ahead + (sides[2] / 2 + np.tan(np.deg2rad(1.0)) * 1.55) * up
    pose = look_at(2.2 * up - 0.9 * ahead)[0]
    origin, rays = camera_rays(pose, Intrinsics.square(128), np.mgrid[:128, :128].reshape(2, -1).T + 0.5)
    samples = trace(surface, origin, rays, light)
    height = samples.points.numpy() @ up
    panel = np.abs(height - sides[2] / 2) < 0.1 * surface.grid.spacing
    assert panel.sum() > 2000
    dark = panel & ~samples.lit.numpy()
    assert dark.sum() < 1e-3 * panel.sum()  # in notches of its edge
    rounded = trace(isosurface(box(sides, turn=turn), 96), origin, rays, light).lit.numpy()
    assert rounded.sum() < 0.99 * samples.lit.numpy().sum()


@pytest.mark.parametrize("sides", [(0.5, 0.6, 0.7), (0.9, 0.6, 0.04)])
def test_silhouettes_of_a_sharp_box_are_its_own(sides):
    """Coverage is that of the box itself, not of a rounded one; half a pixel would be 0.5."""
    solid = box(sides, turn=TURN)
    intrinsics = Intrinsics.square(96)
    pose = look_at(np.array([1.5, -1.6, 1.2]))[0]
    exact = exact_coverage(RayCaster(*solid), pose, intrinsics, 8)
    apart = [
        np.abs(draw(made(solid, 96), white, pose, LIGHT, intrinsics).rgba[..., 3] - exact)
        for made in (sharp_isosurface, isosurface)
    ]
    edge = (exact > 0) & (exact < 1)
    assert apart[0][edge].mean() < 0.03
    assert apart[0].max() < 0.4
    assert apart[0][edge].mean() < 0.5 * apart[1][edge].mean()
