from itertools import permutations

import numpy as np
import pytest
from refusals import refused
from scipy import stats
from sklearn.metrics import average_precision_score

from objectfolder.benchmarks.scoring import scores
from objectfolder.benchmarks.scoring.scores import (
    accuracy,
    chance_map,
    interval_95,
    mean_average_precision,
    share_95,
    wilson_95,
)


def on_circle(*degrees):
    angles = np.radians(degrees)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def by_definition(relevant):
    """Average precision of a ranking, spelled out."""
    ranks = np.flatnonzero(relevant) + 1
    return np.mean([np.sum(ranks <= rank) / rank for rank in ranks])


def test_accuracy_counts_the_right_ones():
    assert accuracy(np.array([2, 0, 1, 1]), np.array([2, 1, 1, 0])) == 0.5
    for predicted, labels, message in (([1, 2], [1], "expected equal"), ([], [], "not empty")):
        refused(message, accuracy, np.array(predicted, int), np.array(labels, int))


def test_interval_is_students():
    # t(0.975, 2) = 4.3027, deviation 1, three values; and from scipy's own interval.
    assert interval_95([1.0, 2.0, 3.0]) == pytest.approx(4.302653 / np.sqrt(3), rel=1e-6)
    values = [0.2, 0.5, 0.9, 0.4]
    low, high = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert interval_95(values) == pytest.approx((high - low) / 2, rel=1e-12)
    assert interval_95([0.7, 0.7]) == 0
    assert interval_95([0.7]) is None


def test_interval_covers_the_mean_in_95_of_100_cases():
    draws = np.random.default_rng(0).normal(3, 2, (4000, 3))
    covered = [abs(np.mean(row) - 3) <= interval_95(row) for row in draws]
    assert np.mean(covered) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 4000))


def test_hand_computed_ranking():
    # Ranked by angle to the query: labels 0 1 0 1 1 0, so precision 1/1, 2/3 and 3/6 at the zeros.
    gallery = on_circle(150, 20, 60, 100, 10, 130)
    labels = np.array([0, 1, 0, 1, 0, 1])
    expected = (1 + 2 / 3 + 3 / 6) / 3
    assert mean_average_precision(on_circle(0), [0], gallery, labels) == pytest.approx(expected, rel=1e-12)
    # Of the ones: ranks 2, 4, 5. The mean is over queries.
    other = (1 / 2 + 2 / 4 + 3 / 5) / 3
    both = mean_average_precision(on_circle(0, 0), [0, 1], gallery, labels)
    assert both == pytest.approx((expected + other) / 2, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_scikit_learn_without_ties_whatever_the_lengths(seed):
    rng = np.random.default_rng(seed)
    queries, gallery = rng.normal(size=(15, 3)), rng.normal(size=(31, 3))
    query_labels = rng.integers(0, 4, 15)
    labels = np.append(rng.integers(0, 4, 27), np.arange(4))
    cosines = queries @ gallery.T / np.linalg.norm(gallery, axis=1)
    expected = [average_precision_score(labels == l, row) for l, row in zip(query_labels, cosines)]
    longer = queries * rng.uniform(1e-200, 1, (15, 1)), gallery * rng.uniform(1e-3, 1e200, (31, 1))
    for asked, ranked in ((queries, gallery), longer):
        value = mean_average_precision(asked, query_labels, ranked, labels)
        assert value == pytest.approx(np.mean(expected), rel=1e-12)


def test_no_query_finds_itself():
    rng = np.random.default_rng(6)
    rows = rng.normal(size=(20, 3))
    labels = np.append(rng.integers(0, 4, 12), np.tile(np.arange(4), 2))
    others = [np.arange(20) != i for i in range(7)]
    expected = [
        mean_average_precision(rows[i : i + 1], labels[i : i + 1], rows[other], labels[other])
        for i, other in enumerate(others)
    ]
    value = mean_average_precision(rows[:7], labels[:7], rows, labels, own=True)
    assert value == pytest.approx(np.mean(expected), rel=1e-12)
    chances = [chance_map(labels[other], labels[i : i + 1]) for i, other in enumerate(others)]
    assert chance_map(labels, labels[:7], own=True) == pytest.approx(np.mean(chances), rel=1e-12)
    refused("label 9", mean_average_precision, rows[:1], [9], rows[:3], [9, 1, 1], own=True)


def test_ties_score_the_mean_over_all_their_orders():
    # Directions 10 (twice), 40 (four times) and 90 degrees; the first of a run differ in length only.
    degrees = np.array([10, 10, 40, 40, 40, 40, 90])
    gallery = on_circle(*degrees) * np.array([1, 3, 0.5, 2, 1, 7, 1])[:, None]
    labels = np.array([1, 0, 0, 1, 0, 1, 0])
    sorted_by_angle = [
        by_definition(labels[list(order)] == 0)
        for order in permutations(range(7))
        if np.all(np.diff(degrees[list(order)]) >= 0)
    ]
    assert len(sorted_by_angle) == 2 * 24
    value = mean_average_precision(on_circle(0), [0], gallery, labels)
    assert value == pytest.approx(np.mean(sorted_by_angle), rel=1e-12)


def test_probabilities_are_ranked_by_their_product():
    """Of two rows that may be of the query's class, the surer comes first, whatever else they may be."""
    query = np.array([[1.0, 0, 0, 0]])
    gallery, labels = np.array([[0.4, 0.2, 0.2, 0.2], [0.5, 0.5, 0, 0]]), np.array([1, 0])
    assert mean_average_precision(query, labels[1:], gallery, labels, cosine=False) == 1
    assert mean_average_precision(query, labels[1:], gallery, labels) == 0.5


def test_rows_that_are_nearly_ruled_out_still_have_an_order():
    query, gallery = np.array([[1.0, 0]]), np.array([[1e-30, 1.0], [1e-20, 1.0], [0, 1.0]])
    assert mean_average_precision(query, [0], gallery, np.array([1, 0, 1]), cosine=False) == 1
    own = np.array([[1.0, 0], [0.9, 0.1], [0.2, 0.8], [0.1, 0.9]])
    labels = np.array([0, 0, 1, 1])
    assert mean_average_precision(own, labels, own, labels, own=True, cosine=False) == 1


def test_the_product_ranks_true_probabilities_better_than_their_cosine():
    rng = np.random.default_rng(0)
    given = rng.dirichlet(np.full(5, 0.3), 600)
    labels = np.array([rng.choice(5, p=p) for p in given])
    arguments = given[:300], labels[:300], given[300:], labels[300:]
    product, cosine = (mean_average_precision(*arguments, cosine=cosine) for cosine in (False, True))
    assert product > cosine > chance_map(labels[300:], labels[:300])


def test_the_order_of_the_gallery_does_not_matter():
    rng = np.random.default_rng(2)
    gallery = rng.integers(-1, 2, (40, 2)).astype(float)  # many ties, some zero embeddings
    queries, query_labels, labels = rng.normal(size=(6, 2)), np.arange(6) % 3, np.sort(np.arange(40) % 3)
    value = mean_average_precision(queries, query_labels, gallery, labels)
    for _ in range(5):
        order = rng.permutation(40)
        shuffled = mean_average_precision(queries, query_labels, gallery[order], labels[order])
        assert shuffled == pytest.approx(value, rel=1e-12)


def test_embeddings_that_say_nothing_score_chance():
    labels = np.array([0, 0, 0, 1, 2, 2, 2, 2, 2])
    queries = np.array([0, 1, 1, 2])
    for embedding in (np.full((9, 5), 0.3), np.zeros((9, 5))):
        value = mean_average_precision(embedding[:4], queries, embedding, labels)
        assert value == pytest.approx(chance_map(labels, queries), rel=1e-12)


def test_blocks_of_queries_do_not_change_the_mean(monkeypatch):
    rng = np.random.default_rng(3)
    arguments = rng.normal(size=(11, 3)), np.arange(11) % 2, rng.normal(size=(8, 3)), np.arange(8) % 2
    whole = mean_average_precision(*arguments)
    monkeypatch.setattr(scores, "BLOCK", 4)
    assert mean_average_precision(*arguments) == pytest.approx(whole, rel=1e-12)


def test_chance_is_the_mean_over_all_rankings():
    for count, relevant in [(1, 1), (5, 1), (5, 2), (6, 3), (6, 5), (4, 4)]:
        labels = np.arange(count) < relevant
        every = [by_definition(labels[list(order)]) for order in permutations(range(count))]
        assert chance_map(labels.astype(int), [1]) == pytest.approx(np.mean(every), rel=1e-12)


def test_chance_averages_over_queries():
    labels = np.array([0, 1, 1, 1])
    assert chance_map(labels, [0, 1]) == pytest.approx(np.mean([chance_map(labels, [i]) for i in (0, 1)]))
    assert chance_map(labels, [0]) == pytest.approx((1 + 1 / 2 + 1 / 3 + 1 / 4) / 4)


def test_refused():
    one, labels = np.ones((1, 2)), np.array([0])
    for query, gallery, message in (
        (7, one, "relevant to queries of label 7"),
        (0, one * np.nan, "gallery embedding 0 is not finite"),
    ):
        refused(message, mean_average_precision, one, np.array([query]), gallery, labels)
    refused("no query", chance_map, labels, np.array([], int))


def by_wilson(share, count, z=1.959963984540054):
    """Ends of the interval by Wilson's formula."""
    middle = share + z**2 / (2 * count)
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return (middle - half) / (1 + z**2 / count), (middle + half) / (1 + z**2 / count)


@pytest.mark.parametrize(("right", "count"), [(0, 5), (7, 7), (3, 10), (150, 200)])
def test_wilsons_interval(right, count):
    assert wilson_95(right, count) == pytest.approx(by_wilson(right / count, count), abs=1e-12)
    share = share_95(np.arange(count) < right)
    assert share == {"rate": right / count, "interval_95": list(wilson_95(right, count))}


def test_wilsons_interval_of_a_published_example():
    assert wilson_95(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)  # Newcombe 1998, Table I
