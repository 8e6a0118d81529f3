import numpy as np
import pytest
from sklearn.cross_decomposition import CCA

from objectfolder.benchmarks.models.baselines import find_directions, fit_whitening


@pytest.fixture
def two_senses():
    """Four objects with five rows each: features of 3 and of 4 numbers that share what the objects are."""
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(4), 5)
    nature = rng.normal(size=(4, 3))[labels]
    first = nature @ rng.normal(size=(3, 3)) + 0.5 * rng.normal(size=(20, 3)) + 7
    second = nature @ rng.normal(size=(3, 4)) + 0.5 * rng.normal(size=(20, 4)) - 2
    return first, second, labels


def all_pairs(first, second, labels):
    i, j = np.nonzero(labels[:, None] == labels)
    return first[i], second[j]


def variates(first, second, labels):
    """Canonical variates of all pairs."""
    white = [fit_whitening(x, 10)(x) for x in (first, second)]
    pairs = all_pairs(*white, labels)
    return [x @ matrix for x, matrix in zip(pairs, find_directions(*white, labels))]


def correlations(a, b):
    return [np.corrcoef(x, y)[0, 1] for x, y in zip(a.T, b.T)]


def test_is_scikit_learns_cca_on_all_pairs(two_senses):
    pairs = all_pairs(*two_senses)
    theirs = CCA(n_components=2, max_iter=5000, tol=1e-12).fit(*pairs).transform(*pairs)
    ours = [x[:, :2] for x in variates(*two_senses)]
    assert correlations(*ours) == pytest.approx(correlations(*theirs), abs=1e-6)
    for mine, other in zip(ours, theirs):
        assert np.abs(correlations(mine, other)) == pytest.approx(1, abs=1e-5)


def test_variates_are_white_and_correlated_one_by_one(two_senses):
    a, b = variates(*two_senses)
    assert a.shape[1] == b.shape[1] == 3  # four objects span three directions
    for x in (a, b):
        np.testing.assert_allclose(x.mean(0), 0, atol=1e-9)
        np.testing.assert_allclose(x.T @ x / len(x), np.eye(3), atol=1e-9)
    cross = a.T @ b / len(a)
    np.testing.assert_allclose(cross, np.diag(np.diag(cross)), atol=1e-9)
    assert np.all(np.diff(np.diag(cross)) < 0)


def test_components_are_principal(two_senses):
    first = two_senses[0] * np.array([100, 1, 1])
    left, _, axes = np.linalg.svd(first - first.mean(0), full_matrices=False)
    components = fit_whitening(first, 2)(first)
    np.testing.assert_allclose(np.abs(components), np.abs(left[:, :2]) * np.sqrt(20), atol=1e-9)
    np.testing.assert_allclose(fit_whitening(first, 3)(first)[:, :2], components)
    # Rows that were not fitted are mapped alike.
    moved = fit_whitening(first, 2)(first + 5 * axes[2])
    np.testing.assert_allclose(moved, components, atol=1e-9)


def test_constant_and_repeated_features_are_ignored(two_senses):
    first = two_senses[0]
    degenerate = np.concatenate([first, first[:, :1], np.full((20, 1), 5.0)], axis=1)
    assert fit_whitening(degenerate, 10)(degenerate).shape == (20, 3)
    assert fit_whitening(first, 10)(first).shape == (20, 3)


def test_the_order_of_an_objects_rows_does_not_matter(two_senses):
    first, second, labels = two_senses
    within = np.concatenate([5 * i + np.random.default_rng(i).permutation(5) for i in range(4)])
    plain, other = (find_directions(first, x, labels) for x in (second, second[within]))
    for a, b in zip(plain, other):
        np.testing.assert_allclose(np.abs(a), np.abs(b), atol=1e-9)
