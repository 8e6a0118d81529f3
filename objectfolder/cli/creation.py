"""Commands that make a workspace and move it to another version: init, upgrade."""

from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer
from rich.text import Text

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import install_command, installed_version
from objectfolder.cli.console import console

MAX_NAMES = 5  # names in a line


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to create; it may exist and be empty.")
    ],
) -> None:
    """Create a workspace for your own dataset: a Git and DVC repository without objects.

    It holds the graph of stages (dvc.yaml), a script per stage, parameters and presets, a README with the
    dataset's card and an example of continuous integration. The code is that of the installed package, whose
    digests the workspace records. Next, in the workspace: `objectfolder add`, `objectfolder build`.
    """
    if find_spec("dvc") is None:
        raise ObjectFolderError(f"DVC is not installed; a workspace needs: {install_command('build')}")
    from objectfolder.engine.dvc.repository import start_repository
    from objectfolder.workspace.creation import create_workspace

    create_workspace(folder, start_repository)
    outer = next((above for above in folder.resolve().parents if (above / ".git").exists()), None)
    if outer:
        console.print(
            f"note: {folder} is a Git repository inside that of {outer}: add it to {outer / '.gitignore'}",
            soft_wrap=True,
            highlight=False,
        )
    console.print(
        f"made a workspace of objectfolder {installed_version()} in {folder}; next: cd {quote(str(folder))}, "
        "objectfolder add MESH --name NAME --material MATERIAL --scale METRES, objectfolder build",
        soft_wrap=True,
        highlight=False,
    )


def upgrade() -> None:
    """Upgrade a workspace of `objectfolder init` to the installed version, and show what a build would run.

    First install the version, for example by `git pull` in a clone of objectfolder and
    `pip install --upgrade 'CLONE[build]'`. Scripts, graph and presets that you have not edited are replaced;
    for edited ones, the new text is written to NAME.new. Your settings are kept, and new ones added.
    `git diff` shows all changes; `git checkout .` reverts them.
    """
    from objectfolder.cli.statusview import print_outlook
    from objectfolder.engine.status import status
    from objectfolder.workspace.creation import NEW, upgrade_workspace

    done = upgrade_workspace(Path())
    lines = {
        "changed in the package": done.changed,
        "replaced or added": done.written,
        "removed": done.removed,
        f"edited here: merge the new text, NAME{NEW}, by hand": done.conflicts,
        "added to params.yaml": done.params,
    }
    console.print(f"this workspace is now of objectfolder {installed_version()}", highlight=False)
    for title, names in lines.items():
        if names:
            more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
            console.print(Text(f"{title}: {', '.join(names[:MAX_NAMES])}{more}"), soft_wrap=True)
    console.print("a build would:")
    print_outlook(status(), console)
