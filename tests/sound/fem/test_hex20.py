import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objectfolder.sound.fem.hex20 import NODES, shape_functions, shape_gradients

coordinates = st.lists(st.floats(-1, 1, width=32), min_size=3, max_size=3).map(lambda x: np.array([x]))


def test_each_shape_function_is_one_at_its_node_and_zero_at_the_others():
    np.testing.assert_allclose(shape_functions(NODES), np.eye(20), atol=1e-15)


def test_nodes_are_the_corners_and_edge_midpoints():
    zeros = (NODES == 0).sum(1)
    assert zeros[:8].tolist() == [0] * 8
    assert zeros[8:].tolist() == [1] * 12
    assert len(np.unique(NODES, axis=0)) == 20


@given(coordinates)
def test_partition_of_unity(point):
    assert shape_functions(point).sum() == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(shape_gradients(point).sum(1), 0, atol=1e-14)


@given(coordinates)
def test_every_quadratic_polynomial_is_reproduced(point):
    def field(p):
        x, y, z = p.T
        return np.stack([1 + 2 * x - 3 * y + 5 * z, x * x - y * z, x * y * z + y * y, z * z + x * z], 1)

    np.testing.assert_allclose(shape_functions(point) @ field(NODES), field(point), atol=1e-14)


@given(coordinates, st.integers(0, 2))
def test_gradients_are_those_of_the_shape_functions(point, axis):
    # Each function is at most quadratic along an axis: a central difference is exact up to rounding.
    step = 2.0**-8 * np.eye(3)[axis]
    difference = (shape_functions(point + step) - shape_functions(point - step)) * 2.0**7
    np.testing.assert_allclose(shape_gradients(point)[..., axis], difference, atol=1e-12)
