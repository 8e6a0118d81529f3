"""Presets: ``params/<name>.yaml``, merged into the sections of ``params.yaml``."""

from pathlib import Path
from typing import Any

from objectfolder.errors import ObjectFolderError, quoted
from objectfolder.workspace.check import check_all, check_own
from objectfolder.workspace.document import edited
from objectfolder.workspace.params import PARAMS_FILE, SECTIONS, section_config, settings
from objectfolder.yamlfile import read_yaml


def apply_preset(name: str, root: Path = Path()) -> list[str]:
    """Merge ``params/<name>.yaml`` into the stage sections of ``params.yaml``.

    Returns
    -------
    Sections that changed.

    Raises
    ------
    ObjectFolderError
        If there is no such preset, or it or an entry of ``params.yaml`` that it does not hold is invalid.
    """
    params_path = root / PARAMS_FILE
    with edited(params_path) as (document, values):
        preset, path = read_preset(name, root)
        changed = [section for section, content in preset.items() if values.get(section) != content]
        check_own(values, params_path)
        for name in SECTIONS:
            if name not in preset:  # a user's own preset may have some of them only
                settings(section_config(name), values, params_path)
        check_all({**values, **preset}, path)
        for section in changed:
            document[section] = preset[section]
    return changed


def read_preset(name: str, root: Path = Path()) -> tuple[dict[str, Any], Path]:
    """Return the sections of ``params/<name>.yaml``, and its path.

    Raises
    ------
    ObjectFolderError
        If there is no such preset, or it is not a mapping.
    """
    folder = root / "params"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in folder.glob("*.yaml"))) or "none"
        raise ObjectFolderError(f"no preset {name!r} in {folder}/; expected one of {known}")
    sections = read_yaml(path)
    if not isinstance(sections, dict):
        raise ObjectFolderError(f"{path} holds {quoted(sections)}, expected sections by name")
    return sections, path
