"""Console output of all commands, and their help."""

import time
import webbrowser
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
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
MINUTE = 60.0  # seconds between lines of progress without a terminal
#: Words of help for what is to be typed, by type.
WORDS = {"bool": "", "int": "N", "float": "NUMBER", "path": "FILE", "str": "TEXT"}


class WordedCommand(TyperCommand):
    """Command whose help shows what is to be typed instead of types."""

    def get_params(self, ctx: Any) -> Any:
        """Return arguments and options."""
        return list(map(_worded, super().get_params(ctx)))


class Group(TyperGroup):
    """Group of commands, the same."""

    def get_params(self, ctx: Any) -> Any:
        """Return options."""
        return list(map(_worded, super().get_params(ctx)))


class App(typer.Typer):
    """Group of commands; what it is started without is asked for by its help."""

    def __init__(self, **options: Any):
        shared: dict[str, Any] = {"cls": Group, "no_args_is_help": True, "rich_markup_mode": "markdown"}
        super().__init__(**shared | options)

    def command(self, name: str | None = None, **options: Any) -> Any:
        """Add a command."""
        return super().command(name, **{"cls": WordedCommand} | options)


def _worded(parameter: Any) -> Any:
    """Show a parameter by its metavar, or the word of its type; typer has no setting for this."""
    form = parameter.metavar
    if parameter.param_type_name == "argument":
        usage = form if parameter.required or form[0] == "[" else f"[{form}]"
        parameter.get_usage_pieces = lambda ctx: [usage]
        form = ""
    elif form is None:
        form = parameter.display_type(None).strip("<>").removesuffix(" range")
    parameter.display_type_rich = lambda ctx: WORDS.get(form, form)
    parameter._get_number_range_help_str = lambda: None
    return parameter


def track_progress(items: Iterable[Any], description: str, total: int) -> Iterable[Any]:
    """Iterate with a progress bar on a terminal, else a line each minute."""
    screen = Terminal(stderr=True)
    if screen.is_terminal:
        return track(items, description, total, console=screen, transient=True)
    return _count(items, description, total, _each_minute(screen))


def _count(items: Iterable[Any], description: str, total: int, show: Callable[[str], None]) -> Iterator[Any]:
    for done, item in enumerate(items, 1):
        yield item
        show(f"{description}: {done} of {total}")


@contextmanager
def show_status(text: str) -> Iterator[Callable[[str], None]]:
    """Return what shows a text in place of the last on a terminal, else at most one each minute."""
    screen = Terminal(stderr=True)
    if screen.is_terminal:
        with screen.status(text) as status:
            yield status.update
    else:
        yield _each_minute(screen)


def _each_minute(screen: Console) -> Callable[[str], None]:
    said = time.monotonic()

    def show(text: str) -> None:
        nonlocal said
        if time.monotonic() - said >= MINUTE:
            screen.print(text, highlight=False, soft_wrap=True)
            said = time.monotonic()

    return show


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
