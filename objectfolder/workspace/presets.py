"""Presets: overlays ``params/<name>.yaml`` on the settings that the dataclasses of the sections default to.

The preset ``quick`` is these defaults, and has no file.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.yamlfile import inline_lists, read_yaml
from objectfolder.workspace.check import check_all, check_own
from objectfolder.workspace.document import edited
from objectfolder.workspace.params import PARAMS_FILE, Shared, differences, plain
from objectfolder.workspace.stages import SECTIONS, section_config

DEFAULT = "quick"


def apply_preset(name: str, root: Path = Path(), dry_run: bool = False) -> list[str]:
    """Give the stage sections of ``params.yaml`` the settings of a preset; objects and seed stay.

    A dry run changes nothing. Returns the settings that change, with both values. Raises ObjectFolderError if
    there is no such preset, or it or an entry of ``params.yaml`` that it does not hold is invalid.
    """
    params_path = root / PARAMS_FILE
    with edited(params_path, dry_run) as (document, values):
        preset, path = read_preset(name, root)
        check_own(values, params_path)
        check_all({**values, **preset}, path)
        present = {section: values.get(section) for section in preset}
        for section, content in preset.items():
            if present[section] != content:
                document[section] = inline_lists(content)
    return differences("", present, preset)


def read_preset(name: str, root: Path = Path()) -> tuple[dict[str, Any], Path]:
    """Return all sections of a preset, and the path of its overlay.

    Raises ObjectFolderError if there is no such preset, or it is not a mapping.
    """
    folder = root / "params"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        if name == DEFAULT:
            return default_sections(), path
        known = ", ".join([DEFAULT, *sorted(p.stem for p in folder.glob("*.yaml"))])
        raise ObjectFolderError(f"no preset {name!r} in {folder}/; expected one of {known}")
    overlay = read_yaml(path)
    if not isinstance(overlay, dict):
        raise ObjectFolderError(f"{path} holds {quoted(overlay)}, expected sections by name")
    return _merged(default_sections(), overlay), path


def default_sections() -> dict[str, Any]:
    """Return the default of every section and of the sensor, as ``params.yaml`` holds them."""
    sections = {name: plain(asdict(section_config(name)())) for name in SECTIONS}
    return {"sensor": Shared.model_fields["sensor"].default, **sections}


def _merged(values: dict[str, Any], overlay: dict[str, Any]) -> dict[str, Any]:
    """Return nested mappings with the values of an overlay; lists are replaced as a whole."""
    both = {
        name: _merged(values[name], value)
        for name, value in overlay.items()
        if isinstance(value, dict) and isinstance(values.get(name), dict)
    }
    return {**values, **overlay, **both}
