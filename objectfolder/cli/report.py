"""Command that reports on a dataset: report."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import console, print_line, show_page
from objectfolder.cli.files import FORMS, OpenOption, object_files, page_to_write, site_to_write


def report(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE",
            help=f"Object Files, each a {FORMS}; default: all objects of the workspace.",
            callback=object_files,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|FILE",
            help="Folder to write, default site; with --single-file, page, default report.html.",
        ),
    ] = None,
    single_file: Annotated[
        bool, typer.Option("--single-file", help="Write everything into one page, to mail.")
    ] = False,
    open_page: OpenOption = True,
) -> None:
    """Report on objects in a browser: ground truth beside predictions, scores, checks and the viewer.

    Writes a static site that opens from disk, offline (docs/viewer.md). If an object cannot be reported, the
    others are, and the exit code is 1.

    Examples: `objectfolder report`, `objectfolder report mug.safetensors --single-file --out mug.html`
    """
    from objectfolder.report.site import write_site
    from objectfolder.workspace import params
    from objectfolder.workspace.layout import Build

    out = page_to_write(out or Path("report.html")) if single_file else site_to_write(out or Path("site"))
    missing = {}
    paths = list(files or ())
    if not paths:
        entries = params.read()["objects"]
        paths = [Build(key).object_file for key in entries if Build(key).object_file.is_file()]
        missing = {key: entry for key, entry in entries.items() if not Build(key).object_file.is_file()}
        if not paths:
            raise ObjectFolderError(
                "no object of params.yaml is built; run `objectfolder build`, or name files"
            )
    failed = []

    def note(key: str, error: ObjectFolderError) -> None:
        failed.append(key)
        print_line(f"{key} cannot be reported: {error}")

    with console.status("reading objects") as status:
        page = write_site(paths, out, missing, single_file, lambda key: status.update(f"{key} is done"), note)
    count = plural(len(paths), "object") + (f", {len(failed)} failed" if failed else "")
    print_line(f"{page}: {count}")
    if open_page:
        show_page(page)
    if failed:
        raise typer.Exit(1)
