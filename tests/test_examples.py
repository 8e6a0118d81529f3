"""What README.md, docs/ and docstrings show: Python runs, arrays have the shapes that comments give, commands
exist with their options."""

import ast
import doctest
import importlib
import re
import shlex
import shutil
import tokenize
from io import StringIO

import numpy as np
import pytest
from index_rows import BELL
from markdown_it import MarkdownIt
from own_workspace import ROOT
from typer.main import get_command

from objectfolder.base.io import file_digest
from objectfolder.cli import app
from objectfolder.hub.release.entries import index_text
from objectfolder.mesh.raycast import RayCaster
from objectfolder.objectfile.dataset import INDEX, IndexEntry
from objectfolder.objectfile.samples import sample_path

FOLDERS = ("docs", "docs/tutorials")
PAGES = [ROOT / "README.md", *sorted(page for folder in FOLDERS for page in (ROOT / folder).glob("*.md"))]
MODULES = ["objectfolder", "objectfolder.objectfile.file", "objectfolder.objectfile.query_files"]
#: A comment that begins with a shape: ``(N, 160, 120, 3) uint8``.
SHAPE = re.compile(r"#\s*\(((?:\w+,\s*)*\w*)\)")


def blocks(page, *languages):
    """Fenced code of a page, with the line that it starts on."""
    tokens = MarkdownIt().parse(page.read_text())
    return [(t.map[0] + 1, t.content) for t in tokens if t.type == "fence" and t.info in languages]


def python_pages():
    return [page for page in PAGES if blocks(page, "python")]


def shape_comments(source):
    """Shape that the comment on a line gives, by line number."""
    tokens = tokenize.generate_tokens(StringIO(source).readline)
    found = ((t.start[0], SHAPE.match(t.string)) for t in tokens if t.type == tokenize.COMMENT)
    return {line: match[1].replace(" ", "").strip(",").split(",") for line, match in found if match}


def fits(shape, stated):
    """Whether a shape is the stated one, in which a letter is any number."""
    return len(shape) == len(stated) and all(not s.isdigit() or int(s) == n for s, n in zip(stated, shape))


def run(source, names):
    """Execute statements; what a line with a shape in its comment gives has that shape. Returns how many."""
    stated, checked = shape_comments(source), 0
    for statement in ast.parse(source).body:
        is_value = isinstance(statement, ast.Expr)
        code = ast.Expression(statement.value) if is_value else ast.Module([statement], [])
        value = eval(compile(code, "example", "eval" if is_value else "exec"), names)
        if statement.end_lineno not in stated:
            continue
        if isinstance(statement, ast.Assign):
            value = names[statement.targets[0].id]
        for array in value if isinstance(value, tuple) else (value,):
            assert fits(np.shape(array), stated[statement.end_lineno]), ast.unparse(statement)
            checked += 1
    return checked


@pytest.fixture
def workspace(brick_path, tmp_path, monkeypatch):
    """A folder with build/mug/ObjectFile.safetensors, which is the brick, and a release of the bell."""
    (tmp_path / "build" / "mug").mkdir(parents=True)
    (tmp_path / "build" / "mug" / "ObjectFile.safetensors").symlink_to(brick_path)
    sample = sample_path("bell")
    held = {"category": "household", "bytes": sample.stat().st_size, "sha256": file_digest(sample)}
    bell = IndexEntry(**BELL | held)
    (tmp_path / "kitchen" / "objects").mkdir(parents=True)
    shutil.copyfile(sample, tmp_path / "kitchen" / bell.path)
    (tmp_path / "kitchen" / INDEX).write_text(index_text([bell]))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def names(brick, workspace):
    """What examples take for granted: README's first lines, and what a contact is made of."""
    caster = RayCaster(brick.surface.vertices * brick.scale, brick.surface.faces)
    names = {"points": brick.sample_surface(2), "angles": np.zeros(2), "depths": np.full(2, 0.001)}
    names |= {"normals": np.eye(3)[:2], "forces": np.eye(3)[:2], "caster": caster}
    return names | {"np": np, "mug": brick}


def test_the_readme_runs_from_its_first_line(workspace, capsys):
    names = {}
    checked = sum(run(source, names) for _, source in blocks(ROOT / "README.md", "python"))
    assert checked >= 3
    assert "plastic 0.1 m; 12 modes from" in capsys.readouterr().out


@pytest.mark.parametrize("page", python_pages(), ids=lambda page: page.name)
def test_python_examples_run(page, names):
    for _, source in blocks(page, "python"):
        run(source, names)


def test_shapes_in_comments_are_compared():
    assert run("x = np.zeros((2, 3))  # (2, N) m", {"np": np}) == 1
    for source in ("np.zeros((2, 3))  # (N, 4)", "1  # (N,)"):
        with pytest.raises(AssertionError):
            run(source, {"np": np})


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples_run(name, names):
    module = importlib.import_module(name)
    tests = doctest.DocTestFinder(exclude_empty=True).find(module, extraglobs=names)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    tests = [test for test in tests if test.examples]
    assert tests, f"{name} shows no example"
    assert not any(example.options.get(doctest.SKIP) for test in tests for example in test.examples)
    for test in tests:
        report = []
        assert runner.run(test, out=report.append).failed == 0, "".join(report)


def command_lines():
    """In fences, to be parsed whole; in running text and help, of which only the options count."""
    for page in PAGES:
        for line, source in blocks(page, "bash", ""):
            for row in source.replace("\\\n", " ").splitlines():
                if row.startswith("objectfolder "):
                    yield pytest.param(row, True, id=f"{page.name}:{line}: {row.split('  ')[0]}")
    for page in [*PAGES, *sorted((ROOT / "objectfolder" / "cli").glob("*.py"))]:
        for match in re.finditer(r"`(objectfolder [a-z-][^`]*)`", page.read_text()):
            yield pytest.param(match[1], False, id=f"{page.name}: {match[1]}")


def parse(arguments, whole):
    """Parse a command line without running it; not whole: only its command and options have to exist."""
    command, context, path = get_command(app), None, "objectfolder"
    while hasattr(command, "commands") and arguments and not arguments[0].startswith("-"):
        path, arguments = arguments[0], arguments[1:]
        choices = [path] if "|" not in path else path.split("|")
        missing = [name for name in choices if name not in command.commands]
        assert not missing, f"there is no command {missing}; there are {list(command.commands)}"
        command = command.commands[choices[0]]
    if whole:
        for param in command.params:
            param.callback = None  # looks for Object Files
        command.make_context(path, arguments, parent=context)
        return
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    for argument in arguments:
        option = argument.partition("=")[0]
        number = option[1:].replace(".", "", 1).isdigit()
        assert number or not option.startswith("-") or option in known, f"{path} has no {option}"


@pytest.mark.parametrize(("line", "whole"), [*command_lines()])
def test_commands_exist_with_their_options(line, whole):
    if not whole:
        line = re.sub(r"[\[\]]|\.\.\.", " ", line)
    parse(shlex.split(line, comments=True)[1:], whole)


WRONG = dict.fromkeys(("buidl", "query smell f", "query vision|smell", "build --no-such"), False)
WRONG |= {"sample vision --resolution 3": False, "sample vision": True}
WRONG |= {"sample vision x.npy -n few": True, "add kettle.obj --nam kettle": True}


@pytest.mark.parametrize(("line", "whole"), WRONG.items())
def test_wrong_commands_are_found(line, whole):
    with pytest.raises(Exception, match=r"no command|has no|Missing|No such|a whole number|a valid integer"):
        parse(line.split(), whole)
