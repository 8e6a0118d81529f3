"""Command that reports on a dataset: report."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import print_line, show_page, show_status
from objectfolder.cli.files import FORMS, OpenOption, object_files, page_to_write, site_to_write


def report(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE]...",
            help=f"Object Files, each a {FORMS}; default: all objects of the workspace.",
            callback=object_files,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Folder to write (default: site); with --single-file, page (default: report.html).",
        ),
    ] = None,
    single_file: Annotated[
        bool, typer.Option("--single-file", help="Write one page that contains everything.")
    ] = False,
    open_page: OpenOption = True,
) -> None:
    """Write a website about objects: ground truth beside prediction, scores, checks and a viewer.

    The site is static, and needs no server or network (docs/viewer.md). The exit code is 1 if there is an
    object that cannot be reported; the others have their pages.

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

    with show_status("reading objects") as show:
        page = write_site(paths, out, missing, single_file, lambda key: show(f"{key} is done"), note)
    count = plural(len(paths), "object") + (f", {len(failed)} failed" if failed else "")
    print_line(f"{page}: {count}")
    if open_page:
        show_page(page)
    if failed:
        raise typer.Exit(1)
