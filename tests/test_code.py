"""Rules that all code keeps."""

import ast
from collections import defaultdict

from own_workspace import ROOT

FOLDERS = ("objectfolder", "stages", "examples", "perf", "fuzz", "docs", "tests")
PACKAGE = ROOT / "objectfolder"
TRAINING = "train"
ENTRY_POINT = "main"  # of a process: the command line, the supervisor, Blender's script


def public_names():
    """Modules that define each public class or function at their top level, by name.

    Functions of ``cli`` are left out: a command is named as the function that it calls. So are the trainings
    of nets, which the stages find by their name.
    """
    places = defaultdict(set)
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.parse(path.read_text()).body:
            function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if not (function or isinstance(node, ast.ClassDef)) or node.name.startswith("_"):
                continue
            if not function or (parts[0] != "cli" and node.name not in (ENTRY_POINT, TRAINING)):
                places[node.name].add(".".join(parts).removesuffix(".__init__"))
    return places


def test_a_public_name_of_the_package_stands_for_one_thing():
    assert not {name: places for name, places in public_names().items() if len(places) > 1}


def calls_of_load():
    """Calls of ``np.load`` and places, in all code."""
    for path in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if ".load(" in text else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.load", "numpy.load"):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", [ast.unparse(word) for word in node.keywords]


def test_no_code_unpickles_arrays_whatever_the_default_of_numpy_is():
    found = list(calls_of_load())
    assert len(found) > 20
    assert [place for place, words in found if "allow_pickle=False" not in words] == []
