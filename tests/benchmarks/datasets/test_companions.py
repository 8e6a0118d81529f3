import numpy as np

from objectfolder.benchmarks.datasets.companions import Companions
from objectfolder.benchmarks.datasets.splits import Split

LABELS = np.repeat([0, 1], 10)
TEST = np.array([9, 18, 19])
SPLIT = Split("seen", np.array([0, 1, 2, 3, 10, 11, 12, 13]), np.array([4, 14]), TEST)


def test_companions_are_of_the_same_object_and_part():
    companions, rng = Companions(SPLIT, LABELS), np.random.default_rng(0)
    rows = np.concatenate([SPLIT.train, SPLIT.val, TEST])
    drawn = companions.draw(rows, 50, rng)
    assert np.array_equal(drawn[:, 0], rows)
    for row, group in zip(rows, drawn):
        part = next(part for part in (SPLIT.train, SPLIT.val, TEST) if row in part)
        assert set(group) == {other for other in part if LABELS[other] == LABELS[row]}


def test_one_row_is_itself():
    assert Companions(SPLIT, LABELS).draw(TEST, 1, np.random.default_rng(0)).tolist() == [[9], [18], [19]]
