"""A public name of the package stands for one thing."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "objectfolder"
ENTRY_POINT = "main"  # of a process: the command line, the supervisor, Blender's script


def public_names():
    """Modules that define each public class or function at their top level, by name.

    Functions of ``cli`` are left out: a command is named as the function that it calls.
    """
    places = defaultdict(set)
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.parse(path.read_text()).body:
            function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if not (function or isinstance(node, ast.ClassDef)) or node.name.startswith("_"):
                continue
            if not function or (parts[0] != "cli" and node.name != ENTRY_POINT):
                places[node.name].add(".".join(parts).removesuffix(".__init__"))
    return places


def test_a_name_stands_for_one_thing():
    assert not {name: places for name, places in public_names().items() if len(places) > 1}
