"""Notices of meshes, and licences: what others must be told of where a mesh is from."""

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.text import in_markdown, visible
from objectfolder.objectfile.dataset import MAX_TEXT

SOURCE = "SOURCE.txt"  #: that ``objectfolder fetch`` writes beside a mesh
# Identifiers of SPDX. In lower case they are those of the Hugging Face Hub.
_LICENCES = ("Apache-2.0", "CC-BY-4.0", "CC-BY-NC-4.0", "CC-BY-NC-SA-4.0", "CC-BY-SA-4.0", "CC0-1.0", "MIT")
MAX_NOTICE = 2**16  #: bytes


@dataclass(frozen=True)
class Notice:
    """What the SOURCE.txt beside a mesh says; a field that it lacks is empty."""

    path: Path
    licence: str = ""
    source: str = ""
    attribution: str = ""
    changes: str = ""


def read_notice(mesh: Path) -> Notice | None:
    """Read the notice beside a mesh; None if there is none.

    Raises ObjectFolderError if it is too long for a notice, or a link to another place than the folder of the
    mesh or a DVC cache: a release copies it, and the file may be private.
    """
    path = mesh.parent / SOURCE
    if not path.is_file():
        return None
    target = path.resolve()
    if target.parent != mesh.parent.resolve() and target.parts[-4:-2] != ("files", "md5"):
        raise ObjectFolderError(f"{path} is a link to {target}, expected a file of its own; copy it there")
    with path.open("rb") as stream:
        content = stream.read(MAX_NOTICE + 1)
    if len(content) > MAX_NOTICE:
        raise ObjectFolderError(f"{path} has more than {MAX_NOTICE:,} bytes, expected a notice; shorten it")
    text = content.decode(errors="replace")
    titles = {"licence": "Licen[cs]e", "source": "Mesh and textures"}
    titles |= {"attribution": "Attribution", "changes": "Changes"}
    found = {
        name: visible(match[1].strip())
        for name, title in titles.items()
        if (match := re.search(rf"^\s*{title}\s*:\s*(\S.*)$", text, re.MULTILINE | re.IGNORECASE))
    }
    for name, value in found.items():
        if len(value) > MAX_TEXT:
            long = f"its {name} has {len(value)} characters, expected at most {MAX_TEXT}"
            raise ObjectFolderError(f"{path}: {long}; shorten it")
    return Notice(path, **found)


def licence_name(text: str) -> str:
    """Return the SPDX identifier of a licence such as "CC BY 4.0 (https://...)"; others as they are."""
    short = re.sub(r"[\s-]+", "-", text.partition("(")[0].strip()).lower()
    return next((name for name in _LICENCES if name.lower() == short), text.strip())


def hub_licence(licences: set[str]) -> str:
    """Return the Hub's identifier of the only licence; "other" if it has none, or there are several."""
    known = [name for name in licences if name in _LICENCES]
    return known[0].lower() if len(licences) == len(known) == 1 else "other"


def attributions(notices: Mapping[str, Notice]) -> str:
    """List who is to be named for which objects and what was changed, as Markdown; empty if nobody is."""
    keys: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for key, notice in notices.items():
        if notice.attribution:
            keys[notice.attribution, notice.licence, notice.changes].append(key)
    return "\n".join(
        f"- {in_markdown(attribution)}{f'; {in_markdown(licence)}' if licence else ''}: {', '.join(held)}."
        + (f" Changes: {in_markdown(changes)}" if changes else "")
        for (attribution, licence, changes), held in keys.items()
    )
