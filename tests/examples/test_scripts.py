"""Scripts of the tutorials are short, and each is on the page that it names, as it is to be run."""

import ast
import re

import pytest
from own_workspace import ROOT

SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
LONGEST = 60  #: lines


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_is_short_and_its_page_shows_how_to_run_it(script):
    text = script.read_text()
    assert len(text.splitlines()) <= LONGEST
    first, *_, command = ast.get_docstring(ast.parse(text)).splitlines()
    page = ROOT / re.search(r"docs/tutorials/\w+\.md", first)[0]
    assert command.startswith(f"python CLONE/examples/{script.name} ")
    assert command in page.read_text().splitlines()


def test_every_tutorial_has_a_script():
    named = {re.search(r"docs/tutorials/(\w+)\.md", script.read_text())[1] for script in SCRIPTS}
    assert named == {page.stem for page in (ROOT / "docs" / "tutorials").glob("*.md")}
