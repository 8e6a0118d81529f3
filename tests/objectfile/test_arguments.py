import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.stored import arguments

ROWS = np.array([[1.0, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    "values",
    [
        ROWS.tolist(),
        ROWS.astype(np.float16),
        ROWS.astype(">f4"),
        ROWS.astype(np.int8),
        np.asfortranarray(ROWS),
        np.repeat(ROWS, 2, axis=1)[:, ::2],
        ROWS[::-1][::-1],
        torch.from_numpy(ROWS),
        torch.from_numpy(ROWS).to(torch.bfloat16),
        torch.from_numpy(ROWS).half().requires_grad_(),
        torch.from_numpy(ROWS.T.copy()).T,
    ],
)
def test_rows_of_any_kind_are_the_same_rows(values):
    np.testing.assert_array_equal(arguments.finite_rows("points", values, 3), ROWS)
    assert arguments.finite_rows("points", values, 3).dtype == np.float64


def test_the_array_is_a_copy():
    given = ROWS.copy()
    arguments.finite_rows("points", given, 3)[:] = 0
    np.testing.assert_array_equal(given, ROWS)


def test_one_row_and_none():
    assert arguments.finite_rows("points", [1, 2, 3], 3).shape == (1, 3)
    assert arguments.finite_rows("points", np.zeros((0, 3)), 3).shape == (0, 3)
    assert arguments.finite_rows("points", torch.zeros(0, 3), 3).shape == (0, 3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([], r"points has shape \(0,\), expected \(N, 3\)"),
        (ROWS[None], r"points has shape \(1, 2, 3\)"),
        ([[1, 2], [3]], "points is not an array of numbers"),
        ("abc", "points holds <U3"),
        (ROWS + 1j, "points holds complex128, expected real numbers"),
        (torch.zeros(2, 3, dtype=torch.complex64), "points holds complex64, expected real numbers"),
        (ROWS > 2, "points holds bool"),
        (np.array([[None] * 3]), "points holds object"),
        (None, "points holds object"),
        ([[1, 2, np.nan]], r"points: row 0 is \[1.0, 2.0, nan\]"),
        (torch.tensor([[1.0, 2, 3], [1, torch.inf, 3]]), r"points: row 1 is \[1.0, inf, 3.0\]"),
    ],
)
def test_what_are_no_rows_is_refused(values, message):
    refused(message, arguments.finite_rows, "points", values, 3)
