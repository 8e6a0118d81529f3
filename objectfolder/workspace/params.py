"""Read and check ``params.yaml``: objects, and one section of settings for each stage.

A section is a frozen dataclass beside the code that uses it, such as
`objectfolder.sound.fem.settings.ModalConfig`. Its annotations are the checks (`objectfolder.base.settings`).
"""

import difflib
import json
import logging
import math
import os
import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Generic, Literal, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_serializer,
)
from pydantic_core import ErrorDetails

from objectfolder.base.errors import ObjectFolderError, quoted, shortened
from objectfolder.base.yamlfile import is_yaml_name, read_yaml
from objectfolder.workspace.layout import MATERIALS

PARAMS_FILE = "params.yaml"
#: Environment variable by which a build gives its stages the parameters that it recorded: a copy of the file.
HELD_PARAMS = "OBJECTFOLDER_PARAMS"
KEY = re.compile(r"[a-z][a-z0-9_]*")
MAX_KEY = 64  #: characters; file names add to a key, and tables show it
#: Names of parameters that DVC leaves out of the key by which it finds a saved run, at any depth.
UNSEEN_BY_DVC = ("size", "nfiles")
#: What the parameter ``size`` of generators has been called since it is seen.
SIZES = {"die": "edge", "wrench": "flats", "appliance": "span", "electronics": "span", "toy": "span"}
Bridge = Literal["all", "fem", "off"]
Config = TypeVar("Config")
Model = TypeVar("Model", bound=BaseModel)


#: Types of pydantic's errors about a name that is not one of the fields.
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
_STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
_log = logging.getLogger(__name__)


class Record(BaseModel):
    """A mapping in a YAML file: frozen, and unknown names are errors."""

    model_config = ConfigDict(frozen=True, **_STRICT)


class ObjectEntry(Record):
    """One object."""

    mesh: str  #: under data/objects/<key>/
    material: Any  #: a name, a file in materials/, or {base: name or file} and properties that differ
    scale: float = Field(ge=1e-4, le=100)  #: longest side, metres
    up: Literal["y", "z"] = "z"  #: up axis of the source mesh
    wall: float | None = Field(default=None, gt=0)  #: thickness given to open sheets, metres; null: 2 %
    bridge: Bridge = "all"  #: fill small gaps: everywhere, for sound alone, nowhere
    mass: float | None = Field(default=None, gt=0, le=1e6)  #: weighed, kg; absent: of the solid's material

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields that are written for every object, and the mass of one that was weighed."""
        return {name: value for name, value in write(self).items() if name != "mass" or value is not None}

    @field_validator("scale", "wall", "mass", mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:
        if not isinstance(value, int) or isinstance(value, bool):
            return value
        try:
            return float(value)
        except OverflowError:  # of hundreds of digits
            return math.inf

    @field_validator("material")
    @classmethod
    def _name_or_properties(cls, value: Any) -> str | dict[str, Any]:
        if isinstance(value, dict):
            return value
        if not isinstance(value, str):
            raise ValueError("expected the name of a material, or {base: NAME, PROPERTY: VALUE, ...}")
        if not is_yaml_name(value):
            return value.lower()
        if PurePosixPath(value).parts[:1] != (MATERIALS,) or ".." in PurePosixPath(value).parts:
            raise ValueError(f"expected a file in {MATERIALS}/")
        return value


class ProceduralEntry(BaseModel):
    """An object that ``objectfolder.shapes`` generates; other fields go to the generator."""

    model_config = ConfigDict(frozen=True, extra="allow")

    generator: str


class Shared(Record):
    """Values that several stages use."""

    seed: int = Field(ge=0)
    sensor: str = "digit"  #: profile in objectfolder/touch/profiles


@dataclass(frozen=True)
class StageParams(Generic[Config]):
    """Parameters of one stage. It may read only what it declares in ``dvc.yaml``; a test compares the two."""

    settings: Config  #: the stage's section
    entry: ObjectEntry
    seed: int
    sensor: str


def read(path: str | Path = PARAMS_FILE) -> dict[str, Any]:
    """Read ``params.yaml`` without interpreting it, and parameters of earlier versions by today's names.

    A stage that a build runs gets the values that the build recorded, whatever the file says by then.

    Raises ObjectFolderError if it is missing, not YAML, or an object key is not a slug.
    """
    path = Path(path)
    held = Path(os.environ.get(HELD_PARAMS, path)) if path == Path(PARAMS_FILE) else path
    if not held.is_file():
        raise outside_workspace(path)
    values = read_yaml(held)
    if not isinstance(values, dict):
        raise ObjectFolderError(f"{path} holds {type(values).__name__}, expected a mapping")
    for group in ("objects", "procedural"):
        entries = values.get(group)
        if not isinstance(entries, dict):
            raise ObjectFolderError(f"{path}: {group} must be a mapping from keys to entries (or {{}})")
        for key in entries:
            check_slug(key, f"{path}: {group}")
    for change in name_as_today(values):
        if held == path:
            _warn(f"{path}: {change}")
    return values


def name_as_today(values: Any) -> list[str]:
    """Rename parameters that earlier versions called otherwise, in place.

    Anything but a mapping with procedural objects is left as it is. Returns what to write instead, for each.
    """
    entries = values.get("procedural") if isinstance(values, dict) else None
    changes = []
    for key, entry in entries.items() if isinstance(entries, dict) else ():
        name = SIZES.get(str(entry.get("generator"))) if isinstance(entry, dict) else None
        if name and "size" in entry and name not in entry:
            value = entry.pop("size")
            entry[name] = value
            changes.append(f"procedural.{key}.size is called {name} now; write {name}: {shortened(value)}")
    return changes


@cache  # once for each text
def _warn(text: str) -> None:
    _log.warning("%s", text)


def outside_workspace(path: Path) -> ObjectFolderError:
    """Return the error of a command that needs a workspace, whose ``params.yaml`` is not at this path."""
    for above in path.resolve().parent.parents:
        if (above / PARAMS_FILE).is_file() and (above / "dvc.yaml").is_file():
            return ObjectFolderError(f"{path} does not exist; run this in the workspace's folder, {above}")
    return ObjectFolderError(
        f"{path} does not exist; run inside an objectfolder workspace, or make one: `objectfolder init DIR`"
    )


def check_root(root: Path) -> None:
    """Raise ObjectFolderError if a workspace cannot be in a folder: DVC fills in what is in braces."""
    path = root.resolve()
    if braced := [part for part in path.parts if "{" in part or "}" in part]:
        raise ObjectFolderError(
            f"{path} has braces in the name {braced[0]!r}, which DVC reads as a template; rename the folder"
        )


def check_slug(key: Any, where: str = "object key") -> str:
    """Return a slug, as object keys are; see `objectfolder.workspace.stages.check_key`.

    Raises ObjectFolderError if it is not a slug, or too long. DVC drops integer keys silently and takes a dot
    for a path.
    """
    if isinstance(key, str) and len(key) <= MAX_KEY and KEY.fullmatch(key):
        return key
    reason = (
        "DVC drops integer keys silently"
        if isinstance(key, int)
        else f"it has {len(key)} characters"
        if isinstance(key, str) and len(key) > MAX_KEY
        else "DVC reads a dot as a path into the parameters"
        if isinstance(key, str) and "." in key
        else "keys become file and stage names"
    )
    raise ObjectFolderError(
        f"{where}: {quoted(key)} is not a valid object key ({reason}); expected a letter, then letters, "
        f"digits or underscores, all lower case, at most {MAX_KEY}"
    )


def object_entry(key: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> ObjectEntry:
    """Validate one object's entry.

    Raises ObjectFolderError if there is none, or a field is wrong.
    """
    if key not in values["objects"]:
        known = ", ".join(values["objects"]) or "none yet"
        raise ObjectFolderError(
            f"{path} has no object {key!r} (it has {known}); add it with `objectfolder add`"
        )
    valid = checked(ObjectEntry, values["objects"][key], f"{path}: objects.{key}")
    home = PurePosixPath("data/objects") / key
    mesh = PurePosixPath(valid.mesh)
    if home not in mesh.parents or ".." in mesh.parts:
        raise ObjectFolderError(
            f"{path}: objects.{key}.mesh is {quoted(valid.mesh)}, expected a file in {home}/"
        )
    return valid


def stage_params(config: type[Config], key: str, path: str | Path = PARAMS_FILE) -> StageParams[Config]:
    """Return the parameters of a stage of one object; ``config`` is the dataclass of its section.

    Raises ObjectFolderError if the section or the object's entry is missing or wrong.
    """
    values = read(path)
    entry = object_entry(check_slug(key), values, path)
    common = shared(values, path)
    return StageParams(settings(config, values, path), entry, common.seed, common.sensor)


def settings(config: type[Config], values: dict[str, Any], path: str | Path = PARAMS_FILE) -> Config:
    """Check a section and return it as its dataclass ``config``, one of `SECTIONS`.

    ``values``: contents of ``params.yaml``, perhaps with a preset merged into it; ``path``: named in errors.
    Raises ObjectFolderError if the section is missing, or a field is missing, unknown or wrong.
    """
    name: str = config.section  # type: ignore[attr-defined]
    require_section(name, values, path)
    # As JSON, because strict checks of Python values refuse a mapping for a dataclass and a list for a tuple.
    # Dates, which YAML knows and JSON does not, become lists: no setting takes them.
    # In a dict, because a dataclass of the library has no pydantic configuration, and takes that around it.
    adapter: TypeAdapter[dict[str, Config]] = TypeAdapter(dict[str, config], config=_STRICT)  # type: ignore[valid-type]
    text = json.dumps({name: values[name]}, default=lambda value: [str(value)])
    try:
        found = adapter.validate_json(text)[name]
    except ValidationError as error:
        raise _wrong(
            f"{path}: {name}", error, _names(adapter.dump_python({name: config()})[name]), outer=1
        ) from error
    if lacking := _unwritten(adapter.dump_python({name: found}, mode="json")[name], values[name], ""):
        raise ObjectFolderError(f"{path}: {name}: {'; '.join(lacking)}: DVC tracks what is written; add it")
    return found


def _names(settings: dict[str, Any]) -> set[str]:
    inner = [_names(value) for value in settings.values() if isinstance(value, dict)]
    return {*settings}.union(*inner)


def _unwritten(settings: Any, values: Any, where: str) -> list[str]:
    """List the settings that a section does not write, with their defaults; at any depth."""
    if isinstance(settings, list):
        return [text for pair in zip(settings, values) for text in _unwritten(*pair, where)]
    found = []
    for name, value in settings.items() if isinstance(settings, dict) else ():
        place = f"{where}.{name}".removeprefix(".")
        new = [f"{place}: Field required, by default {json.dumps(value)}"]
        found += _unwritten(value, values[name], place) if name in values else new
    return found


def plain(values: Any) -> Any:
    """Return nested values with lists for tuples, as YAML holds them."""
    if isinstance(values, dict):
        return {name: plain(value) for name, value in values.items()}
    return [plain(value) for value in values] if isinstance(values, list | tuple) else values


def differences(name: str, old: Any, new: Any) -> list[str]:
    """List the leaves of nested parameters that differ, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        inner = {key: f"{name}.{key}" if name else key for key in dict.fromkeys([*old, *new])}
        return [text for key, path in inner.items() for text in differences(path, old.get(key), new.get(key))]
    shown = ["nothing" if value is None else shortened(value) for value in (old, new)]
    return [] if old == new else [f"{name}: {shown[0]} -> {shown[1]}"]


def require_section(name: str, values: dict[str, Any], path: str | Path = PARAMS_FILE) -> None:
    """Raise ObjectFolderError unless a stage's section is there."""
    if name not in values:
        raise ObjectFolderError(f"{path} lacks section {name!r}; run `objectfolder preset quick`")


def procedural_entry(key: str, path: str | Path = PARAMS_FILE) -> tuple[str, dict[str, Any]]:
    """Return the generator of a procedural object and its parameters.

    Raises ObjectFolderError if there is no such object; or if ``dvc repro`` runs this, which would not see a
    parameter change.
    """
    values = read(path)
    entry = values["procedural"].get(key)
    if entry is None:
        raise ObjectFolderError(f"{path}: procedural has no {key!r}")
    if path == PARAMS_FILE and HELD_PARAMS not in os.environ:  # a build would record today's names
        check_seen({"procedural": {key: read_yaml(path)["procedural"][key]}}, path)
    valid = checked(ProceduralEntry, entry, f"{path}: procedural.{key}")
    return valid.generator, dict(valid.model_extra or {})


def check_seen(values: Any, path: str | Path = PARAMS_FILE, where: str = "") -> None:
    """Check that DVC's run cache sees all parameters, at any depth.

    Raises ObjectFolderError if one has a name in `UNSEEN_BY_DVC`.
    """
    for name, value in values.items() if isinstance(values, dict) else enumerate(values):
        if name in UNSEEN_BY_DVC:
            entry = values if where.startswith("procedural.") else {}
            today = SIZES.get(str(entry.get("generator")))
            advice = f"write {today}: {shortened(value)}" if today else "give it another name"
            raise ObjectFolderError(
                f"{path}: {where}{name}: DVC ignores parameters of this name when it looks for a saved run, "
                f"and would restore what another value gave; {advice}"
            )
        if isinstance(value, dict | list):
            check_seen(value, path, f"{where}{name}.")


def shared(values: dict[str, Any], path: str | Path = PARAMS_FILE) -> Shared:
    """Check the values that several stages use, and return them."""
    return checked(Shared, {name: values.get(name) for name in Shared.model_fields}, str(path))


def checked(model: type[Model], value: Any, where: str) -> Model:
    """Check a mapping and return it as its model; errors begin with ``where``."""
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise _wrong(where, error, model.model_fields) from error


def _wrong(
    where: str, error: ValidationError, known: Collection[str] = (), outer: int = 0
) -> ObjectFolderError:
    """Name every wrong field; ``outer`` levels of its location are in ``where`` already."""
    lacking = [str(e["loc"][-1]) for e in error.errors() if e["type"] == "missing"]

    def problem(e: ErrorDetails) -> str:
        place = ".".join(map(str, e["loc"][outer:]))
        if not place and e["type"] == "value_error":  # of a dataclass's own check, which names the field
            return str(e["ctx"]["error"])
        if e["type"] == "missing":  # its input is all that is there
            return f"{place}: {e['msg']}"
        text = f"{place or 'entry'}: {e['msg']}, got {quoted(e['input'])}"
        if e["type"] not in UNKNOWN:
            return text
        near = difflib.get_close_matches(str(e["loc"][-1])[:60], {*lacking, *known}, 1)
        return f"{text}; did you mean {near[0]}?" if near else text

    return ObjectFolderError(f"{where}: {'; '.join(map(problem, error.errors()))}")
