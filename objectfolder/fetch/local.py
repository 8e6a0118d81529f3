"""Find the archive or folder of an object in a local directory."""

import difflib
from pathlib import Path
from urllib.parse import unquote

from objectfolder.errors import ObjectFolderError
from objectfolder.fetch.archive import SUFFIXES
from objectfolder.fetch.catalogue import Catalogue, comparable_name


def check_directory(directory: Path) -> None:
    """Raise ObjectFolderError unless ``--from`` names a directory."""
    if not directory.is_dir():
        raise ObjectFolderError(
            f"--from {directory} is not a directory; expected one with archives or folders"
        )


def find_local(directory: Path, catalogue: Catalogue, key: str) -> Path:
    """Find the archive or folder of an object in a directory.

    Case and punctuation are ignored. Accepted names: the object's key, its published name, its id at the
    source, either of these after the source's name, and the name of the source's archive. Otherwise, names
    that start with the id, as ``025_mug_google_64k.tgz``; otherwise, the directory itself.

    Returns
    -------
    Path

    Raises
    ------
    ObjectFolderError
        If nothing matches, or more than one; the message lists candidates.
    """
    check_directory(directory)
    entry = catalogue.objects[key]
    ids = {comparable_name(entry.name), comparable_name(entry.source_model)}
    archive = unquote(catalogue.archive_name(key))
    exact = (
        ids
        | {comparable_name(f"{entry.source}_{name}") for name in ids}
        | {comparable_name(key), _form(archive)}
    )
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
            f"{', '.join(path.name for path in found)}; keep only one of them"
        )
    if not found:
        forms = {_form(path.name): path.name for path in candidates}
        near = [forms[form] for name in exact for form in difflib.get_close_matches(name, forms, 2)]
        shown = list(dict.fromkeys(near)) or [path.name for path in candidates]
        raise ObjectFolderError(
            f"{directory} has no archive or folder of {key}; expected a name such as {entry.name}, "
            f"{archive} or {key}; {'similar' if near else 'found'}: {', '.join(shown[:8]) or 'nothing'}"
        )
    return found[0]


def _form(name: str) -> str:
    suffix = next((suffix for suffix in SUFFIXES if name.lower().endswith(suffix)), "")
    return comparable_name(name[: len(name) - len(suffix)])
