"""Find an object among archives and folders that the user has already."""

import difflib
from pathlib import Path
from urllib.parse import unquote

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.archive import SUFFIXES
from objectfolder.fetch.catalogue import Catalogue, normal


def find_local(directory: Path, catalogue: Catalogue, key: str) -> Path:
    """Find the archive or folder of an object in a directory.

    Names are compared without case and punctuation: with the object's key, its published name, its id at
    the source, those two after the source's name, and the name of the source's archive. Failing that, a
    name may go on after the id, as in ``025_mug_google_64k.tgz``; failing that, the directory itself may be
    the object's folder.

    Returns
    -------
    Path

    Raises
    ------
    ObjectFolderError
        If nothing matches, or several do; the message names candidates.
    """
    if not directory.is_dir():
        raise ObjectFolderError(
            f"--from {directory} is not a directory; expected one with archives or folders"
        )
    entry = catalogue.objects[key]
    ids = {normal(entry.name), normal(entry.source_model)}
    archive = unquote(catalogue.archive_name(key))
    exact = ids | {normal(f"{entry.source}_{name}") for name in ids} | {normal(key), _form(archive)}
    candidates = sorted(
        path
        for path in directory.iterdir()
        if not path.name.startswith(".") and (path.is_dir() or path.name.lower().endswith(SUFFIXES))
    )
    found = (
        [path for path in candidates if _form(path.name) in exact]
        or [path for path in candidates if any(_form(path.name).startswith(f"{name}_") for name in ids)]
        or [path for path in [directory.resolve()] if _form(path.name) in exact]
    )
    if len(found) > 1:
        raise ObjectFolderError(
            f"{directory} has {len(found)} candidates for {key} ({entry.name}): "
            f"{', '.join(path.name for path in found)}; leave one of them there"
        )
    if not found:
        forms = {_form(path.name): path.name for path in candidates}
        near = [forms[form] for name in exact for form in difflib.get_close_matches(name, forms, 2)]
        shown = list(dict.fromkeys(near)) or [path.name for path in candidates]
        raise ObjectFolderError(
            f"{directory} has no archive or folder of {key}; expected a name such as {entry.name}, "
            f"{archive} or {key}; {'near ones' if near else 'it has'}: {', '.join(shown[:8]) or 'nothing'}"
        )
    return found[0]


def _form(name: str) -> str:
    suffix = next((suffix for suffix in SUFFIXES if name.lower().endswith(suffix)), "")
    return normal(name[: len(name) - len(suffix)])
