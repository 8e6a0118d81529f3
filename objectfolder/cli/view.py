"""Command that opens Object Files in a browser: view."""

from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli.console import print_line, show_page
from objectfolder.cli.files import FilesArgument, OpenOption, page_to_write


def view(
    files: FilesArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write; default: a temporary file."),
    ] = None,
    open_page: OpenOption = True,
) -> None:
    """See, strike and touch objects in a browser.

    Writes one page that contains the files and the viewer. It needs no server or network (docs/viewer.md).

    Examples: objectfolder view mug, objectfolder view mug.safetensors
    """
    from objectfolder.base.io import write_text
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.viewer.page import viewer_page

    page = page_to_write(out) if out else Path(mkdtemp(prefix="objectfolder-")) / "view.html"
    objects: dict[str, bytes] = {}
    for path in files:
        key = ObjectFile.load(path).key
        if key in objects:
            raise ObjectFolderError(
                f"{path}: another file has an object with the key {key}; give one of them"
            )
        objects[key] = path.read_bytes()
    write_text(page, viewer_page(objects, ", ".join(objects)))
    print_line(f"{page} ({page.stat().st_size / 1e6:.1f} MB)")
    if open_page:
        show_page(page)
