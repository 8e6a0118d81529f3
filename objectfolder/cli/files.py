"""What commands are given: Object Files, the samples among them, and folders to write."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import check_output
from objectfolder.objectfile.samples import available_samples, file_or_sample

#: Names of the samples, for the help of commands.
SAMPLE = f"a sample: {', '.join(available_samples())}"
PAGES = (".html", ".htm")  #: suffixes
#: Stages that a command on a workspace is for.
Targets = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[TARGET]...", help="`modal@mug`, a stage (`train_audio`) or an object (`mug`); default: all."
    ),
]


def object_file(given: Path) -> Path:
    """Return the Object File that a command is given: a path, or the sample of that name.

    A file of that name comes before the sample.

    Raises ObjectFolderError if there is neither, or it is a folder.
    """
    found = _there(file_or_sample(given), given)
    if found.is_dir():
        raise ObjectFolderError(
            f"{found} is a folder, expected an Object File such as {found}/ObjectFile.safetensors"
        )
    return found


def file_or_folder(given: Path) -> Path:
    """Return a path, or the sample of that name; a file or folder of that name comes before the sample."""
    return _there(given if _exists(given) else file_or_sample(given), given)


def _there(found: Path, given: Path) -> Path:
    if not _exists(found):
        raise ObjectFolderError(
            f"{shortened(given, 300)} does not exist; expected an Object File, or {SAMPLE}"
        )
    return found


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # a name that is too long, a folder without permission
        raise ObjectFolderError(f"{shortened(path, 300)} cannot be read: {error.strerror}") from error


def object_files(given: Sequence[Path] | None) -> list[Path] | None:
    """Return the Object Files that a command is given, if any; see `object_file`."""
    return None if given is None else [object_file(path) for path in given]


def files_or_folders(given: Sequence[Path] | None) -> list[Path] | None:
    """Return the Object Files, and folders with some, that a command is given, if any."""
    return None if given is None else [file_or_folder(path) for path in given]


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
    list[Path], typer.Argument(metavar="FILE...", help=f"Object Files, or {SAMPLE}.", callback=object_files)
]
OpenOption = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")]
