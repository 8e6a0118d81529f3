"""The `objectfolder` command."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from rich.text import Text
from typer.core import TyperGroup

from objectfolder.base.disk import is_shortage
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import extra_with, install_command, installed_version
from objectfolder.base.terminal import Terminal, guard_streams
from objectfolder.base.text import visible
from objectfolder.cli import (
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
from objectfolder.cli.files import FORMS

__all__ = ["app", "main"]


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"objectfolder {installed_version()}")
        raise typer.Exit


class _Commands(TyperGroup):
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


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Build and query **Object Files**, implicit representations of how objects look, sound and feel.\n\n"
    "In a workspace (a folder with dvc.yaml; `objectfolder init` makes one): `objectfolder add MESH ...`, "
    "then `objectfolder build`.\n\n"
    "Anywhere: `objectfolder info FILE`, `objectfolder query vision|audio|touch FILE QUERIES.npy OUT/`; "
    f"FILE is a {FORMS}.",
)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Show the version, if asked."""


for command in (
    *(creation.init, workspace.build, upkeep.status, upkeep.verify, upkeep.prune, creation.upgrade),
    *(objects.add, objects.fetch, workspace.preset, workspace.inspect, objectfile.info, view.view),
    *(report.report, release.release, video.video, simulate.simulate, reconstruct.reconstruct, doctor.doctor),
):
    app.command()(command)
app.command("import")(released.import_released)
app.add_typer(objectfile.query_app, name="query")
app.add_typer(sample.sample_app, name="sample")
app.add_typer(sensor.sensor_app, name="sensor")
app.add_typer(bench.bench_app, name="bench")
app.add_typer(export.export_app, name="export")
app.add_typer(fit.fit_app, name="fit")
app.add_typer(listening.listening_app, name="listening")


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
