import numpy as np
import pytest

from objectfolder.benchmarks.scoring.together import accuracy_together, bound_alone, bound_together

LABELS = np.array([0, 0, 0, 1, 1])
OBJECTS = np.array([5, 5, 5, 2, 2])
#: Two observations speak for the first object's class, and one, more strongly, for the other.
SCORES = np.array([[2, 0], [2, 0], [0, 3], [0, 1], [0, 1]])
FLAT = np.array([1, 1, 0, 0, 1, 1, 1, 1], bool)
OF_TWO = np.repeat([0, 1], 4)


def _accuracy(size, scores=SCORES):
    return accuracy_together(scores, LABELS, OBJECTS, size, np.random.default_rng(0))


def test_groups_answer_by_the_mean_of_their_log_probabilities():
    assert _accuracy(1) == pytest.approx((2 / 3 + 1) / 2)  # every observation once
    # Two of the three pairs hold the wrong one; standard error of 100 draws 0.024.
    assert _accuracy(2) == pytest.approx((1 / 3 + 1) / 2, abs=0.1)
    assert _accuracy(3) == 1.0  # 4 of 7; the second object has too few
    assert _accuracy(4) is None


def test_a_group_holds_no_observation_twice():
    """A pair with the same observation twice would be wrong in a quarter of the draws."""
    scores = np.array([[3, 0], [0, 2], [3, 0], [0, 1], [0, 1]])
    assert _accuracy(2, scores) == 1.0


def test_flat_observations_are_all_answered_alike():
    # Half of the first object's and all of the second's: 0.25 are lost, those of the first.
    assert bound_together(FLAT, OF_TWO, OF_TWO, 1) == pytest.approx(0.75)
    # One of six pairs of the first object is flat throughout.
    assert bound_together(FLAT, OF_TWO, OF_TWO, 2) == pytest.approx(1 - 1 / 12)
    assert bound_together(FLAT, OF_TWO, OF_TWO, 4) == 1.0
    assert bound_together(FLAT, OF_TWO, OF_TWO, 5) is None
    assert bound_together(~FLAT & False, OF_TWO, OF_TWO, 1) == 1.0
    # Of one class there is nothing to confuse.
    assert bound_together(FLAT, 0 * OF_TWO, OF_TWO, 1) == 1.0


def test_the_best_answers_reach_the_bound():
    """Certain where the ground is not flat; the same for all flat observations."""
    scores = np.where(FLAT[:, None], [0.0, 1.0], 100.0 * np.eye(2)[OF_TWO])
    accuracy = accuracy_together(scores, OF_TWO, OF_TWO, 1, np.random.default_rng(0))
    assert accuracy == bound_together(FLAT, OF_TWO, OF_TWO, 1)


def test_alone_the_bound_is_one_of_rows_not_of_objects():
    objects = np.repeat([0, 1, 2], [9, 1, 1])
    flat = objects > 0
    best = np.where(flat, 1, objects)  # all others right, flat ones alike
    assert bound_alone(flat, objects) == np.mean(best == objects)
    assert bound_together(flat, objects, objects, 1) < bound_alone(flat, objects)
    assert bound_alone(flat & False, objects) == 1.0
