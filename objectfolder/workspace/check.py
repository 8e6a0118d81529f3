"""Check all of ``params.yaml`` before a long build starts.

Stages import `objectfolder.workspace.params` alone, so that a change of this module makes none of them stale.
"""

import difflib
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any, Literal

from pydantic import create_model

from objectfolder.base.checks import check_mass
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import own_material
from objectfolder.workspace.params import (
    PARAMS_FILE,
    ObjectEntry,
    ProceduralEntry,
    Record,
    Shared,
    check_seen,
    checked,
    object_entry,
    require_section,
    settings,
    shared,
)
from objectfolder.workspace.stages import (
    BENCHMARKS,
    OBJECT_TASKS,
    ROBOT_STAGES,
    SECTIONS,
    TASKS,
    check_key,
    section_config,
)

_CHOICES: dict[str, Any] = dict.fromkeys((*OBJECT_TASKS, *ROBOT_STAGES), (list[str], ...))
for _task in TASKS:
    _split: Any = Literal[BENCHMARKS[_task]]
    _CHOICES[_task] = (list[_split], ...)
#: Benchmarks that a build runs: ``benchmarks`` in ``params.yaml``, splits or objects by stage.
Selection: type[Record] = create_model(
    "Selection", __base__=Record, **{name: _CHOICES[name] for name in dict.fromkeys((*BENCHMARKS, *_CHOICES))}
)


def check_all(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate everything, before a long build starts.

    Raises ObjectFolderError if a value is wrong or missing, or a name at the top is unknown.
    """
    check_entries(values, path)
    for name in SECTIONS:
        settings(section_config(name), values, path)
    _check_encoder(values, path)


def check_entries(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate everything but the stages' settings, whose modules take seconds to import.

    Raises ObjectFolderError if an object, a procedural object, a shared value or a choice of benchmarks is
    wrong or missing, a section is missing, or a name at the top is unknown.
    """
    check_own(values, path)
    for name in SECTIONS:
        require_section(name, values, path)
    shared(values, path)


def check_own(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Validate what no preset holds: names at the top, objects, and the choice of benchmarks.

    Raises ObjectFolderError if an object, a procedural object or a choice of benchmarks is wrong or missing,
    a name at the top is unknown, or DVC does not see a parameter.
    """
    check_seen(values, path)
    known = ("objects", "procedural", "benchmarks", *Shared.model_fields, *SECTIONS)
    for name in values:
        if name not in known:
            near = difflib.get_close_matches(str(name)[:60], known, 1)
            hint = f"do you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
            raise ObjectFolderError(f"{path}: {quoted(name)} is not a section; {hint}")
    for group in ("objects", "procedural"):
        for key in values[group]:
            check_key(key, f"{path}: {group}")
    for key, entry in values["objects"].items():
        check_object(key, values, path)
        lacking = {n: v for n, v in ObjectEntry.model_construct().model_dump().items() if n not in entry}
        if lacking:
            fields = ", ".join(f"{name}: {json.dumps(value)}" for name, value in lacking.items())
            raise ObjectFolderError(
                f"{path}: objects.{key} lacks {', '.join(lacking)}, which DVC tracks; add `{fields}`"
            )
    for key, entry in values["procedural"].items():
        checked(ProceduralEntry, entry, f"{path}: procedural.{key}")
    _check_selection(values, path)


def check_object(key: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> ObjectEntry:
    """Return one object's entry, whose material must be known, wall have room and mass be possible.

    Raises ObjectFolderError if there is no such entry, or a field is wrong.
    """
    entry = object_entry(key, values, path)
    try:
        own_material(entry.material, root=Path(path).parent)
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{path}: objects.{key}: material: {error}") from error
    if entry.wall is not None and not entry.wall < entry.scale / 2:
        raise ObjectFolderError(
            f"{path}: objects.{key}: wall: got {entry.wall:g} m, expected less than half of the scale, "
            f"{entry.scale:g} m; give it in metres"
        )
    if entry.mass is not None and entry.mass > entry.scale**3:  # in the cube around it it is the least dense
        check_mass(f"{path}: objects.{key}", entry.mass, entry.scale**3, "the cube around it")
    return entry


def _check_selection(values: dict[str, Any], path: str | Path) -> None:
    """Check that each selected benchmark has its objects and the stages that it depends on."""
    if "benchmarks" not in values:
        empty = ", ".join(f"{name}: []" for name in Selection.model_fields)
        raise ObjectFolderError(
            f"{path} lacks `benchmarks`, the benchmarks that a build runs; add `benchmarks: {{{empty}}}`"
        )
    selection = checked(Selection, values["benchmarks"], f"{path}: benchmarks")
    chosen = selection.model_dump()
    for stage in dict.fromkeys((*OBJECT_TASKS, *ROBOT_STAGES)):
        where = f"{path}: benchmarks.{stage}"
        _require(where, chosen[stage], values["objects"], "is not an object")
        if stage in ROBOT_STAGES:
            _require(where, chosen[stage], chosen["decompose"], "lacks in benchmarks.decompose")
    if chosen["grasp_stability"] and len(chosen["grasp_data"]) < 2:
        raise ObjectFolderError(
            f"{path}: benchmarks.grasp_stability needs the grasps of at least two objects; list them in "
            "benchmarks.grasp_data"
        )


def _check_encoder(values: dict[str, Any], path: str | Path) -> None:
    """Check that a build sees the code of the encoder that its benchmarks train."""
    encoder, selected = values["encode"]["encoder"], values["benchmarks"]
    if ":" in encoder and any(selected[task] for task in BENCHMARKS):
        raise ObjectFolderError(
            f"{path}: encode.encoder is {quoted(encoder)}, whose changes a build would not see; "
            "run `objectfolder bench --encoder`, or select no benchmarks"
        )


def _require(where: str, keys: list[str], known: Collection[str], fault: str) -> None:
    wrong = [key for key in keys if key not in known]
    if wrong:
        raise ObjectFolderError(f"{where}: {wrong[0]} {fault}; expected one of {', '.join(known) or 'none'}")
