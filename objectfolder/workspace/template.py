"""Texts of the files of a workspace that runs the installed package."""

import json
import re
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

from objectfolder.errors import ObjectFolderError
from objectfolder.workspace.code_digests import DATA
from objectfolder.workspace.installed import PACKAGE, RECORD, SENSORS, pipeline_files
from objectfolder.workspace.layout import code_list
from objectfolder.workspace.params import PARAMS_FILE

REQUIREMENTS = "requirements.txt"
#: Files that a clone does not have, by the name that they get.
OWN_FILES = {".gitignore": "gitignore", ".github/workflows/objects.yml": "objects.yml"}
CARD = "README.md"
_TEMPLATE = Path(__file__).with_suffix("")
_DEPENDENCY = re.compile(rf"^(\s+- )({PACKAGE}(?:/\S+)?)$", re.MULTILINE)

#: What `_requirement` writes.
_PIN = re.compile(rf"^{PACKAGE}\[build\](?:==\S+| @ \w+\+\S+)$", re.MULTILINE)
_OBJECTS = re.compile(r"^(procedural|objects):\n(?:  .*\n)*", re.MULTILINE)


def tool_files() -> dict[str, str]:
    """Return the texts of the files that follow the version of the package, by name.

    ``params.yaml``, the card and the requirements are not among them: they are the dataset's own.
    """
    files = {name: path.read_text() for name, path in pipeline_files().items() if name != PARAMS_FILE}
    files["dvc.yaml"] = graph_of_installed(files["dvc.yaml"])
    return files | {name: (_TEMPLATE / source).read_text() for name, source in OWN_FILES.items()}


def graph_of_installed(text: str) -> str:
    """Return ``dvc.yaml`` for a workspace without the package.

    A dependency on the package becomes one on `objectfolder.workspace.installed.RECORD` and on the folder of
    sensors, and one on a file in it becomes one on its digest, which ``hash_code`` writes.

    Raises
    ------
    ObjectFolderError
        If a stage depends on a file of the package that `objectfolder.workspace.code_digests.DATA` lacks.
    """

    def replacement(match: re.Match[str]) -> str:
        name = match[2]
        if name == PACKAGE:
            return f"{match[1]}{RECORD}\n{match[1]}{SENSORS}"
        if not any(name == known or name.startswith(f"{known}/") for known in DATA):
            raise ObjectFolderError(
                f"dvc.yaml: a stage depends on {name}, which DATA of workspace/code_digests.py lacks"
            )
        return f"{match[1]}{code_list(name).as_posix()}"

    return _DEPENDENCY.sub(replacement, text)


def first_params() -> str:
    """Return ``params.yaml`` with the settings of this version and no objects."""
    return _OBJECTS.sub(r"\1: {}\n", pipeline_files()[PARAMS_FILE].read_text())


def first_card(name: str) -> str:
    """Return the README of a dataset of this name."""
    return (_TEMPLATE / CARD).read_text().replace("NAME", name, 1).replace("VERSION", installed_version())


def installed_version() -> str:
    """Return the version of the installed package."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError:  # on the path, but not installed
        return "unknown"


def first_requirements() -> str:
    """Return the requirements of a new workspace."""
    note = "# Not from a package index? Then write where its wheel is: `objectfolder[build] @ URL`.\n"
    line = _requirement()
    return line + "\n" if " @ " in line else f"{note}{line}\n"


def next_requirements(text: str) -> str:
    """Return requirements with this version instead of another; a URL of a wheel is the user's to change."""
    return _PIN.sub(lambda match: _requirement(), text)


def _requirement() -> str:
    """Return what installs this version: by the commit if it was installed from a repository."""
    try:
        source = json.loads(distribution(PACKAGE).read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        source = {}
    if "vcs_info" not in source:
        return f"{PACKAGE}[build]=={installed_version()}"
    info = source["vcs_info"]
    return f"{PACKAGE}[build] @ {info['vcs']}+{source['url']}@{info['commit_id']}"
