import igl
import numpy as np
import pytest
import trimesh
from refusals import refused
from solids import box, isosurface, sphere

from objectfolder.benchmarks.datasets.occupancy import (
    HALF_SIDE,
    NEAR,
    cached_occupancy,
    grid_points,
    is_inside,
    near_points,
    sample_occupancy,
    uniform_points,
)
from objectfolder.benchmarks.scoring.shapes import surface_points

RNG = np.random.default_rng


def cup():
    """An open cup: a wall 0.08 thick around an empty room, from a closed profile."""
    profile = [(0, -0.4), (0.4, -0.4), (0.4, 0.4), (0.32, 0.4), (0.32, -0.32), (0, -0.32)]
    mesh = trimesh.creation.revolve(profile, sections=64)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int64)


def test_inside_agrees_with_exact_containment(brick):
    surface = brick.surface
    points = np.concatenate([uniform_points(20000, RNG(0)), near_points(surface, 20000, RNG(1))])
    found = is_inside(surface, points)
    winding = igl.winding_number(surface.vertices, surface.faces, points.astype(np.float64)) > 0.5
    contains = trimesh.Trimesh(surface.vertices, surface.faces, process=False).contains(points)
    # Trilinear cells and triangles differ by a fraction of a voxel next to the surface, and nowhere else.
    depth = np.abs(surface.nearest(points)[1])
    for exact in (winding, contains):
        assert (depth[found != exact] < 0.15 * surface.grid.spacing).all()
        assert (found != exact).mean() < 1e-3
    assert 0.1 < found.mean() < 0.5


def test_a_cups_wall_is_solid_and_its_room_is_empty():
    surface = isosurface(cup())
    wall, room, floor, above = [0.36, 0, 0], [0, 0, 0], [0, 0, -0.36], [0, 0, 0.41]
    assert is_inside(surface, np.array([[wall, room], [floor, above]])).tolist() == [
        [True, False],
        [True, False],
    ]
    volume = np.pi * (0.4**2 * 0.8 - 0.32**2 * 0.72)
    share = is_inside(surface, uniform_points(10**5, RNG(0))).mean()
    expected = volume / (2 * HALF_SIDE) ** 3
    assert share == pytest.approx(expected, abs=4 * np.sqrt(expected / 10**5) + 0.01 * expected)


def test_beyond_the_stored_grid_is_outside():
    surface = isosurface(box((1, 1, 1)))
    corner = np.array([[0.49, 0.49, 0.49], [0.53, 0, 0], [0.55, 0.55, 0.55], [0, 0, -40]])
    assert is_inside(surface, corner).tolist() == [True, False, False, False]


def test_points_fill_the_cube_and_hug_the_surface():
    points = uniform_points(50000, RNG(0))
    assert np.abs(points).max() <= np.float32(HALF_SIDE)
    counts = np.histogramdd(points, 4, [(-HALF_SIDE, HALF_SIDE)] * 3)[0]
    assert np.abs(counts - 50000 / 64).max() < 5 * np.sqrt(50000 / 64)
    surface = isosurface(sphere(0.4))
    offset = np.linalg.norm(near_points(surface, 20000, RNG(0)).astype(float), axis=1) - 0.4
    assert offset.std() == pytest.approx(NEAR, rel=0.05)
    nodes = grid_points(3)[[0, 1, 3, 9, 26]] / HALF_SIDE
    assert np.allclose(nodes, [[-1, -1, -1], [-1, -1, 0], [-1, 0, -1], [0, -1, -1], [1, 1, 1]])


def test_surface_points_are_uniform_by_area_with_their_triangles_normals():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 3], [0, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]])  # areas 1/2, 3/2 and 0
    points, normals = surface_points(vertices, faces, 20000, RNG(0))
    upright = normals[:, 0] == 1
    assert np.isin(normals, [0, 1]).all()
    assert upright.mean() == pytest.approx(0.75, abs=0.015)
    assert np.abs(points[~upright, 2]).max() == 0
    assert np.abs(points[upright, 0]).max() == 0
    assert points[upright].mean(0) == pytest.approx([0, 1 / 3, 1], abs=0.03)
    assert (points[~upright].sum(1) <= 1 + 1e-12).all()


def test_all_that_is_drawn_is_labelled_truly():
    solids = {"ball": sphere(0.4), "plank": box((1, 0.5, 0.1))}
    surfaces = {key: isosurface(solid) for key, solid in solids.items()}
    opened = {key: (lambda surface=surface: surface) for key, surface in surfaces.items()}
    occupancy = sample_occupancy(opened, 4000, 300, 200, 8, seed=3)
    labels = np.array([1, 0, 1, 1])
    points, inside = occupancy.draw(labels, 65, RNG(0))
    assert points.shape == (4, 65, 3)
    assert points.dtype == np.float32
    for label, some, answer in zip(labels, points, inside):
        assert np.array_equal(is_inside(list(surfaces.values())[label], some), answer)
    near = np.abs(np.linalg.norm(points[1], axis=1) - 0.4) < 5 * NEAR
    assert near[:32].all()
    assert not near[32:].all()
    for row, surface in enumerate(surfaces.values()):
        assert np.array_equal(occupancy.val_inside[row], is_inside(surface, occupancy.val_points))
        assert np.array_equal(occupancy.score_inside[row], is_inside(surface, occupancy.score_points))
        assert np.array_equal(occupancy.grid(np.array([row]))[0], is_inside(surface, grid_points(8)))
    pools = [occupancy.train_points, occupancy.val_points, occupancy.score_points]
    assert len(np.unique(np.concatenate(pools), axis=0)) == 4500  # no set shares a point with another


def test_cache_is_read_where_it_fits_and_made_anew_where_not(brick, tmp_path):
    path, sizes = tmp_path / "occupancy.npz", (500, 50, 40, 6)
    surfaces, digests = {"brick": lambda: brick.surface}, {"brick": "a"}
    first = cached_occupancy(path, surfaces, digests, *sizes, seed=0)
    bytes_, time = path.read_bytes(), path.stat().st_mtime_ns
    again = cached_occupancy(path, surfaces, digests, *sizes, seed=0)
    assert path.stat().st_mtime_ns == time
    assert all(np.array_equal(vars(first)[name], vars(again)[name]) for name in vars(first))
    other = cached_occupancy(path, surfaces, digests, *sizes, seed=1)
    assert not np.array_equal(other.val_points, first.val_points)
    cached_occupancy(path, surfaces, digests, *sizes, seed=0)
    assert path.read_bytes() == bytes_
    cached_occupancy(path, {"brick": lambda: isosurface(sphere(0.4))}, {"brick": "b"}, *sizes, seed=0)
    assert path.read_bytes() != bytes_
    path.write_bytes(bytes_[:1000])
    refused("damaged", cached_occupancy, path, surfaces, digests, *sizes, seed=0)
