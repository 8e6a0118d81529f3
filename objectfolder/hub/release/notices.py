"""Notices of meshes, and licences: what others must be told of where a mesh is from."""

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from objectfolder.base.checks import is_web_address
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.text import in_markdown, visible
from objectfolder.objectfile.dataset import MAX_TEXT, IndexEntry

SOURCE = "SOURCE.txt"  #: that ``objectfolder fetch`` writes beside a mesh
#: Of what a notice consists, for messages; docs/dataset.md describes it.
NOTICE_LINES = (
    "lines `Licence: CC-BY-4.0`, `Attribution: WHO`, `Mesh and textures: TITLE, ADDRESS`, `Changes: WHAT`"
)
_CC = "https://creativecommons.org"
#: Address by identifier of SPDX. In lower case identifiers are those of the Hugging Face Hub.
LICENCE_URLS = {
    "Apache-2.0": "https://www.apache.org/licenses/LICENSE-2.0",
    "CC-BY-4.0": f"{_CC}/licenses/by/4.0/",
    "CC-BY-NC-4.0": f"{_CC}/licenses/by-nc/4.0/",
    "CC-BY-NC-SA-4.0": f"{_CC}/licenses/by-nc-sa/4.0/",
    "CC-BY-SA-4.0": f"{_CC}/licenses/by-sa/4.0/",
    "CC0-1.0": f"{_CC}/publicdomain/zero/1.0/",
    "MIT": "https://opensource.org/license/mit",
}
CONVERTED = "converted to an implicit representation by objectfolder"  #: a change that CC BY wants said
MAX_NOTICE = 2**16  #: bytes


@dataclass(frozen=True)
class Notice:
    """What the SOURCE.txt beside a mesh says; a field that it lacks is empty."""

    path: Path
    title: str = ""
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
    first = visible(text.partition("\n")[0].strip())
    if len(first) <= 200 and not re.match(r"[\w ]+:", first):  # of `objectfolder fetch`: the published name
        found["title"] = first
    for name, value in found.items():
        if len(value) > MAX_TEXT:
            long = f"its {name} has {len(value)} characters, expected at most {MAX_TEXT}"
            raise ObjectFolderError(f"{path}: {long}; shorten it")
    return Notice(path, **found)


def notice_text(mesh: Path, licence: str, author: str, source: str) -> str:
    """Return the notice of a mesh: what is given, then what a notice beside it says; empty if nothing is.

    The first line of a kind counts. Raises ObjectFolderError as `read_notice` does.
    """
    lines = {"Licence": licence, "Attribution": author, "Mesh and textures": source}
    text = "".join(f"{title}: {text}\n" for title, text in lines.items() if text)
    beside = read_notice(mesh)
    return text + (beside.path.read_text(encoding="utf-8", errors="replace") if beside else "")


def licence_name(text: str) -> str:
    """Return the SPDX expression of a licence such as "CC BY 4.0 (https://...)"; others as they are."""
    short = re.sub(r"[\s-]+", "-", text.partition("(")[0].strip()).lower()
    known = next((name for name in LICENCE_URLS if name.lower() == short), "")
    return known or spdx_expression(re.sub(r"\s*\(https?://[^()]*\)\s*$", "", text)) or text.strip()


def spdx_expression(text: str) -> str:
    """Return a licence as SPDX writes it, such as "MIT OR CC0-1.0"; empty if it is no expression of SPDX."""
    from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

    try:
        return canonicalize_license_expression(text)
    except InvalidLicenseExpression:
        return ""


def is_placeholder(text: str) -> bool:
    """Return whether a text stands for one that nobody has given yet."""
    return re.search(r"^\s*unnamed\s*$|\bexample\.(org|com|net)\b", text, re.IGNORECASE) is not None


def licence_address(text: str) -> str:
    """Return the address of a licence: of its identifier, or the one that the text gives; empty if none."""
    given = [word for word in re.split(r"[\s()<>,;]+", text) if is_web_address(word)]
    return LICENCE_URLS.get(licence_name(text)) or next(iter(given), "")


def hub_licence(licences: set[str]) -> str | list[str]:
    """Return the Hub's identifiers of the licences; "other" if it has none of one."""
    known = sorted(name.lower() for name in licences if name in LICENCE_URLS)
    return "other" if len(known) < len(licences) else known[0] if len(known) == 1 else known


def attributions(entries: Iterable[IndexEntry]) -> str:
    """List who is to be named for which objects and what was changed, as Markdown; empty if nobody is."""
    keys: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for entry in entries:
        if entry.attribution:
            address = "" if entry.licence_url in entry.licence else f" ({entry.licence_url})"
            keys[entry.attribution, entry.licence + address, entry.changes].append(entry.key)
    return "\n".join(
        f"- {in_markdown(attribution)}; {in_markdown(licence)}: {', '.join(held)}."
        f" Changes: {in_markdown(changes)}."
        for (attribution, licence, changes), held in keys.items()
    )
