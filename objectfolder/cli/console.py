"""Console output of all commands, and their help."""

import webbrowser
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.measure import Measurement
from rich.progress import track
from rich.table import Table
from typer.core import TyperCommand, TyperGroup

from objectfolder.base.terminal import Terminal
from objectfolder.base.text import visible

console = Terminal()
NO_OBJECTS = "no objects yet: `objectfolder add MESH --name NAME --material MATERIAL`"


class _PlainHelp:
    """Help without the types of flags and arguments."""

    def get_params(self, ctx: Any) -> Any:
        params = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
            elif param.param_type_name == "argument":
                param.display_type_rich = lambda ctx: None  # its name says enough
        return params


class _PlainCommand(_PlainHelp, TyperCommand):
    pass


class PlainGroup(_PlainHelp, TyperGroup):
    """Group of commands."""


class Commands(typer.Typer):
    """Group of commands that are declared by functions; ``-h`` is that of the outermost group."""

    def __init__(self, help: str, cls: type[TyperGroup] = PlainGroup, **options: Any) -> None:
        super().__init__(help=help, cls=cls, no_args_is_help=True, rich_markup_mode="markdown", **options)

    def command(self, name: str | None = None, **options: Any) -> Any:
        """Declare a command."""
        return super().command(name, cls=_PlainCommand, **options)


def track_progress(items: Iterable[Any], description: str, total: int) -> Iterable[Any]:
    """Iterate with a progress bar, shown only on a terminal."""
    screen = Terminal(stderr=True)
    return track(items, description, total, console=screen, transient=True, disable=not screen.is_terminal)


def print_line(text: str) -> None:
    """Print one line, whatever is in it; programs may read it."""
    console.print(visible(text), highlight=False, soft_wrap=True)


def show_page(page: Path) -> None:
    """Open a page in a browser, or say that there is none."""
    if not webbrowser.open(page.resolve().as_uri()):
        console.print("no browser found: open the page in one", highlight=False)


def print_wide(table: Table, console: Console = console) -> None:
    """Print a table, at its full width unless the output is a terminal."""
    if not console.is_terminal:
        wide = Measurement.get(console, console.options.update(max_width=10_000), table).maximum
        console = Terminal(file=console.file, width=max(wide, console.width))
    console.print(table)
