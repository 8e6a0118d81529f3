"""What `pack` says in the header."""

import pytest

from objectfolder.objectfile.packing import ESTIMATING, certainty
from objectfolder.sound.fem.certainty import CUT_CELLS


@pytest.mark.parametrize(
    ("error", "element", "modes", "said"),
    [
        (0.02, CUT_CELLS, 9, {"frequency_uncertainty": 0.02}),
        (None, CUT_CELLS, 9, {"frequency_uncertainty_unknown": True}),
        (None, CUT_CELLS, 0, {}),
        (None, "tet10", 9, {}),
    ],
)
def test_an_error_that_cells_could_not_estimate_is_said_to_be_unknown(error, element, modes, said):
    report = {"frequency_uncertainty": error, "element": element, "modes": modes}
    assert certainty(report) == said
    assert certainty(report | {"uncertain": True}) == (said | {"uncertain": True} if said else {})
    assert ESTIMATING == CUT_CELLS
