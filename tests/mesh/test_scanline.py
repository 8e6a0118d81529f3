import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solids import TURN, box, flipped, join, sphere

from objectfolder.mesh.scanline import coverage, crossings, inside

COUNT = 24
SPACING = 1.04 / COUNT
LOWER = np.full(3, -0.52)


@pytest.mark.parametrize(
    "solid", [box((0.8, 0.6, 0.5), turn=TURN), sphere(0.5), box((1.04, 1.04, 1.04)), box((1.0, 0.5, 0.5))]
)
@pytest.mark.parametrize("lower", [LOWER, LOWER + SPACING / 2])
def test_every_column_enters_as_often_as_it_leaves(solid, lower):
    column, height, sign = crossings(*solid, COUNT, lower, SPACING)
    balance = np.bincount(column, weights=sign, minlength=COUNT**2)
    assert not balance.any()
    # Going up, the winding number is never negative.
    order = np.lexsort((-sign, height, column))
    assert np.cumsum(sign[order]).min() >= 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 3))
def test_columns_through_vertices_and_edges_balance(seed, level):
    """Vertices on a coarse lattice put columns exactly on vertices and edges."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(0.45, level)
    vertices = np.rint(vertices @ Rotation.random(random_state=rng.integers(2**31)).as_matrix() * 16) / 16
    column, _, sign = crossings(vertices, faces, 33, np.full(3, -1.0), 1 / 16)
    assert not np.bincount(column, weights=sign).any()


def test_inside_agrees_with_an_analytic_sphere():
    count, radius = 48, 0.45
    spacing = 1.04 / (count - 1)
    vertices, faces = sphere(radius, 5)
    axis = -0.52 + spacing * np.arange(count)
    r = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    answer = inside(vertices, faces, count, LOWER, spacing)
    certain = np.abs(r - radius) > 1e-3  # the facets lie this close to the sphere
    assert certain.mean() > 0.99
    np.testing.assert_array_equal(answer[certain], (r < radius)[certain])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_inside_agrees_with_a_rotated_box(seed):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    sides, centre = rng.uniform(0.05, 0.5, 3), rng.uniform(-0.1, 0.1, 3)
    axis = LOWER[0] + SPACING * np.arange(COUNT)
    local = (np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1) - centre) @ turn
    margin = (sides / 2 - np.abs(local)).min(-1)
    answer = inside(*box(sides, centre, turn), COUNT, LOWER, SPACING)
    certain = np.abs(margin) > 1e-9
    np.testing.assert_array_equal(answer[certain], (margin > 0)[certain])


def test_inside_of_nested_and_overlapping_solids():
    hollow = join(box((0.8, 0.8, 0.8)), flipped(box((0.4, 0.4, 0.4))))
    both = join(box((0.8, 0.8, 0.8)), box((0.4, 0.4, 0.4)))
    count_hollow, count_both = (inside(*s, COUNT, LOWER, SPACING).sum() for s in (hollow, both))
    whole = inside(*box((0.8, 0.8, 0.8)), COUNT, LOWER, SPACING).sum()
    core = inside(*box((0.4, 0.4, 0.4)), COUNT, LOWER, SPACING).sum()
    assert count_hollow == whole - core
    assert count_both == whole


def volume(solid, count):
    return coverage(*solid, count, LOWER, 1.04 / count).sum(dtype=np.float64) * (1.04 / count) ** 3


@pytest.mark.parametrize("sides", [(0.71, 0.33, 0.52), (0.9, 0.01, 0.9), (0.013, 0.4, 0.7)])
def test_coverage_of_an_aligned_box_is_wrong_by_less_than_a_quarter_voxel_per_side(sides):
    sides = np.array(sides)
    low, high = ((sides[:2] + sign * SPACING / 4).clip(0).prod() * sides[2] for sign in (-1, 1))
    assert low <= volume(box(sides), COUNT) <= high


@pytest.mark.parametrize("turn", [TURN, TURN @ TURN, TURN.T])
def test_coverage_of_a_rotated_box(turn):
    assert volume(box((0.6, 0.4, 0.5), turn=turn), COUNT) == pytest.approx(0.12, rel=2e-3)


def test_coverage_of_a_sphere():
    exact = 4 / 3 * np.pi * 0.5**3
    vertices, faces = sphere(0.5, 5)
    assert volume((vertices, faces), 24) == pytest.approx(exact, rel=3e-3)
    assert volume((vertices, faces), 96) == pytest.approx(exact, rel=1.5e-3)


def test_coverage_is_exact_along_z():
    sides = (1.04, 1.04, 0.3137)  # fills the grid across
    fill = coverage(*box(sides, (0, 0, 0.0191)), COUNT, LOWER, SPACING)
    low, high = 0.0191 - 0.3137 / 2, 0.0191 + 0.3137 / 2
    edges = LOWER[2] + SPACING * np.arange(COUNT + 1)
    exact = (np.minimum(edges[1:], high) - np.maximum(edges[:-1], low)).clip(0) / SPACING
    np.testing.assert_allclose(fill[COUNT // 2, COUNT // 2], exact, atol=1e-6)


def test_coverage_does_not_depend_on_the_order_of_faces(rng):
    vertices, faces = sphere(0.45, 3)
    expected = coverage(vertices, faces, COUNT, LOWER, SPACING)
    np.testing.assert_allclose(
        coverage(vertices, rng.permutation(faces), COUNT, LOWER, SPACING), expected, atol=1e-6
    )


def test_no_crossings_beside_the_grid():
    column, height, sign = crossings(*box((0.1, 0.1, 0.1), (3, 3, 0)), COUNT, LOWER, SPACING)
    assert len(column) == len(height) == len(sign) == 0
