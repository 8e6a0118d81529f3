import numpy as np

from objectfolder.benchmarks.datasets.splits import Companions, Split

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
        others = {other for other in part if LABELS[other] == LABELS[row]} - {row}
        assert set(group[1:]) == (others or {row})


def test_no_companion_is_drawn_twice_while_there_are_others():
    labels = np.zeros(40, int)
    companions = Companions(Split("seen", np.arange(20), np.arange(20, 24), np.arange(24, 40)), labels)
    drawn = companions.draw(np.arange(24, 40), 16, np.random.default_rng(0))
    assert np.array_equal(np.sort(drawn, 1), np.tile(np.arange(24, 40), (16, 1)))
    assert len(np.unique(drawn[:, 1])) > 5, "in random order"
    counts = np.stack(
        [
            np.bincount(row, minlength=24)[20:]
            for row in companions.draw([20, 23], 10, np.random.default_rng(0))
        ]
    )
    assert counts[0].tolist() == [1, 3, 3, 3]
    assert counts[1].tolist() == [3, 3, 3, 1]


def test_one_row_is_itself():
    assert Companions(SPLIT, LABELS).draw(TEST, 1, np.random.default_rng(0)).tolist() == [[9], [18], [19]]
