"""No code of this project unpickles arrays, whatever numpy's default is or becomes."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("objectfolder", "stages", "perf", "fuzz", "docs", "tests")


def calls_of_load():
    """Calls of ``np.load`` and places, in all code."""
    for path in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if ".load(" in text else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.load", "numpy.load"):
                yield node, f"{path.relative_to(ROOT)}:{node.lineno}"


def test_every_load_says_that_it_unpickles_nothing():
    found = list(calls_of_load())
    assert len(found) > 20
    assert [
        place for call, place in found if "allow_pickle=False" not in map(ast.unparse, call.keywords)
    ] == []
