"""Console output of all commands."""

import webbrowser
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.measure import Measurement
from rich.progress import track
from rich.table import Table

from objectfolder.base.terminal import Terminal
from objectfolder.base.text import visible

console = Terminal()


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
