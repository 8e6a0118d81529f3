"""Kinds of a file's parts. Those of nets are said beside the nets' code, and found by name."""

import copy
import json
from fnmatch import fnmatch
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from objectfolder.base.errors import ObjectFolderError
from objectfolder.stored.header import FORMAT, PARTS, RADIATION, common_schema, require_valid

#: Modules of nets by part; their ``KINDS`` are `objectfolder.nets.storage.NetKind` by name. What imports this
#: module depends on all of them.
NETS = {
    "vision": "objectfolder.vision.*_net",
    "audio": "objectfolder.sound.*_net",
    "touch": "objectfolder.touch.*_net",
}


@cache
def net_kinds(part: str) -> dict[str, Any]:
    """Return the kinds of nets of vision, audio or touch that a build makes, by name."""
    package, _, pattern = NETS[part].rpartition(".")
    names = sorted(module.name for module in iter_modules(import_module(package).__path__))
    modules = [import_module(f"{package}.{name}") for name in names if fnmatch(name, pattern)]
    return {kind: described for module in modules for kind, described in module.KINDS.items()}


@cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema of the header, with that of each kind of net."""
    found = copy.deepcopy(common_schema())
    for part in NETS:
        found["properties"][part]["allOf"][:0] = [
            {"if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]}, "then": described.schema}
            for kind, described in net_kinds(part).items()
        ]
    return found


def known_kinds(part: str) -> tuple[str, ...]:
    """Return the kinds of a part (geometry, vision, audio, touch, radiation) that this version knows."""
    return tuple(_rules(part))


def known_net(part: str, described: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of a part's network, without unknown fields of newer versions."""
    known = _rules(part)[described["kind"]]["properties"]["net"]["properties"]
    return {name: value for name, value in described["net"].items() if name in known}


def checked_nets(header: dict[str, Any], path: object) -> dict[str, Any]:
    """Return the header of a file, of which `objectfolder.stored.header.checked_header` has checked the rest.

    Raises ObjectFolderError if what it says of a net breaks the schema, or a kind is unknown, unless the file
    has a newer version: then it is refused when its part is queried.
    """
    for part in NETS:
        if part in header and header[part]["kind"] in net_kinds(part):
            require_valid(header[part], net_kinds(part)[header[part]["kind"]].schema, path, (part,))
    version = tuple(map(int, header["format"].split(".")))
    for part in (*PARTS, RADIATION):
        kinds = known_kinds(part)
        if version <= FORMAT and part in header and header[part]["kind"] not in kinds:
            expected = " or ".join(map(repr, kinds))
            raise ObjectFolderError(f"{path}: {part} of kind {header[part]['kind']!r}, expected {expected}")
    return header


@cache
def _rules(part: str) -> dict[str, Any]:
    """Return the schemas of a part's kinds."""
    rules = schema()["properties"][part]["allOf"]
    return {rule["if"]["properties"]["kind"]["const"]: rule["then"] for rule in rules}


if __name__ == "__main__":
    print(json.dumps(schema(), indent=2))
