"""Notices of meshes, and licences: what others must be told of where a mesh is from."""

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

SOURCE = "SOURCE.txt"  #: that ``objectfolder fetch`` writes beside a mesh
# Identifiers of SPDX. In lower case they are those of the Hugging Face Hub.
_LICENCES = (
    "Apache-2.0",
    "CC-BY-4.0",
    "CC-BY-NC-4.0",
    "CC-BY-NC-SA-4.0",
    "CC-BY-SA-4.0",
    "CC0-1.0",
    "MIT",
)


@dataclass(frozen=True)
class Notice:
    """What the SOURCE.txt beside a mesh says; a field that it lacks is empty."""

    path: Path
    licence: str = ""
    source: str = ""
    attribution: str = ""
    changes: str = ""


def read_notice(mesh: Path) -> Notice | None:
    """Read the notice beside a mesh; None if there is none."""
    path = mesh.parent / SOURCE
    if not path.is_file():
        return None
    text = path.read_text(errors="replace")
    fields = {
        "licence": "Licen[cs]e",
        "source": "Mesh and textures",
        "attribution": "Attribution",
        "changes": "Changes",
    }
    found = {
        name: match[1].strip()
        for name, title in fields.items()
        if (match := re.search(rf"^\s*{title}\s*:\s*(\S.*)$", text, re.MULTILINE | re.IGNORECASE))
    }
    return Notice(path, **found)


def licence_name(text: str) -> str:
    """Return the SPDX identifier of a licence in one of its spellings, such as "CC BY 4.0 (https://...)".

    Others are returned as they are.
    """
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
        f"- {attribution}{f'; {licence}' if licence else ''}: {', '.join(held)}."
        + (f" Changes: {changes}" if changes else "")
        for (attribution, licence, changes), held in keys.items()
    )
