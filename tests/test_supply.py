"""Locks, licences and extras agree."""

import csv
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions

import pytest
from own_workspace import ROOT
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from objectfolder.workspace.stages import SECTIONS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CUDA = re.compile(r"nvidia-|cuda-|triton$|setuptools$")
WINDOWS = {"pywin32", "tzdata"}


def pins(text):
    """Versions by normalized name; every line is a pin."""
    found = map(Requirement, text.split("\n"))
    return {canonicalize_name(one.name): str(one.specifier).removeprefix("==") for one in found}


def lock(name):
    """Versions and hashes by package."""
    lines = [line for line in (ROOT / name).read_text().splitlines() if not line.lstrip().startswith("#")]
    entries = re.split(r"\n(?=\S)", "\n".join(lines))
    split = [entry.partition(" \\\n") for entry in entries]
    hashes = [re.findall(r"--hash=sha256:([0-9a-f]{64})(?: \\)?(?:\n|$)", rest) for *_, rest in split]
    assert [len(found) for found in hashes] == [rest.count("\n") + 1 for *_, rest in split]
    versions = pins("\n".join(head for head, *_ in split))
    assert len(versions) == len(entries)
    return versions


CONSTRAINTS = pins("\n".join((ROOT / "constraints.txt").read_text().splitlines()[1:]))


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-torch.lock"])
def test_locks_pin_every_package_by_hash_at_the_versions_of_constraints(name):
    locked = lock(name)
    other = {key for key, version in locked.items() if CONSTRAINTS.get(key) != version}
    assert {key for key in other if not CUDA.match(key)} <= WINDOWS
    assert "://" not in (ROOT / name).read_text()


def test_pins_install_on_every_python_that_the_project_allows():
    """One that asked for 3.11.5 made pip search for hours on the 3.11.2 of Debian 12."""
    oldest = PROJECT["requires-python"].partition(",")[0].removeprefix(">=") + ".0"
    found = ((one.name, one.metadata["Requires-Python"] or "") for one in distributions())
    asked = {canonicalize_name(name): versions for name, versions in found}
    assert not [
        key for key in CONSTRAINTS.keys() & asked.keys() if not SpecifierSet(asked[key]).contains(oldest)
    ]


def test_the_repositorys_address_is_a_placeholder_in_one_place():
    address = PROJECT["urls"]["Repository"]
    assert address.startswith("https://example.org/")
    done = subprocess.run(["git", "grep", "-Il", address], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "pyproject.toml\n"


def test_workflows_and_targets_call_what_is_there():
    """As links of the pages for contributors do."""
    texts = [path.read_text() for path in (ROOT / ".github/workflows").iterdir()]
    texts.append((ROOT / "Makefile").read_text())
    called = {name for text in texts for name in re.findall(r"(?<!\S)\.ci/\w+", text)}
    assert called == {".ci/run", ".ci/reproduce", ".ci/wheel"}
    assert all(os.access(ROOT / name, os.X_OK) for name in called)
    for name in ("CONTRIBUTING.md", "SECURITY.md"):
        links = re.findall(r"\]\(([^)#]+)", (ROOT / name).read_text())
        assert links
        assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_lock_holds_what_base_and_build_ask_for_and_torch_is_apart():
    texts = PROJECT["dependencies"] + PROJECT["optional-dependencies"]["build"]
    locked, torch = lock("requirements.lock"), lock("requirements-torch.lock")
    wanted = {canonicalize_name(one.name): one.specifier for one in map(Requirement, texts)}
    assert "torch" in torch
    assert "torch" not in locked
    assert [key for key, versions in wanted.items() if not versions.contains((locked | torch)[key])] == []
    # Else the two could not be installed together.
    assert {key: torch[key] for key in torch.keys() & locked.keys()}.items() <= locked.items()


def test_every_locked_package_has_its_licence():
    text = (ROOT / "docs" / "licences.csv").read_text()
    rows = [tuple(row.values()) for row in csv.DictReader(text.splitlines())]
    listed = {name: version for name, version, *_ in rows}
    locked = lock("requirements.lock")
    assert {key: version for key, version in locked.items() if listed.get(key) != version}.keys() <= WINDOWS
    assert not [name for name, _, licence, _ in rows if licence in ("", "None", "UNKNOWN")]
    users = {name: who for name, _, licence, who in rows if re.search(r"\b(A?GPL|GNU)", licence)}
    gpl = {name for name, who in users.items() if who != "dev"}
    assert gpl == {"asyncssh", "dulwich", "grandalf", "pygit2"}
    explained = (ROOT / "docs" / "licences.md").read_text()
    assert all(f"| {name} |" in explained for name in gpl)
    assert not [name for name in gpl if "base" in users[name]]


WITHOUT_EXTRAS = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
from objectfolder.workspace.stages import SECTIONS, section_config
print(len([section_config(name) for name in SECTIONS]))
"""


@pytest.mark.slow
def test_parameters_are_checked_without_the_extras_that_a_build_does_not_need():
    """`make demo` installs the extra ``build`` alone."""
    missing = ["coacd", "gymnasium", "mujoco", "ray", "sb3_contrib", "sklearn", "stable_baselines3", "vtk"]
    script = WITHOUT_EXTRAS.format(missing=missing)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == f"{len(SECTIONS)}\n", done.stderr
