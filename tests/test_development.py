"""docs/development.md describes the package as it is, and docs/reference lists every module."""

import re
import sys
import tomllib

from own_workspace import ROOT

sys.path.insert(0, str(ROOT / "docs"))
from conf import modules

PAGE = (ROOT / "docs" / "development.md").read_text()


def rooms_on_the_map():
    """Folders and modules in the first column of the map, from top to bottom."""
    table = PAGE.partition("| in objectfolder/ |")[2].partition("\n\n")[0]
    return [name for row in table.splitlines()[1:] for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


def test_the_map_lists_every_folder_and_module_once():
    package = ROOT / "objectfolder"
    folders = {f"{path.name}/" for path in package.iterdir() if (path / "__init__.py").is_file()}
    modules = {path.name for path in package.glob("*.py")} - {"__init__.py"}
    assert sorted(rooms_on_the_map()) == sorted(folders | modules)


def test_the_map_is_in_the_order_of_the_import_contract():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [re.split(r" [|:] ", layer) for layer in settings["contracts"][0]["layers"]]
    height = {name: i for i, layer in enumerate(layers) for name in layer}
    heights = [height[room.removesuffix("/").removesuffix(".py")] for room in rooms_on_the_map()]
    assert heights == sorted(heights)


def test_every_file_that_the_page_names_exists():
    named = re.findall(r"`((?:objectfolder|stages|tests|perf|docs|params)/[\w./]*)`", PAGE)
    assert len(named) > 30
    assert [name for name in named if "NAME" not in name and not (ROOT / name).exists()] == []


def test_every_module_is_on_a_page_of_the_reference():
    pages = "\n".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.rst"))
    listed = set(re.findall(r"automodule:: (\S+)", pages))
    for package, skipped in re.findall(r"package:: (\S+)(?:\n +:skip: (.*))?", pages):
        elsewhere = tuple(f"{package}.{name}." for name in skipped.split())
        listed |= {name for name in modules(package) if not f"{name}.".startswith(elsewhere)}
    assert set(modules("objectfolder")) - listed == set()
