"""What `pack` says in the header."""

import pytest

from objectfolder.fem.cutcell import CUT_CELLS
from objectfolder.objectfile.packing import ESTIMATING, certainty


@pytest.mark.parametrize(
    ("modal", "said"),
    [
        ({"frequency_uncertainty": 0.02, "element": CUT_CELLS, "modes": 9}, {"frequency_uncertainty": 0.02}),
        (
            {"frequency_uncertainty": None, "element": CUT_CELLS, "modes": 9},
            {"frequency_uncertainty_unknown": True},
        ),
        ({"frequency_uncertainty": None, "element": CUT_CELLS, "modes": 0}, {}),
        ({"frequency_uncertainty": None, "element": "tet10", "modes": 9}, {}),
    ],
)
def test_an_error_that_cells_could_not_estimate_is_said_to_be_unknown(error, element, modes, said):
    assert certainty({"frequency_uncertainty": error, "element": element, "modes": modes}) == said
    assert ESTIMATING == CUT_CELLS
