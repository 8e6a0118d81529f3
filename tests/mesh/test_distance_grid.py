from pathlib import Path

import igl
import numpy as np
import pytest
import torch
import trimesh
from refusals import refused
from solids import TURN, box, flipped, join, sphere, united

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.features import find_features
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import BAND_VOXELS, BOUND, band_width, quantise
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.normalize import normalize
from objectfolder.mesh.reading.load import load_mesh
from objectfolder.mesh.sdf import (
    DEVIATION,
    VOLUME_ERROR,
    WALL_VOXELS,
    deviation,
    distance_grid,
    fit_grid,
    kept_volume,
)
from objectfolder.mesh.settings import FINEST
from objectfolder.mesh.topology import distance
from objectfolder.touch.contact import NORMAL_RADIUS

RESOLUTION = 64
RADIUS = 0.42
SIDES, CENTRE = np.array([0.6, 0.5, 0.3]), np.array([0.03, -0.02, 0.01])
RING, TUBE = 0.33, 0.12
OBJECTS = Path(__file__).parents[2].parent / "shared" / "objects"
REAL = {
    "gso_salad_plate": "obj",
    "gso_school_bell": "obj",
    "polyhaven_wooden_table": "gltf",
    "ycb_medium_clamp": "obj",
    "ycb_mug": "obj",
}
SLOW = ("polyhaven_wooden_table", "ycb_medium_clamp", "ycb_mug")  # beside a plate and a bell


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


def test_cubic_convolution_is_exact_for_quadratics():
    """Keys 1981: third order. Values that the stored integers hold exactly."""
    axis = np.arange(-8.0, 9)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    grid = DistanceGrid((x * x - 20 + x * y / 2 * 2 - z).clip(-127, 127).astype(np.int8), 127.0)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    x, y, z = (points / grid.spacing).T
    np.testing.assert_allclose(grid.smooth_distance(points), x * x - 20 + x * y - z, atol=1e-9)


def test_cubic_convolution_is_nearer_to_a_sphere_than_trilinear_interpolation():
    coarse = DistanceGrid(*distance_grid(*sphere(RADIUS, 5), 32))
    points = shell(np.random.default_rng(2), RADIUS)
    smooth, linear = coarse.smooth_distance(points.numpy()), coarse.distance(points).numpy()
    assert np.abs(smooth).mean() < 0.5 * np.abs(linear).mean()
    one = coarse.smooth_distance(points[7:8].numpy())
    assert one[0] == smooth[7]


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
    values, band = distance_grid(*box(SIDES, CENTRE, TURN), RESOLUTION)
    exact = distance_to_box(samples(RESOLUTION))
    np.testing.assert_allclose(values * (band / 127), exact.clip(-band, band), atol=band / 127 / 2 + 1e-9)


def samples(resolution):
    axis = np.linspace(-BOUND, BOUND, resolution)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)


def distance_to_sphere(points):
    return np.linalg.norm(points, axis=-1) - RADIUS


def distance_to_torus(points):
    return np.hypot(np.hypot(points[..., 0], points[..., 1]) - RING, points[..., 2]) - TUBE


def distance_to_box(points):
    q = np.abs((points - CENTRE) @ TURN) - SIDES / 2
    return np.linalg.norm(q.clip(0), axis=-1) + q.max(-1).clip(max=0)


def torus():
    mesh = trimesh.creation.torus(RING, TUBE, major_sections=192, minor_sections=96)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int64)


@pytest.mark.parametrize("resolution", [128, *(pytest.param(n, marks=pytest.mark.slow) for n in (192, 256))])
@pytest.mark.parametrize(
    ("solid", "distance"),
    [
        (lambda: sphere(RADIUS, 5), distance_to_sphere),
        (torus, distance_to_torus),
        (lambda: box(SIDES, CENTRE, TURN), distance_to_box),
    ],
    ids=["sphere", "torus", "box"],
)
def test_samples_are_exact_to_a_twentieth_of_a_voxel(solid, distance, resolution, rng):
    """Half a step of int8 is 0.0098 voxels; the facets of sphere and torus lie up to 0.03 off at 256^3."""
    values, band = distance_grid(*solid(), resolution)
    stored = np.argwhere(np.abs(values) < 127)
    assert len(stored) > 3 * resolution**2
    anywhere = rng.integers(0, resolution, (100_000, 3))
    for index in (stored[rng.integers(0, len(stored), 100_000)], anywhere):
        points = -BOUND + 2 * BOUND / (resolution - 1) * index
        error = values[tuple(index.T)] * (band / 127) - distance(points).clip(-band, band)
        assert np.abs(error).max() < 0.05 * band / BAND_VOXELS
        if len(solid()[1]) == 12:
            assert np.abs(error).max() < 0.5 * band / 127 * (1 + 1e-6)


def test_trilinear_distance_to_a_torus_is_right_to_a_twentieth_of_a_voxel(rng):
    grid = DistanceGrid(*distance_grid(*torus(), 128))
    points = rng.uniform(-0.46, 0.46, (200_000, 3)) * [1, 1, 0.3]
    exact = distance_to_torus(points)
    near = np.abs(exact) < grid.band - 3**0.5 * grid.spacing  # in cells without a clipped corner
    assert near.sum() > 3000
    error = grid.distance(torch.from_numpy(points[near])).numpy() - exact[near]
    assert np.abs(error).max() < 0.05 * grid.spacing


@pytest.mark.skipif(not OBJECTS.is_dir(), reason="needs the shared objects")
@pytest.mark.parametrize(
    "name", [pytest.param(key, marks=[pytest.mark.slow] if key in SLOW else []) for key in REAL]
)
def test_no_sign_of_a_real_object_is_wrong(name, rng):
    """Against libigl's winding number, which knows nothing of columns.

    The distance is 1-Lipschitz, so trilinear interpolation is off by the weighted mean distance to the
    cell's corners at most, which is sqrt(3)/2 spacings: farther from the surface a sign must be right.
    """
    path = OBJECTS / name / f"mesh.{REAL[name]}"
    vertices, faces = normalize(
        load_mesh(path, "y" if path.suffix == ".gltf" else "z", 16), name
    ).surface.mesh
    grid = DistanceGrid(*distance_grid(vertices, faces, 192))
    step = grid.band / 127

    points = rng.uniform(-0.5, 0.5, (10_000, 3)) * np.ptp(vertices, axis=0)
    far = distance((vertices, faces), points) > 3**0.5 / 2 * grid.spacing + step
    assert far.sum() > 7000
    answer = grid.distance(torch.from_numpy(points)).numpy() < 0
    np.testing.assert_array_equal(answer[far], winding(points, vertices, faces)[far] > 0.5)

    # At samples nothing is interpolated: only those that are stored as 0 have no sign.
    index = rng.permutation(np.argwhere(np.abs(grid.values) < 127))[:10_000]
    values = grid.values[tuple(index.T)]
    points = -BOUND + grid.spacing * index
    signed = values != 0
    np.testing.assert_array_equal((values < 0)[signed], winding(points, vertices, faces)[signed] > 0.5)
    assert distance((vertices, faces), points[~signed]).max(initial=0) <= step / 2 * (1 + 1e-6)


def winding(points, vertices, faces):
    """Fast winding numbers, and exact ones where those leave a doubt."""
    number = np.asarray(igl.fast_winding_number(vertices, faces, points))
    doubt = np.flatnonzero(np.minimum(np.abs(number), np.abs(number - 1)) > 0.05)
    if len(doubt):
        number[doubt] = igl.winding_number(vertices, faces, points[doubt])
    return number


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


@pytest.mark.parametrize("voxels", [0.75, 1.0, 8.0])
def test_walls_keep_their_volume_on_the_grid_that_fits_them(voxels):
    """A hollow ball; thickness in voxels of the grid that is asked for, which may become twice as fine."""
    wall = voxels * 2 * BOUND / (RESOLUTION - 1)
    shell = join(sphere(0.45, 4), flipped(sphere(0.45 - wall, 4)))
    grid = fit_grid(*shell, RESOLUTION)
    resolution = len(grid.values)
    assert grid.wall == pytest.approx(wall, rel=0.01)
    assert grid.wall >= WALL_VOXELS * 2 * BOUND / (resolution - 1)
    assert abs(grid.kept - 1) < VOLUME_ERROR
    assert kept_volume(grid.values, *shell) == grid.kept
    assert grid.band == band_width(resolution)
    assert voxels > 1.4 or resolution > RESOLUTION
    assert voxels < 2 or resolution == RESOLUTION


def test_the_volume_of_a_grid_converges_with_the_square_of_its_spacing():
    """Chords cut off edges and arcs: a fixed area per length of edge, in units of the spacing squared."""
    solid = box(SIDES, CENTRE, TURN)
    lost = [1 - kept_volume(distance_grid(*solid, n)[0], *solid) for n in (32, 63, 125)]
    assert lost[0] > 4e-4
    rate = np.log2(np.divide(lost[:-1], lost[1:]))
    assert ((rate > 1.6) & (rate < 2.4)).all(), lost


def test_an_edge_of_little_volume_asks_for_a_finer_grid():
    """Walls have five voxels, but most of the volume is near edges."""
    bar = box((0.9, 0.09, 0.09), (0, 0, 0), TURN)
    coarse = kept_volume(distance_grid(*bar, RESOLUTION)[0], *bar)
    grid = fit_grid(*bar, RESOLUTION)
    assert abs(coarse - 1) > VOLUME_ERROR >= abs(grid.kept - 1)
    assert len(grid.values) > RESOLUTION


def test_a_slot_narrower_than_a_voxel_asks_for_a_finer_grid():
    """The volume hardly changes where it closes, but a twentieth of the surface lies in it."""
    slot = 0.7 * 2 * BOUND / (RESOLUTION - 1)
    sides = [box((0.9, 0.08, 0.19), (0, -0.05, sign * (0.19 + slot) / 2)) for sign in (-1, 1)]
    comb = united(*sides, box((0.9, 0.1, 0.4)))
    coarse = distance_grid(*comb, RESOLUTION)[0]
    assert abs(kept_volume(coarse, *comb) - 1) < VOLUME_ERROR
    assert deviation(coarse, find_features(coarse, *comb), *comb) > 10 * DEVIATION
    grid = fit_grid(*comb, RESOLUTION)
    assert deviation(grid.values, grid.features, *comb) <= DEVIATION
    assert len(grid.values) > RESOLUTION


def test_a_sheet_between_the_samples_of_the_finest_grid_is_kept():
    plate = box((1, 1, 0.006))  # centred: no sample of an even grid lies inside a thin one
    grid = fit_grid(*plate, RESOLUTION, "plate")
    assert grid.values.min() > 0
    assert grid.kept == pytest.approx(1, abs=0.01)
    assert grid.kept == kept_volume(grid.values, *plate, grid.features)
    refused("holds no surface", Isosurface, DistanceGrid(grid.values, grid.band))


def test_a_needle_between_the_samples_of_the_finest_grid_is_refused():
    needle = box((1, 0.003, 0.003))  # it crosses no edge of the grid
    with pytest.raises(ObjectFolderError, match="needle: walls are too thin for the 128\\^3 distance grid"):
        fit_grid(*needle, RESOLUTION, "needle")


@pytest.mark.parametrize("resolution", [192, 256, FINEST])
def test_the_band_holds_the_reach_of_contact_normals(resolution):
    assert band_width(resolution) > NORMAL_RADIUS
    assert band_width(resolution) * (resolution - 1) / (2 * BOUND) >= BAND_VOXELS
