"""The `objectfolder` command."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from rich.text import Text

from objectfolder.base.disk import is_shortage
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import extra_with, install_command, installed_version
from objectfolder.base.terminal import Terminal, guard_streams
from objectfolder.base.text import visible
from objectfolder.cli import (
    asset,
    bench,
    creation,
    doctor,
    export,
    fit,
    listening,
    objectfile,
    objects,
    reconstruct,
    release,
    released,
    report,
    sample,
    sensor,
    simulate,
    upkeep,
    video,
    view,
    workspace,
)
from objectfolder.cli.console import App, Group
from objectfolder.cli.files import FORMS

__all__ = ["app", "main"]


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"objectfolder {installed_version()}")
        raise typer.Exit


#: Names of options by those of earlier versions, which still work.
FORMER = {"seconds": "duration", "rate": "fps", "size": "resolution"}


class _Commands(Group):
    """Commands whose usage errors show control characters of what was given."""

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        with _visible_errors():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        with _visible_errors():
            return super().invoke(ctx)


@contextmanager
def _visible_errors() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        if isinstance(message := getattr(error, "message", None), str):  # of a usage error
            error.message = visible(message, lines=True)  # type: ignore[attr-defined]
        raise


app = App(
    cls=_Commands,
    pretty_exceptions_enable=False,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "token_normalize_func": lambda name: FORMER.get(name, name),
    },
    help="Build and query **Object Files**, which answer how objects look, sound and feel.\n\n"
    "In a workspace (a folder with dvc.yaml; `objectfolder init` makes one): `objectfolder add MESH ...`, "
    "then `objectfolder build`.\n\n"
    "Anywhere: `objectfolder asset MESH --material steel --out DIR` for simulators; "
    "`objectfolder info FILE`, `objectfolder query vision|audio|touch FILE QUERIES.npy OUT/`; "
    f"FILE is a {FORMS}.",
)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Show the version, if asked."""


#: Commands and groups of them, by what they are for.
PANELS: dict[str, dict[str, Any]] = {
    "Build": {
        **{"init": creation.init, "add": objects.add, "fetch": objects.fetch, "preset": workspace.preset},
        **{"build": workspace.build, "status": upkeep.status, "inspect": workspace.inspect},
        **{"verify": upkeep.verify, "prune": upkeep.prune, "upgrade": creation.upgrade},
        **{"import": released.import_released, "doctor": doctor.doctor},
    },
    "Query": {
        **{"info": objectfile.info, "view": view.view, "video": video.video},
        **{"sample": sample.sample_app, "query": objectfile.query_app},
    },
    "Publish": {"report": report.report, "release": release.release},
    "Simulate": {"asset": asset.asset, "simulate": simulate.simulate, "export": export.export_app},
    "Measure": {
        **{"reconstruct": reconstruct.reconstruct, "bench": bench.bench_app, "fit": fit.fit_app},
        **{"sensor": sensor.sensor_app, "listening": listening.listening_app},
    },
}
for panel, commands in PANELS.items():
    for name, command in commands.items():
        if isinstance(command, App):
            app.add_typer(command, name=name, rich_help_panel=panel)
        else:
            app.command(name, rich_help_panel=panel)(command)


def main() -> None:
    """Run the command line; print user errors in one line without a traceback."""
    guard_streams()
    try:
        try:
            typer.main.get_command(app)()  # calling `app` would replace the hook for uncaught errors
        finally:
            if sys.stdout is not None:  # closed
                sys.stdout.flush()  # here, where a full device can be reported
    except ObjectFolderError as error:
        lines = str(error).replace("\n", "\n  ")  # what follows is no message of its own
        Terminal(stderr=True).print(Text.assemble(("error:", "bold red"), f" {lines}"), soft_wrap=True)
        sys.exit(1)
    except OSError as error:
        full = is_shortage(error)
        if error.filename is None and not full:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what Python writes at its end
        advice = "make space, or write elsewhere" if full else "check the path and its permissions"
        sys.exit(f"error: {visible(error.filename or 'the output')}: {error.strerror}; {advice}")
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "objectfolder":
            raise
        needed = install_command(extra_with(error.name or ""))
        sys.exit(f"error: {error.name} is not installed; this needs: {needed}")
