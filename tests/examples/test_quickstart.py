"""examples/quickstart.ipynb: its cells run with the base install, and print what is stored with them."""

import ast
import io
import json
import re
import sys
import tomllib
from contextlib import redirect_stdout
from importlib.metadata import packages_distributions
from types import ModuleType

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from own_workspace import ROOT
from packaging.requirements import Requirement

PATH = ROOT / "examples" / "quickstart.ipynb"
NOTEBOOK = json.loads(PATH.read_text())
CODE = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
NUMBER = re.compile(r"-?\d+(?:\.\d*)?")


class Player:
    """As `IPython.display.Audio`: it scales sounds to full scale unless told not to."""

    def __init__(self, data, rate, normalize=True):
        self.data, self.rate, self.normalize = np.asarray(data), rate, normalize


def source(cell):
    return "".join(cell["source"])


@pytest.fixture(scope="module")
def ran():
    """The names after all cells, what each printed, and the players that they displayed."""
    package, display, players = ModuleType("IPython"), ModuleType("IPython.display"), []
    package.version_info = (9, 0)  # which matplotlib asks for
    display.Audio, display.display = Player, players.append
    matplotlib.use("agg")
    names, printed = {}, []
    with pytest.MonkeyPatch.context() as patch, matplotlib.rc_context():
        patch.setitem(sys.modules, "IPython", package)
        patch.setitem(sys.modules, "IPython.display", display)
        for number, cell in enumerate(CODE):
            with redirect_stdout(io.StringIO()) as stream:
                exec(compile(source(cell), f"cell {number} of {PATH.name}", "exec"), names)
            printed.append(stream.getvalue())
        yield names, printed, players
        plt.close("all")


def test_the_three_senses_answer(ran):
    names = ran[0]
    assert names["views"].shape == (4, 256, 256, 3)
    assert np.shape(names["lit"]) == (4, 256, 256, 3)
    for images in (names["views"], np.array(names["lit"])):
        assert images.min() >= 0
        assert images.max() <= 1
        assert images.std(axis=(1, 2, 3)).min() > 0.05  # each shows more than the white page
    assert (np.isfinite(names["seen"].depth) == (names["seen"].alpha > 0)).all()
    assert names["images"].shape == (4, 160, 120, 3)
    assert names["images"].dtype == np.uint8
    assert names["distances"].max() < 0.02
    assert (np.diff(names["pressed"].force) > 0).all()


def test_players_get_finite_sounds_at_48_khz(ran):
    players = ran[2]
    assert len(players) == 3
    for player in players:
        assert (player.rate, player.normalize) == (48000, False)
        assert player.data.shape == (24000,)
        assert np.isfinite(player.data).all()
        assert np.abs(player.data).max() == pytest.approx(0.9)


def test_gradients_are_those_of_differences(ran):
    names = ran[0]
    mug, place = names["mug"], np.repeat(names["points"][:1], 2, axis=0)
    less, more = mug.press(place, depth=[0.00095, 0.00105]).force
    assert names["depth"].grad.item() == pytest.approx((more - less) / 0.0001, rel=0.005)
    assert names["light"].grad.shape == (1, 3)
    assert names["light"].grad.isfinite().all()


def test_plots_say_their_units(ran):
    axes = [place for number in plt.get_fignums() for place in plt.figure(number).axes if place.axison]
    labels = [label for place in axes for label in (place.get_xlabel(), place.get_ylabel()) if label]
    assert len(labels) == 6
    assert [label for label in labels if not re.search(r" \(\w+\)$", label)] == []


def imported(tree):
    """Top-level names of all modules that some code imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.partition(".")[0]


def test_it_needs_the_base_install_and_what_a_hosted_notebook_has():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    base = {Requirement(line).name for line in project["dependencies"]}
    base |= {"objectfolder", "matplotlib", "ipython"}
    names = {name for cell in CODE for name in imported(ast.parse(source(cell)))}
    names -= {"IPython", *sys.stdlib_module_names}  # the first is not installed here
    assert names >= {"numpy", "objectfolder", "torch"}
    owners = packages_distributions()
    assert {name for name in names if not base & set(owners.get(name, ()))} == set()


def stored(cell):
    return "".join("".join(out["text"]) for out in cell["outputs"] if out.get("name") == "stdout")


def test_stored_outputs_are_those_of_a_whole_run(ran):
    outputs = [out for cell in CODE for out in cell["outputs"]]
    assert {out["output_type"] for out in outputs} == {"stream", "display_data"}
    assert [cell["execution_count"] for cell in CODE] == [*range(1, len(CODE) + 1)]
    for cell, text in zip(CODE, ran[1]):
        assert NUMBER.sub("0", stored(cell)).split() == NUMBER.sub("0", text).split()
        numbers = [float(number) for number in NUMBER.findall(text)]
        assert [*map(float, NUMBER.findall(stored(cell)))] == pytest.approx(numbers, rel=0.01, abs=0.002)
    pictures = [out for out in outputs if "image/png" in out.get("data", ())]
    assert len(pictures) == len(plt.get_fignums()) == 6


def test_the_file_is_small_and_says_nothing_of_a_machine():
    text = PATH.read_text()
    assert len(text) < 600_000
    assert not re.search(
        r"/(home|tmp|root|work|usr)/", re.sub(r'"image/png": "[^"]*"|base64,[^"]*', "", text)
    )
    assert [cell["metadata"] for cell in NOTEBOOK["cells"] if cell["metadata"]] == []
    assert NOTEBOOK["metadata"].keys() == {"kernelspec", "language_info"}
    assert NOTEBOOK["metadata"]["kernelspec"]["name"] == "python3"


def test_its_links_lead_to_files():
    text = "".join(source(cell) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "markdown")
    links = re.findall(r"\]\((?!https?:)([^)#]+)", text)
    assert len(links) >= 6
    assert [link for link in links if not (PATH.parent / link).is_file()] == []
