import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree
from solids import box, join, sphere

from objectfolder.benchmarks.datasets.occupancy import HALF_SIDE, extract_mesh, grid_points
from objectfolder.benchmarks.scoring import shapes

N = 20000


def rng(seed=0):
    return np.random.default_rng(seed)


def surface(points, normals):
    points = np.array(points, float)
    return shapes.SampledSurface(points, np.array(normals, float), cKDTree(points))


def radius(resolution):
    return np.linalg.norm(grid_points(resolution), axis=1).reshape(3 * [resolution])


def test_iou_by_hand():
    truth = np.array([[1, 1, 1, 0, 0], [0, 0, 0, 0, 0], [1, 0, 0, 0, 0], [0, 1, 0, 0, 0]], bool)
    predicted = np.array([[0, 1, 1, 1, 1], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 1, 0, 0, 0]], bool)
    assert shapes.intersection_over_union(predicted, truth).tolist() == [2 / 5, 1, 0, 1]


@given(arrays(bool, (2, 20)))
def test_iou_is_symmetric_bounded_and_one_for_equals(pair):
    a, b = pair
    iou = shapes.intersection_over_union(a, b)
    assert iou == shapes.intersection_over_union(b, a)
    assert 0 <= iou <= 1
    assert (iou == 1) == np.array_equal(a, b)


def test_surface_scores_by_hand():
    first = surface([[0, 0, 0], [3, 0, 0]], [[0, 0, 1], [0, 0, 1]])
    second = surface([[0, 0, 1], [0, 4, 0], [3, 0, 0]], [[0, 0, -1], [0, 1, 0], [0, 0.6, 0.8]])
    # From the first: 1 and 0, cosines |-1| and 0.8. From the second: 1, 4 and 0, cosines 1, 0 and 0.8.
    chamfer, consistency = shapes.surface_scores(first, second)
    assert chamfer == pytest.approx((0.5 + 5 / 3) / 2)
    assert consistency == pytest.approx((0.9 + 0.6) / 2)
    assert shapes.surface_scores(second, first) == pytest.approx((chamfer, consistency))


def test_two_spheres_are_as_far_apart_as_their_radii():
    inner, outer = (shapes.sample_mesh(*sphere(r, 5), N, rng(i)) for i, r in enumerate((0.3, 0.4)))
    chamfer, consistency = shapes.surface_scores(inner, outer)
    assert chamfer == pytest.approx(0.1, rel=0.01)
    assert consistency == pytest.approx(1, abs=0.002)


def test_distance_between_samples_of_one_surface_is_the_documented_floor():
    solid = box((1, 0.6, 0.3))
    area = trimesh.Trimesh(*solid).area
    same = [shapes.sample_mesh(*solid, N, rng(i)) for i in range(2)]
    chamfer, consistency = shapes.surface_scores(*same)
    assert chamfer == pytest.approx(math.sqrt(area / N) / 2, rel=0.02)
    assert 0.98 < consistency < 1  # at edges, the nearest point may be on another face
    assert shapes.surface_scores(same[0], same[0]) == pytest.approx((0, 1))


def test_squares_at_right_angles_have_no_normals_in_common():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    flat, upright = (shapes.sample_mesh(v, faces, 500, rng()) for v in (square, square[:, [2, 0, 1]]))
    lifted = shapes.sample_mesh(square + np.array([0, 0, 0.5]), faces[:, ::-1], 500, rng())
    assert shapes.surface_scores(flat, upright)[1] == 0
    assert shapes.surface_scores(flat, lifted) == pytest.approx((0.5, 1), abs=0.01)  # whichever way they face


def test_no_surface_scores_worst():
    truth = shapes.sample_mesh(*sphere(0.4), 100, rng())
    nothing = shapes.sample_mesh(*extract_mesh(np.zeros((5, 5, 5)), 0.5), 100, rng())
    assert nothing is None
    assert shapes.surface_scores(nothing, truth) == (shapes.EMPTY_CHAMFER, 0.0)
    assert pytest.approx(math.sqrt(3)) == shapes.EMPTY_CHAMFER


@settings(max_examples=20)
@given(st.floats(0.15, 0.4), st.floats(-0.05, 0.05))
def test_extracted_ball_has_the_radius_at_the_threshold(size, threshold):
    vertices, faces = extract_mesh(size - radius(24), threshold)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(size - threshold, abs=0.012)
    assert mesh.volume > 0  # faces outwards


def test_extracted_surface_is_closed_at_the_border_and_around_every_part():
    full = trimesh.Trimesh(*extract_mesh(np.full((6, 6, 6), 2.0), 0.5))
    assert full.is_watertight
    assert np.abs(full.vertices).max() < HALF_SIDE * (1 + 2 / 5)
    nodes = grid_points(40)
    two = join(sphere(0.2, 3, (-0.3, 0, 0)), sphere(0.1, 3, (0.35, 0, 0)))
    depth = np.maximum(
        0.2 - np.linalg.norm(nodes + np.array([0.3, 0, 0]), axis=1),
        0.1 - np.linalg.norm(nodes - [0.35, 0, 0], axis=1),
    ).reshape(40, 40, 40)
    mesh = trimesh.Trimesh(*extract_mesh(depth, 0.0))
    assert mesh.body_count == 2
    assert mesh.volume == pytest.approx(trimesh.Trimesh(*two).volume, rel=0.02)
    assert mesh.bounds == pytest.approx(np.array([[-0.5, -0.2, -0.2], [0.45, 0.2, 0.2]]), abs=0.005)
