import ast
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from objectfolder.workspace.code_digests import digests, imported_files, source_digest

ROOT = Path(__file__).parents[2]
SOURCES = [path for path in sorted((ROOT / "objectfolder").rglob("*.py")) if path.stat().st_size]
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
FILES = {
    "objectfolder/__init__.py": '"""Doc."""\n',
    "objectfolder/deep/__init__.py": "",
    "objectfolder/deep/leaf.py": "import numpy\n",
    "objectfolder/middle.py": "def f():\n    from objectfolder.deep import leaf\n",
    "objectfolder/typed.py": "x = 1\n",
    "objectfolder/other.py": "y = 1\n",
    "stages/__init__.py": "import sys\n",
    "stages/solve.py": (
        "from typing import TYPE_CHECKING\n"
        "import objectfolder.middle\n"
        "if TYPE_CHECKING:\n    from objectfolder import typed\n"
        "from stages import run\n"
    ),
}


@pytest.fixture
def project(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_imports_are_followed_into_functions_but_not_into_type_checking(project):
    assert imported_files("stages/solve.py", project) == [
        "objectfolder/__init__.py",
        "objectfolder/deep/leaf.py",
        "objectfolder/middle.py",
        "stages/__init__.py",
        "stages/solve.py",
    ]


def test_digests_change_with_what_is_imported_and_nothing_else(project):
    before = digests("stages/solve.py", project)
    (project / "objectfolder/other.py").write_text("y = 2\n")
    assert digests("stages/solve.py", project) == before
    (project / "objectfolder/deep/leaf.py").write_text("import scipy\n")
    changed = set(digests("stages/solve.py", project).splitlines()) ^ set(before.splitlines())
    assert {line.split()[1] for line in changed} == {"objectfolder/deep/leaf.py"}


def test_layout_comments_and_docstrings_are_not_what_runs():
    for path in SOURCES[::6]:
        source = path.read_text()
        tree = ast.parse(source)
        digest = source_digest(source)
        assert source_digest(ast.unparse(tree)) == digest  # other quotes, lines, brackets, and no comments
        for node in ast.walk(tree):
            if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
                node.body[0].value.value += " And more."
        assert source_digest(ast.unparse(tree)) == digest


def test_strings_that_are_no_docstrings_are_what_runs():
    sources = [
        "def f():\n    pass\n    'one'\n",
        "def f():\n    return 'one'\n",
        "if x:\n    'one'\n",
        "x = 'one'\n",
        "class C:\n    x: 'one'\n",
        "class C:\n    b'one'\n",
    ]
    for source in sources:
        assert source_digest(source) != source_digest(source.replace("one", "two"))


SWAPS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.LtE,
    ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.And: ast.Or, ast.Or: ast.And,
    ast.Pow: ast.Mult, ast.USub: ast.UAdd, ast.Not: ast.Invert, ast.In: ast.NotIn, ast.Is: ast.IsNot,
    ast.MatMult: ast.Mult,
}  # fmt: skip


def mutate(node, rng):
    """Change what a node does in place; return whether it could be."""
    if isinstance(node, ast.Constant) and not isinstance(node.value, bool | None | type(...)):
        node.value = node.value + (
            b"x" if isinstance(node.value, bytes) else "x" if isinstance(node.value, str) else 1
        )
    elif (
        isinstance(node, ast.Name | ast.Attribute | ast.arg | ast.keyword)
        and getattr(node, "arg", "") is not None
    ):
        name = {ast.Name: "id", ast.Attribute: "attr"}.get(type(node), "arg")
        setattr(node, name, f"{getattr(node, name)}_")
    elif type(getattr(node, "op", None)) in SWAPS:
        node.op = SWAPS[type(node.op)]()
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        node.ops[0] = SWAPS[type(node.ops[0])]()
    elif isinstance(getattr(node, "body", None), list) and len(node.body) > 2:
        del node.body[rng.integers(1, len(node.body))]
    else:
        return False
    return True


def test_no_change_of_a_statement_is_missed():
    rng = np.random.default_rng(0)
    counts = Counter()
    short = [path for path in SOURCES if path.stat().st_size < 6000]
    while counts.total() < 300:
        path = short[rng.integers(len(short))]
        source = path.read_text()
        tree = ast.parse(source)
        docstrings = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, DOCUMENTED) and ast.get_docstring(node)
        }
        nodes = [node for node in ast.walk(tree) if id(node) not in docstrings]
        node = nodes[rng.integers(len(nodes))]
        if mutate(node, rng):
            assert source_digest(ast.unparse(tree)) != source_digest(source), (path, ast.unparse(node))
            counts[type(node).__name__] += 1
    assert len(counts) >= 8, counts


def test_relative_imports_are_followed(project):
    (project / "stages/helper.py").write_text("z = 1\n")
    (project / "stages/other.py").write_text("z = 1\n")
    (project / "stages/solve.py").write_text("from . import helper\nfrom .other import z\n")
    (project / "objectfolder/deep/leaf.py").write_text("from .. import middle\nfrom ..other import y\n")
    assert imported_files("stages/solve.py", project) == [
        "stages/__init__.py",
        "stages/helper.py",
        "stages/other.py",
        "stages/solve.py",
    ]
    assert imported_files("objectfolder/deep/leaf.py", project) == [
        "objectfolder/__init__.py",
        "objectfolder/deep/leaf.py",
        "objectfolder/middle.py",
        "objectfolder/other.py",
    ]


def test_modules_that_are_imported_by_name_are_followed(project):
    (project / "objectfolder/deep/leaf.py").write_text('NETS = "objectfolder.deep.*_net"\n')
    for name in ("one_net", "other_net", "net_settings"):
        (project / f"objectfolder/deep/{name}.py").write_text("z = 1\n")
    found = imported_files("objectfolder/deep/leaf.py", project)
    assert [Path(file).stem for file in found] == ["__init__", "leaf", "one_net", "other_net"]


def test_a_module_that_the_pipeline_would_not_see_is_refused(project):
    (project / "own.py").write_text("z = 1\n")
    (project / "stages/solve.py").write_text("import own\n")
    refused(r"stages/solve\.py imports own .* import stages\.own", imported_files, "stages/solve.py", project)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"x = (\n", r"\.py, line 1: '\(' was never closed"), (b"x = '\xe9'\n", "can't decode byte 0xe9")],
)
def test_a_file_that_is_not_python_is_named(project, content, message):
    (project / "objectfolder/middle.py").write_bytes(content)
    refused(f"objectfolder/middle.*{message}", imported_files, "stages/solve.py", project)


def test_a_package_that_lies_beside_its_libraries_is_digested(project):
    (project / "numpy").mkdir()
    (project / "numpy/__init__.py").write_text("")
    assert "objectfolder/deep/leaf.py" in digests("objectfolder/middle.py", project)
    (project / "stages/solve.py").write_text("import numpy\n")
    refused("imports numpy of the workspace", imported_files, "stages/solve.py", project)
