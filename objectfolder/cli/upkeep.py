"""Commands that look after a workspace: status, verify, prune."""

import json
from typing import Annotated

import typer

from objectfolder.cli.console import console

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
    from objectfolder.engine import statusview
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


def verify() -> None:
    """TODO"""


def prune() -> None:
    """TODO"""
