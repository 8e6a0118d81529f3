"""Texts of the files of a workspace that runs the installed package."""

import hashlib
import logging
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.installation import installed_version, requirement
from objectfolder.base.io import file_digest, write_text
from objectfolder.base.yamlfile import read_yaml, yaml_text
from objectfolder.workspace.check import Selection
from objectfolder.workspace.code_digests import DATA
from objectfolder.workspace.installed import (
    INSTALLED,
    PACKAGE,
    RECORD,
    SENSORS,
    pipeline_files,
    runs_installed,
)
from objectfolder.workspace.layout import code_list
from objectfolder.workspace.params import PARAMS_FILE
from objectfolder.workspace.presets import default_sections

REQUIREMENTS = "requirements.txt"
#: Files that a clone does not have, by the name that they get.
OWN_FILES = {".gitignore": "gitignore", ".github/workflows/objects.yml": "objects.yml"}
CARD = "README.md"
EXTRA = "build"  #: of the package, which a workspace needs
_TEMPLATE = Path(__file__).with_suffix("")
_DEPENDENCY = re.compile(rf"^(\s+- )({PACKAGE}(?:/\S+)?)$", re.MULTILINE)

#: What `objectfolder.base.installation.requirement` writes, and its form for a wheel on a server.
_PIN = re.compile(rf"^{PACKAGE}\[{EXTRA}\](?:==\S+| @ \S+)$", re.MULTILINE)
_NOTE = (
    f"# If this line works on this machine alone, write `{PACKAGE}[{EXTRA}] @ URL`: of a wheel, or "
    "git+URL@COMMIT of the repository.\n"
)
_log = logging.getLogger(__name__)


def tool_files() -> dict[str, str]:
    """Return the texts of the files that follow the version of the package, by name.

    ``params.yaml``, the card and the requirements are not among them: they are the dataset's own.
    """
    files = {name: path.read_text() for name, path in pipeline_files().items()}
    files["dvc.yaml"] = graph_of_installed(files["dvc.yaml"])
    return files | {name: (_TEMPLATE / source).read_text() for name, source in OWN_FILES.items()}


def foreign_code(root: Path, graphs: Iterable[Path]) -> dict[str, str]:
    """Map the files whose code a build of a workspace runs and this version did not write to their contents.

    They are ``graphs`` (files with the commands of stages), files of ``stages``, and modules at the top
    level, which Python finds before others. The clone that the package runs from has none. Paths are
    absolute. Returns the digest or the target of a link by name, sorted.
    """
    if root == INSTALLED:
        return {}
    own = not runs_installed(root)
    known = {name: path.read_text() for name, path in pipeline_files().items()} if own else tool_files()
    modules = [path for path in root.iterdir() if path.name.endswith(tuple(all_suffixes()))]
    modules += [path for path in root.glob("*/__init__.*") if path.parent.name != "stages"]
    stages = [path for path in (root / "stages").rglob("*") if "__pycache__" not in path.parts]
    found = {}
    for path in sorted({*graphs, *modules, *stages}):
        name = os.path.relpath(path, root)
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_file() and (name not in known or path.read_bytes() != known[name].encode()):
            found[name] = file_digest(path)
    return found


def note_foreign_code(root: Path, graphs: Iterable[Path], folder: Path) -> None:
    """Warn that a build runs code of the workspace, see `foreign_code`: once, until that changes.

    ``folder`` keeps the record of what was said.
    """
    if not (code := foreign_code(root, graphs)):
        return
    place = root.stat()  # a clone that brings a record along cannot know it
    state = hashlib.sha256(repr((place.st_dev, place.st_ino, code)).encode()).hexdigest()
    said = folder / "foreign_code.sha256"
    with suppress(OSError):
        if said.read_text() == state:
            return
    _log.warning(
        "this build runs code of the workspace that is not as objectfolder has it: %s; read it first, unless "
        "you trust its author",
        shortened(", ".join(code), 300),
    )
    with suppress(OSError, ObjectFolderError):
        write_text(said, state)


def graph_of_installed(text: str) -> str:
    """Return ``dvc.yaml`` for a workspace without the package.

    A dependency on the package becomes one on `objectfolder.workspace.installed.RECORD` and on the folder of
    sensors, and one on a file in it becomes one on its digest, which ``hash_code`` writes.

    Raises ObjectFolderError if a stage depends on a file of the package that
    `objectfolder.workspace.code_digests.DATA` lacks.
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
    head = (_TEMPLATE / PARAMS_FILE).read_text() + yaml_text({"benchmarks": _no_benchmarks()})
    return f"{head}\n{yaml_text(default_sections())}"


def first_values() -> dict[str, Any]:
    """Return the values of `first_params`."""
    values: dict[str, Any] = read_yaml(_TEMPLATE / PARAMS_FILE)
    return values | {"benchmarks": _no_benchmarks()} | default_sections()


def _no_benchmarks() -> dict[str, list[str]]:
    return {name: [] for name in Selection.model_fields}


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
