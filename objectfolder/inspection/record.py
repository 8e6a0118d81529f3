"""Result of an inspection, and helpers for its rows."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from objectfolder.errors import ObjectFolderError
from objectfolder.workspace.layout import Build


@dataclass(frozen=True)
class Inspection:
    """Summary of one stage's artifacts."""

    title: str
    rows: list[tuple[str, str]]  #: name and value
    pictures: list[Path] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)  #: exports for other programs


def require(build: Build, stage: str, *paths: Path) -> None:
    """Check that a stage's artifacts exist.

    Raises
    ------
    ObjectFolderError
        If one is missing.
    """
    for path in paths:
        if not path.is_file():
            raise ObjectFolderError(
                f"{stage}@{build.key}: {path} does not exist; run `objectfolder build {stage}@{build.key}`"
            )


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
