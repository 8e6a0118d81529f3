"""Texts of the files of a workspace that runs the installed package."""

import re
from pathlib import Path
from typing import Any

from objectfolder.errors import ObjectFolderError
from objectfolder.installation import installed_version, requirement
from objectfolder.workspace.code_digests import DATA
from objectfolder.workspace.installed import PACKAGE, RECORD, SENSORS, pipeline_files
from objectfolder.workspace.layout import code_list
from objectfolder.workspace.params import PARAMS_FILE
from objectfolder.yamlfile import read_yaml

REQUIREMENTS = "requirements.txt"
#: Files that a clone does not have, by the name that they get.
OWN_FILES = {".gitignore": "gitignore", ".github/workflows/objects.yml": "objects.yml"}
CARD = "README.md"
EXTRA = "build"  #: of the package, which a workspace needs
_TEMPLATE = Path(__file__).with_suffix("")
_DEPENDENCY = re.compile(rf"^(\s+- )({PACKAGE}(?:/\S+)?)$", re.MULTILINE)

#: What `objectfolder.installation.requirement` writes, and its form for a wheel on a server.
_PIN = re.compile(rf"^{PACKAGE}\[{EXTRA}\](?:==\S+| @ \S+)$", re.MULTILINE)
_NOTE = (
    f"# If this line works on this machine alone, write `{PACKAGE}[{EXTRA}] @ URL`: of a wheel, or "
    "git+URL@COMMIT of the repository.\n"
)


def tool_files() -> dict[str, str]:
    """Return the texts of the files that follow the version of the package, by name.

    ``params.yaml``, the card and the requirements are not among them: they are the dataset's own.
    """
    files = {name: path.read_text() for name, path in pipeline_files().items()}
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
    """Return ``params.yaml`` with the settings of preset quick and no objects.

    A clone's own ``params.yaml`` does not count: it holds that workspace's objects and settings.
    """
    _, _, settings = _quick().read_text().partition("\n")  # the first line is a comment on the preset
    return f"{(_TEMPLATE / PARAMS_FILE).read_text()}\n{settings}"


def first_values() -> dict[str, Any]:
    """Return the values of `first_params`."""
    values: dict[str, Any] = read_yaml(_TEMPLATE / PARAMS_FILE) | read_yaml(_quick())
    return values


def _quick() -> Path:
    return pipeline_files()["params/quick.yaml"]


def first_card(name: str) -> str:
    """Return the README of a dataset of this name."""
    return (_TEMPLATE / CARD).read_text().replace("NAME", name, 1).replace("VERSION", installed_version())


def first_requirements() -> str:
    """Return the requirements of a new workspace, with a note unless they name a place that others reach."""
    line = requirement(EXTRA)
    return f"{line}\n" if _is_reachable(line) else f"{_NOTE}{line}\n"


def next_requirements(text: str) -> str:
    """Return requirements with this version instead of another.

    A place that others reach stays the user's to change if this version was installed from this machine.
    """
    line = requirement(EXTRA)
    return _PIN.sub(
        lambda match: match[0] if _is_reachable(match[0]) and not _is_reachable(line) else line, text
    )


def _is_reachable(line: str) -> bool:
    """Return whether a requirement names a place that is not on this machine."""
    return " @ " in line and " @ file:" not in line
