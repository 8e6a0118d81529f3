"""Commands that maintain a workspace: status, verify, prune."""

import json
import sys
from dataclasses import asdict
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import console, print_wide, track_progress
from objectfolder.cli.files import Targets


def status(
    targets: Targets = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON: a list of stages; while a build runs, its progress.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Exit with code 1 unless all stages are fresh.")
    ] = False,
) -> None:
    """Show which stages are fresh, stale, missing, failed or never built.

    Without targets: the objects that are not fresh, with a mark per stage. With targets: each stage, and why
    it is not fresh: the changed dependency, parameter (old -> new) or module, the missing output, or the
    failure of the last build and its log. `objectfolder build` with the same targets brings them up to date.

    While a build runs, in any terminal or on a cluster: its running, finished, failed and remaining stages.
    """
    from objectfolder.engine.journal import read_journal
    from objectfolder.engine.progress import print_build, print_death

    build = read_journal()
    if build and build.alive:  # it holds the lock that the rest needs
        if as_json:
            print(json.dumps(asdict(build), indent=1))
        else:
            print_build(build, console)
        raise typer.Exit(check)
    from objectfolder.cli import statusview
    from objectfolder.engine.status import State
    from objectfolder.engine.status import status as examine
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_entries
    from objectfolder.workspace.installed import check_installed

    check_installed()
    check_entries(params.read())  # what a build would refuse, as far as that takes no time
    found = examine(targets or ())
    if as_json:
        print(json.dumps(statusview.as_json(found), indent=1))
    elif targets:
        statusview.print_details(found, console)
    else:
        statusview.print_table(found, console)
    stale = any(one.state is not State.FRESH for one in found)
    if build and stale and not as_json:
        print_death(build, console)
    raise typer.Exit(check and stale)


def verify(
    targets: Targets = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Restore or rebuild bad files, then verify again.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", "-j", min=1, help="Number of files to read in parallel; default: number of cores."
        ),
    ] = None,
) -> None:
    """Verify the hashes of all artifacts and cached files, and check that artifacts load.

    Hashes are those of dvc.lock. DVC trusts file sizes and times; this command also finds silent corruption,
    in the workspace and in the cache. Without targets, the whole cache is read, including files of earlier
    states. The exit code is 1 if anything is bad.

    --repair restores a bad file from the intact copy in the cache or the workspace, and rebuilds it if there
    is none. Sources that differ from their .dvc file are kept, because you may have edited them.
    """
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.verify import verify as run_verify

    with Progress(task="verifying") as progress:
        report = run_verify(targets or (), repair=repair, jobs=jobs, track=track_progress, on_event=progress)
    if report.rebuilt is not None:
        print_summary(report.rebuilt)
    if report.findings:
        table = Table("object", "stage", "file", "problem", "remedy", box=None)
        for one in report.findings:
            table.add_row(*map(Text, (one.key, one.stage, one.path, one.problem, one.remedy)))
        print_wide(table)
    bad = f"{len(report.findings)} bad" if report.findings else "all good"
    read = f"{plural(report.files, 'file')}, {report.bytes_read / 1e6:.1f} MB read"
    console.print(f"{read}: {bad}", highlight=False)
    raise typer.Exit(bool(report.findings))


def prune(
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without confirmation.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be removed; remove nothing.")
    ] = False,
) -> None:
    """Remove the build results of objects that are no longer in params.yaml, after confirmation.

    This removes their artifacts, metrics and logs, their entries in dvc.lock, and their cached files and
    saved runs, unless dvc.lock, a .dvc file or a saved run of another object refers to them. Sources in
    data/objects and files that the pipeline did not write are kept.

    Like `dvc gc --workspace`, it considers only this workspace: on other branches or commits with these
    objects, build or `dvc pull` them again.
    """
    from objectfolder.engine.prune import prune as run_prune
    from objectfolder.engine.prune import survey

    waste = survey()
    if waste.keys:
        table = Table("object", "files", "MB", "cached objects", "MB", box=None)
        for key in waste.keys:
            row = waste.files[key], waste.cached[key]
            cells = [text for paths in row for text in (str(len(paths)), f"{waste.size(paths) / 1e6:.1f}")]
            table.add_row(key, *cells)
        print_wide(table)
    for note in waste.left:
        console.print(Text(f"left: {note}"), soft_wrap=True)
    if not waste.keys:
        console.print("nothing to remove: all built objects are in params.yaml")
        return
    total = f"{waste.bytes / 1e6:.1f} MB of {plural(len(waste.keys), 'object')}"
    if dry_run:
        console.print(f"{total} would be removed", highlight=False)
        return
    if not yes:
        if not sys.stdin.isatty():
            raise ObjectFolderError(
                f"{total} would be removed; confirm with --yes, because standard input is not a terminal"
            )
        typer.confirm(f"Remove {total}?", abort=True)
    run_prune(waste)
    console.print(f"removed {total}; commit dvc.lock", highlight=False)
