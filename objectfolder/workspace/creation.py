"""Make a workspace that runs the installed package, and move it to another version."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text
from objectfolder.base.locks import exclusive
from objectfolder.workspace import template
from objectfolder.workspace.check import check_all
from objectfolder.workspace.document import editable, write_params
from objectfolder.workspace.installed import (
    PACKAGE,
    RECORD,
    SENSORS,
    changed_files,
    is_recorded,
    package_digests,
    read_record,
)
from objectfolder.workspace.params import PARAMS_FILE, ObjectEntry, check_root, outside_workspace

#: What a folder may hold before: what a new repository on a server begins with.
ALLOWED = {".git", "LICENSE", "README.md"}
#: End of the name of a new text that an edited file is not replaced by.
NEW = ".new"
#: Entries of ``params.yaml`` that are the dataset's own.
GROUPS = ("objects", "procedural")


@dataclass(frozen=True)
class Upgrade:
    """What an upgrade changed in a workspace."""

    changed: tuple[str, ...]  #: files of the package that differ from those that the workspace was of
    written: tuple[str, ...]  #: files of the workspace that were replaced or added
    removed: tuple[str, ...]  #: files of the workspace that the version no longer has
    #: Files that were edited here and are new in this version: the new text lies beside them.
    conflicts: tuple[str, ...]
    params: tuple[str, ...]  #: settings added to ``params.yaml``, with the values of the preset quick


def create_workspace(root: Path, start: Callable[[Path], None]) -> None:
    """Make a workspace without objects in a folder that is not there, or is empty.

    ``start`` makes it a Git and DVC repository, or raises. Raises ObjectFolderError if the folder holds files
    or lies in a workspace, or it cannot be written; nothing is left there then.
    """
    _check_place(root)
    made = not root.exists()
    with exclusive(root):  # of two that start together, one finds the files of the other
        _check_place(root)
        _create(root, start, made)


def _create(root: Path, start: Callable[[Path], None], made: bool) -> None:
    before = set(root.iterdir())
    texts = template.tool_files() | {
        PARAMS_FILE: template.first_params(),
        template.REQUIREMENTS: template.first_requirements(),
    }
    if not (root / template.CARD).exists():
        texts[template.CARD] = template.first_card(root.resolve().name)
    try:
        for folder in ("data/objects", SENSORS):
            write_text(root / folder / ".gitkeep", "")  # Git keeps no empty folder
        start(root)
        for name, text in texts.items():
            write_text(root / name, text)
        _write_record(root)
    except BaseException as error:
        for path in set(root.iterdir()) - before if root.is_dir() else ():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if made and root.is_dir():
            root.rmdir()
        if isinstance(error, OSError):
            raise ObjectFolderError(
                f"cannot make a workspace in {root}: {error}; choose another folder"
            ) from error
        raise


def _check_place(root: Path) -> None:
    check_root(root)
    if root.exists() and not root.is_dir():
        raise ObjectFolderError(f"{root} is a file, expected a folder to make; choose another name")
    held = sorted(path.name for path in root.iterdir() if path.name not in ALLOWED) if root.is_dir() else []
    if held:
        raise ObjectFolderError(
            f"{root} is not empty: it holds {', '.join(held[:4])}; choose a folder that is empty or does not "
            "exist"
        )
    for above in root.resolve().parents:
        for name in ("dvc.yaml", ".dvc/config"):
            if (above / name).is_file():
                raise ObjectFolderError(
                    f"{root} lies in the workspace {above} ({name}); choose a folder outside of it"
                )


def upgrade_workspace(root: Path) -> Upgrade:
    """Move a workspace to the installed version of the package.

    Files that were edited are kept; of one that is new in this version, the new text is written beside it.
    Own settings are kept, and those that are new get the values of the preset quick.

    Raises ObjectFolderError if the workspace does not run the installed package, or its settings are not
    valid in this version; nothing is changed then.
    """
    if not is_recorded(root):
        if not (root / PARAMS_FILE).is_file():
            raise outside_workspace(root / PARAMS_FILE)
        raise ObjectFolderError(
            f"{root.resolve()} holds no {RECORD}: it is not a workspace of `objectfolder init`, or a clone, "
            "which git updates"
        )
    old, texts, changed = read_record(root), template.tool_files(), changed_files(root)
    document, values = editable(root / PARAMS_FILE)
    defaults = template.first_values()
    _add_settings(values, defaults)
    check_all(values, root / PARAMS_FILE)
    written: list[str] = []
    conflicts: list[str] = []
    for name, text in texts.items():
        present = (root / name).read_text() if (root / name).is_file() else None
        edited = present is not None and _digest(present) != old.get(name)
        if present == text or (edited and _digest(text) == old.get(name)):
            continue  # the second: edited here, and the same in both versions
        write_text(root / (name + NEW * edited), text)
        (conflicts if edited else written).append(name)
    gone = {name: root / name for name in sorted(old.keys() - texts.keys())}
    removed = [n for n, path in gone.items() if path.is_file() and _digest(path.read_text()) == old[n]]
    removed = [name for name in removed if not name.startswith(f"{PACKAGE}/")]
    for name in removed:
        (root / name).unlink()
    added = _add_settings(document, defaults)
    if added:
        write_params(root / PARAMS_FILE, document)
    pins = root / template.REQUIREMENTS
    text = pins.read_text() if pins.is_file() else template.first_requirements()
    if not pins.is_file() or template.next_requirements(text) != text:
        write_text(pins, template.next_requirements(text))
        written.append(template.REQUIREMENTS)
    _write_record(root)
    return Upgrade(tuple(changed), tuple(written), tuple(removed), tuple(conflicts), tuple(added))


def _add_settings(values: Any, defaults: dict[str, Any]) -> list[str]:
    """Add what the settings and the objects lack; return the names."""
    added = _add_missing(values, {name: defaults[name] for name in defaults if name not in GROUPS})
    fields = ObjectEntry.model_construct().model_dump()
    for key, present in values["objects"].items():
        added += _add_missing(present, fields, f"objects.{key}.")
    return added


def _add_missing(values: Any, defaults: dict[str, Any], prefix: str = "") -> list[str]:
    added = []
    for name, default in defaults.items():
        if name not in values:
            values[name] = default
            added.append(prefix + name)
        elif isinstance(default, dict) and isinstance(values[name], dict):
            added += _add_missing(values[name], default, f"{prefix}{name}.")
    return added


def _write_record(root: Path) -> None:
    written = {name: _digest(text) for name, text in template.tool_files().items()}
    lines = (f"{digest}  {name}\n" for name, digest in {**package_digests(), **written}.items())
    write_text(root / RECORD, "".join(lines))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
