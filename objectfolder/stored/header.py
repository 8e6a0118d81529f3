"""Header of an Object File: its version, and validation against the JSON Schema.

docs/objectfile.md describes the header; objectfile.schema.json, next to this module, defines it, but for nets
that a build makes: those are in `objectfolder.stored.kinds`.
"""

import json
import re
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

from objectfolder.base.errors import ObjectFolderError, quoted, shortened

FORMAT = (1, 6)  #: major, minor; a reader accepts every file of its major version
MODALITIES = ("vision", "audio", "touch")
PARTS = ("geometry", *MODALITIES)
RADIATION = "radiation"  #: part that only sound at a listener needs
#: Names in a header, and what they consist of: the patterns of the schema in words.
NAMES = {
    "key": "a letter, then letters, digits or underscores, all lower case, at most 100",
    "material": "a name such as steel or unknown: letters and digits of ASCII, between them also spaces and "
    "any of . _ + -, at most 100 characters",
}


def format_name() -> str:
    """Return the format version that this package writes, as stored in files."""
    return ".".join(map(str, FORMAT))


@cache
def common_schema() -> dict[str, Any]:
    """Return the JSON Schema of the header without the nets that a build makes."""
    return json.loads(resources.files(__package__).joinpath("objectfile.schema.json").read_text())


def checked_header(header: Any, path: object) -> dict[str, Any]:
    """Return a copy of a header, converted to JSON types.

    Raises ObjectFolderError, which names the path, if it is not the header of an Object File, is of another
    major version, or violates the schema. Stages that write headers import no nets, so those are checked by
    `objectfolder.stored.kinds.checked_nets`.
    """
    try:
        header = json.loads(json.dumps(header, allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        raise ObjectFolderError(f"{path}: its header is not JSON: {error}") from error
    if not isinstance(header, dict) or "format" not in header:
        if isinstance(header, dict) and "schema" in header:
            raise ObjectFolderError(
                f"{path} is an Object File from before format 1.0; rebuild it with `objectfolder build`"
            )
        raise ObjectFolderError(f"{path} is not an Object File: its header lacks format")
    if not re.fullmatch(r"[0-9]{1,4}\.[0-9]{1,4}", str(header["format"])):
        raise ObjectFolderError(
            f"{path} has format {header['format']!r}, expected text like {format_name()!r}"
        )
    version = tuple(map(int, str(header["format"]).split(".")))
    if version[0] != FORMAT[0]:
        raise ObjectFolderError(
            f"{path} has format {header['format']}, this version reads {FORMAT[0]}.x; "
            + ("update objectfolder" if version > FORMAT else "rebuild it with `objectfolder build`")
        )
    for name in NAMES:
        if isinstance(header.get(name), str):
            checked_name(name, header[name], f"{path}: {name}")
    require_valid(header, common_schema(), path)
    return header


def checked_name(name: str, value: str, place: str) -> str:
    """Return one of the `NAMES` in a header.

    Raises ObjectFolderError if it is not as the schema's pattern says; ``place`` begins the message.
    """
    if not re.fullmatch(common_schema()["properties"][name]["pattern"], value):
        raise ObjectFolderError(f"{place} is {quoted(value)}, expected {NAMES[name]}")
    return value


def require_valid(value: Any, schema: dict[str, Any], path: object, place: Sequence[str] = ()) -> None:
    """Raise ObjectFolderError if a value at a place of the header of a file breaks a JSON Schema."""
    from jsonschema import Draft202012Validator

    errors = Draft202012Validator(schema).iter_errors(value)
    problem = min(errors, key=lambda e: (len(e.path), str(e.path)), default=None)
    if problem is not None:
        named = ".".join(map(str, [*place, *problem.path])) or "its header"
        raise ObjectFolderError(
            f"{path}: {named}: {shortened(problem.message, 300)}; what is expected: "
            "`python -m objectfolder.stored.kinds` prints the schema"
        )
