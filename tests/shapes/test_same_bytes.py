"""Equal parameters give equal files, also in another process with other string hashes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import procedural_cases
import pytest
from procedural_cases import CASES, digests

from objectfolder.shapes import GENERATORS

ROOT = Path(__file__).parents[2]


def test_every_generator_has_a_case():
    assert {generator for generator, _ in CASES.values()} == set(GENERATORS)


@pytest.mark.slow
@pytest.mark.parametrize("collection", ["generators", "cases", "catalogue"])
def test_equal_parameters_give_equal_files(collection):
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests/support")])
    other = subprocess.Popen(
        [sys.executable, procedural_cases.__file__, collection],
        env=os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "7"},
        stdout=subprocess.PIPE,
        text=True,
    )
    with other:
        here = digests(collection)
        assert json.loads(other.communicate()[0]) == here
    assert len(here) >= len(GENERATORS)
