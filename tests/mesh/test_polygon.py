"""Polygons in space."""

import numpy as np
import pytest
from polygons import OUTLINE
from scipy.spatial.transform import Rotation

from objectfolder.mesh.polygon import area_vector, fan, needs_ears, split, split_tightly

TURN = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()


def in_space(outline):
    return np.column_stack([outline, np.zeros(len(outline))]) @ TURN.T + [1, 2, 3]


def areas(points, triangles):
    """Areas along the polygon's normal, negative if reversed."""
    normal = area_vector(points) / np.linalg.norm(area_vector(points))
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) @ normal / 2


@pytest.mark.parametrize("start", range(8))
@pytest.mark.parametrize("way", [1, -1])
def test_a_u_is_covered_once_from_any_corner(start, way):
    points = in_space(np.roll(OUTLINE, start, 0)[::way])
    assert needs_ears(points[None]).all()
    found = areas(points, split(points[None])[0])
    assert len(found) == 6
    assert found.min() >= -1e-12
    assert found.sum() == pytest.approx(7)


def test_what_a_fan_covers_keeps_its_fan():
    square = in_space(OUTLINE[[0, 1, 2, 7]])
    dart = in_space(np.array([[0, 0], [2, -1], [1, 0], [2, 1]]))  # from its reflex corner's opposite
    boom = np.roll(dart, 1, 0)
    np.testing.assert_array_equal(split(np.stack([square, dart])), [fan(4), fan(4)])
    assert needs_ears(np.stack([square, dart, boom])).tolist() == [False, False, True]
    assert areas(boom, split(boom[None])[0]).sum() == pytest.approx(1)
    assert areas(boom, split(boom[None])[0]).min() > 0


def test_corners_on_a_line_and_points_at_infinity_keep_the_fan():
    row = in_space(np.array([[0, 0], [1, 0], [2, 0], [2, 1], [0, 1]]))
    wild = np.full((5, 3), np.inf)
    flat = np.zeros((5, 3))
    np.testing.assert_array_equal(split(np.stack([row, wild, flat])), [fan(5)] * 3)


def test_a_tight_split_of_a_flat_polygon_covers_it_once():
    points = in_space(OUTLINE)
    triangles = split_tightly(points, np.zeros((len(points),) * 2, bool))
    assert len(triangles) == len(points) - 2
    covered = areas(points, triangles)
    assert (covered > -1e-12).all()
    assert covered.sum() == pytest.approx(np.linalg.norm(area_vector(points)))


def test_a_tight_split_folds_around_corners_and_avoids_chords():
    """A loop around three sides of a cube, whose own sides are the smallest split."""
    loop = np.array(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 1, 1], [1, 1, 1], [0, 1, 1], [0, 1, 0.0]]
    )
    loop[:, 2] *= 0.01

    def split_without(*chords):
        forbidden = np.zeros((8, 8), bool)
        for one, other in chords:
            forbidden[one, other] = forbidden[other, one] = True
        triangles = split_tightly(loop, forbidden)
        a, b, c = (loop[triangles[:, k]] for k in range(3))
        edges = {frozenset((t[k], t[k - 1])) for t in triangles.tolist() for k in range(3)}
        inner = {edge for edge in edges if max(edge) - min(edge) not in (1, 7)}
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, inner

    area, chords = split_without()
    assert len(chords) == 5
    for chord in chords:
        other_area, others = split_without(tuple(chord))
        assert chord not in others
        assert other_area >= area - 1e-5
    assert split_tightly(loop, np.ones((8, 8), bool)) is None
