import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.spatial.transform import Rotation
from solids import TURN, box, flipped, join, sphere

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.scanline import Certificate, check_winding, crossings, inside, winding_certificate

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


def test_shifted_rows_cross_where_a_slanted_face_lies(rng):
    """The lower face of a sheared box has height 0.3 x - 0.2 y."""
    vertices, faces = box((3, 3, 0.2))
    vertices = vertices + np.array([0, 0, 1]) * (0.3 * vertices[:, :1] - 0.2 * vertices[:, 1:2] + 0.1)
    shift = rng.uniform(-0.5, 0.5, (2, COUNT))
    column, height, sign = crossings(vertices, faces, COUNT, LOWER, SPACING, shift)
    i, j = np.divmod(column[sign > 0], COUNT)
    assert len(i) == COUNT**2
    x, y = LOWER[0] + (i + shift[0, j]) * SPACING, LOWER[1] + (j + shift[1, i]) * SPACING
    np.testing.assert_allclose(LOWER[2] + height[sign > 0] * SPACING, 0.3 * x - 0.2 * y, atol=1e-12)


def test_no_crossings_beside_the_grid():
    column, height, sign = crossings(*box((0.1, 0.1, 0.1), (3, 3, 0)), COUNT, LOWER, SPACING)
    assert len(column) == len(height) == len(sign) == 0


def without_faces(solid, missing):
    return solid[0], np.delete(solid[1], missing, axis=0)


@pytest.mark.parametrize(
    "solid",
    [
        sphere(0.5),
        box((0.8, 0.6, 0.5), turn=TURN),
        box((1, 1, 1)),
        join(box((0.8, 0.8, 0.8)), flipped(box((0.4, 0.4, 0.4)))),
        join(box((0.2, 0.2, 0.2), (-0.3, 0, 0)), box((0.2, 0.2, 0.2), (0.3, 0, 0))),
    ],
)
def test_certificate_of_a_solid(solid):
    certificate = winding_certificate(*solid)
    assert certificate.solid
    assert certificate.columns > 1000
    assert certificate.residual_columns == 0
    assert certificate.outside_fraction == 0
    assert check_winding(*solid, "solid") == certificate


@pytest.mark.parametrize("face", range(12))
def test_certificate_sees_each_missing_face_of_a_box(face):
    """Also those that are parallel to two of the three directions."""
    with pytest.raises(ObjectFolderError, match=r"crate: the surface is open: .* on \d+ of \d+ columns"):
        check_winding(*without_faces(box((0.8, 0.6, 0.5)), face), "crate")


def test_residual_columns_are_the_shadow_of_the_hole():
    """A missing half of the top is half of the columns along z."""
    certificate = winding_certificate(*without_faces(box((1, 1, 1)), 4), count=100)
    assert certificate.columns == 3 * 100**2
    assert certificate.residual_columns == pytest.approx(100**2 / 2, rel=0.03)


def test_outside_fraction_is_the_share_of_overlap():
    """Two boxes of volume v that share a quarter: 0.25 v of their union's 1.75 v is wound twice."""
    pair = join(box((0.4, 0.4, 0.4)), box((0.4, 0.4, 0.4), (0.3, 0, 0)))
    certificate = winding_certificate(*pair)
    assert certificate.outside_fraction == pytest.approx(0.25 / 1.75, rel=0.02)
    refused(r"pair: the winding number is neither 0 nor 1 in 14\.\d+%", check_winding, *pair, "pair")


def test_inside_out_and_copied_solids_are_outside_everywhere():
    solid = sphere(0.4, 3)
    for wrong in (flipped(solid), join(solid, solid)):
        certificate = winding_certificate(*wrong)
        assert certificate.residual_columns == 0
        assert certificate.outside_fraction == 1
        assert not certificate.solid


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_certificate_does_not_depend_on_the_unit(scale):
    vertices, faces = sphere(0.4, 3)
    assert winding_certificate(vertices * scale + 3 * scale, faces).solid
    assert winding_certificate(np.zeros((3, 3)), np.array([[0, 1, 2]])) == Certificate(0, 0, 0.0)


def test_a_thread_between_the_columns_is_refused():
    refused(r"thread: no column .* thinner than 0\.8%", check_winding, *box((1, 1e-4, 1e-4)), "thread")
