"""What commands are given: Object Files, and folders to write."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output
from objectfolder.base.terminal import Terminal
from objectfolder.objectfile.samples import available_samples
from objectfolder.workspace.layout import Build
from objectfolder.workspace.lookup import FORMS, find_object_files, own_keys

#: Names of an object of this workspace, for help.
OWN = "key in params.yaml, or Object File in build/"
PAGES = (".html", ".htm")  #: suffixes
#: Stages that a command on a workspace is for.
Targets = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[TARGET]...",
        help="Stage of an object (`modal@mug`), stage (`train_audio`) or object (`mug`); default: all.",
    ),
]


def object_file(given: Path) -> Path:
    """Return the Object File that a command is given; see `objectfolder.workspace.lookup.find_object_files`.

    Raises ObjectFolderError if there is none, or several.
    """
    found = _named(given)
    if len(found) > 1:
        raise ObjectFolderError(f"{given} has {len(found)} Object Files, expected one, such as {found[0]}")
    return found[0]


def object_files(given: Sequence[Path] | None) -> list[Path] | None:
    """Return the Object Files that a command is given, if any; see `object_file`."""
    return None if given is None else [file for name in given for file in _named(name)]


def _named(given: Path) -> list[Path]:
    """Find Object Files; say so if a build comes before a sample."""
    found = find_object_files(given)
    if str(given) in available_samples() and found == [Build(str(given)).object_file]:
        said = f"note: {given} is {found[0]}, not the sample of that name"
        Terminal(stderr=True).print(said, highlight=False, soft_wrap=True)
    return found


def object_key(given: str) -> str:
    """Return the key of this workspace's object that a command is given, by `OWN`; it may not exist.

    Raises ObjectFolderError if it is something else, or several.
    """
    keys = own_keys(Path(given))
    if len(keys) > 1:
        raise ObjectFolderError(f"{given} has {len(keys)} objects, expected one, such as {keys[0]}")
    return keys[0]


def object_keys(given: Sequence[str] | None) -> list[str] | None:
    """Return the keys of this workspace's objects that a command is given, if any; see `object_key`."""
    return None if given is None else [key for name in given for key in own_keys(Path(name))]


def folder_to_write(given: Path) -> Path:
    """Return a folder that a command writes into; it need not exist.

    Raises ObjectFolderError if it is a file or a link to nothing, or it cannot be written.
    """
    if os.path.lexists(given) and not given.is_dir():
        raise ObjectFolderError(f"{given} is a file, expected a folder; choose another name")
    above = next(path for path in (given.absolute(), *given.absolute().parents) if path.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        raise ObjectFolderError(
            f"cannot write {given}: {above} is not a folder that you may write in; make it one, or choose "
            "another name"
        )
    return given


def page_to_write(given: Path) -> Path:
    """Return a page that a command writes; an older page is replaced.

    Raises ObjectFolderError if its name is not one of a page, as that of an Object File, or it cannot be
    written.
    """
    if given.suffix.lower() not in PAGES:
        raise ObjectFolderError(f"--out {given}: expected the name of a page, such as {given.stem}.html")
    check_output(given)
    return given


def site_to_write(given: Path) -> Path:
    """Return a folder for a report, which holds none or an older one.

    Raises ObjectFolderError if it has the name of a page, is a file, or holds a page that no report wrote.
    """
    if given.suffix.lower() in PAGES:
        raise ObjectFolderError(f"--out {given}: expected a folder; for one page, add --single-file")
    folder = folder_to_write(given)
    if (folder / "index.html").exists() and not (folder / "viewer.js").exists():
        raise ObjectFolderError(
            f"{folder} holds an index.html that is not of a report; choose another folder with --out"
        )
    return folder


def empty_folder(given: Path) -> Path:
    """Return a folder that a command writes into, which does not exist or is empty but for hidden files.

    Raises ObjectFolderError if it is a file, or holds files, which would stay among the new ones.
    """
    folder = folder_to_write(given)
    held = sorted(path.name for path in folder.iterdir() if path.name[0] != ".") if folder.is_dir() else []
    if held:
        more = ", ..." if len(held) > 4 else ""
        raise ObjectFolderError(
            f"{folder} is not empty: it holds {', '.join(held[:4])}{more}; choose another name, or delete it"
        )
    return folder


#: Object Files that a command is for.
FilesArgument = Annotated[
    list[Path],
    typer.Argument(metavar="FILE...", help=f"Object Files, each a {FORMS}.", callback=object_files),
]
OpenOption = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")]
