"""Inspection of a stage: a table for the terminal, and pictures; and helpers for its rows."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import ObjectFolderError
from objectfolder.workspace.layout import Build


@dataclass(frozen=True)
class Inspection:
    """Summary of one stage's artifacts."""

    title: str
    rows: list[tuple[str, str]]  #: name and value
    pictures: list[Path] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)  #: exports for other programs


def require(build: Build, stage: str, *paths: Path) -> None:
    """Raise ObjectFolderError unless a stage's artifacts exist."""
    name = f"{stage}@{build.key}"
    for path in paths:
        if not path.is_file():
            raise ObjectFolderError(f"{name}: {path} does not exist; run `objectfolder build {name}`")


def picture_path(build: Build, stage: str) -> Path:
    """Return the path of a stage's picture, in a directory that no stage declares."""
    return build.inspections / f"{stage}.png"


def kilobytes(*paths: Path) -> str:
    """Format the total size of files."""
    return in_kilobytes(sum(path.stat().st_size for path in paths))


def in_kilobytes(count: int) -> str:
    """Format a number of bytes, in thousands."""
    return f"{count / 1000:,.1f} kB"


def span(values: np.ndarray, unit: str = "", form: str = ".4g") -> str:
    """Format the smallest and the largest value."""
    if np.size(values) == 0:
        return "none"
    return f"{np.min(values):{form}} to {np.max(values):{form}} {unit}".rstrip()


def print_inspection(inspection: Inspection, console: Console) -> None:
    """Print the table, and the paths of pictures and exported files."""
    table = Table(title=inspection.title, show_header=False, title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in inspection.rows:
        table.add_row(Text(name), Text(value))  # text, not markup: values may contain brackets
    console.print(table)
    for kind, paths in (("picture", inspection.pictures), ("file", inspection.files)):
        for path in paths:
            console.print(Text(f"{kind}: {path}"), soft_wrap=True)
