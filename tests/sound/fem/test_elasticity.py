import numpy as np
import pytest

from objectfolder.sound.fem.elasticity import scatter, upper_blocks


@pytest.mark.parametrize("size", [1, 3])
def test_sum_of_element_matrices_is_the_dense_sum_and_exactly_symmetric(size, rng):
    nodes, count = 30, 40
    connectivity = np.stack([rng.permutation(nodes)[:5] for _ in range(count)])
    matrices = rng.standard_normal((count, 5 * size, 5 * size))
    matrices += matrices.swapaxes(1, 2)
    expected = np.zeros((nodes * size,) * 2)
    for matrix, own in zip(matrices, connectivity):
        unknowns = (size * own[:, None] + np.arange(size)).ravel()
        expected[np.ix_(unknowns, unknowns)] += matrix
    found = scatter(upper_blocks(matrices, size), connectivity, nodes)
    np.testing.assert_allclose(found.toarray(), expected, rtol=0, atol=1e-13)
    assert abs(found - found.T).nnz == 0
    assert found.has_canonical_format


def test_rounding_in_an_element_matrix_does_not_unbalance_the_sum():
    matrix = np.array([[2.0, 1.0], [1.0 + 1e-15, 3.0]])
    found = scatter(upper_blocks(matrix[None], 2), np.array([[0]]), 1).toarray()
    assert found[0, 1] == found[1, 0] == 1 + 5e-16
