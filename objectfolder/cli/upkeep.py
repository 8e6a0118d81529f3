"""Commands that look after a workspace: status, verify, prune."""

import json
import sys
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from objectfolder.cli.console import console, print_wide, tracked
from objectfolder.errors import ObjectFolderError

Targets = Annotated[
    list[str] | None,
    typer.Argument(metavar="[TARGET]...", help="`modal@mug`, `train_audio` or `mug`; default: all."),
]


def status(
    targets: Targets = None,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON list, for machines.")] = False,
    check: Annotated[bool, typer.Option("--check", help="Exit with code 1 unless all is fresh.")] = False,
) -> None:
    """Show what is fresh, stale, missing, failed or never built.

    Without a target: a line per object that is not all fresh, a mark per stage. With one: every stage that
    it takes, and why it is not fresh: which dependency, parameter (old -> new) or module changed, which
    output is missing, how it failed at the last build and where its log is.
    """
    from objectfolder.cli import statusview
    from objectfolder.engine.status import State
    from objectfolder.engine.status import status as examine

    found = examine(targets or ())
    if as_json:
        print(json.dumps(statusview.as_json(found), indent=1))
    elif targets:
        statusview.print_details(found, console)
    else:
        statusview.print_table(found, console)
    raise typer.Exit(check and any(one.state is not State.FRESH for one in found))


def verify(
    targets: Targets = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Restore or rebuild what is bad, then verify again.")
    ] = False,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Files to read at a time; default: all cores.")
    ] = None,
) -> None:
    """Read all artifacts and cached objects again and compare them with what dvc.lock recorded.

    DVC trusts sizes and times; bytes that went bad in place are found here, in the workspace and in the
    cache. Every artifact is then read as the stages and queries read it. Without a target the whole cache is
    read, also what only earlier states refer to. Exit code 1 if anything is bad.

    --repair takes what is bad from the place where its hash is right, the cache or the workspace, and
    rebuilds what is right in neither. Sources that differ from their .dvc file are left: you may have
    changed them.
    """
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.verify import verify as run_verify

    with Progress() as progress:
        report = run_verify(targets or (), repair=repair, jobs=jobs, track=tracked, on_event=progress)
    if report.rebuilt is not None:
        print_summary(report.rebuilt)
    if report.findings:
        table = Table("object", "stage", "file", "what is wrong", "what to do", box=None)
        for one in report.findings:
            table.add_row(*map(Text, (one.key, one.stage, one.path, one.problem, one.remedy)))
        print_wide(table)
    bad = f"{len(report.findings)} bad" if report.findings else "all good"
    console.print(f"{report.files} files, {report.bytes / 1e6:.1f} MB read: {bad}", highlight=False)
    raise typer.Exit(bool(report.findings))


def prune(
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without asking.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be removed; keep all.")] = False,
) -> None:
    """Remove what was built of objects that are no longer in params.yaml, after showing it.

    That is their artifacts, metrics and logs, their entries in dvc.lock, and the cached objects and saved
    runs that are theirs alone: nothing goes that dvc.lock, a .dvc file or a saved run of another object
    names. Sources in data/objects and files that the pipeline did not write stay.

    As `dvc gc --workspace`, it looks at this workspace only: another branch or commit that has these objects
    will have to build or `dvc pull` them again.
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
        console.print("nothing to remove: every object that was built is in params.yaml")
        return
    total = f"{waste.bytes / 1e6:.1f} MB of {len(waste.keys)} objects"
    if dry_run:
        console.print(f"{total} would be removed", highlight=False)
        return
    if not yes:
        if not sys.stdin.isatty():
            raise ObjectFolderError(
                f"{total} would be removed; say so with --yes, as nobody can be asked here"
            )
        typer.confirm(f"Remove {total}?", abort=True)
    run_prune(waste)
    console.print(f"removed {total}; commit dvc.lock", highlight=False)
