"""Tables of scores beside chance, baselines and published figures; tasks lay theirs out of these parts.

The paper: Gao et al., CoRL 2021, Tables 2-4. The ObjectFolder Benchmark: Gao et al., CVPR 2023.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: Note of tables of the split unseen.
NEW_OBJECTS = " Intervals cover training seeds, not the choice of the few test objects."
#: What tables say of test rows that repeat an input, unless a task drops others.
REPEATED_INPUTS = "repeat an input of their object, and were dropped where nothing else is sensed"


@dataclass(frozen=True)
class Table:
    """Text table, with a note below that explains it."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str

    def markdown(self) -> str:
        """Return a Markdown table with its note."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", self.note])


def describe_rows(scores: Mapping[str, Any], repeated: str = REPEATED_INPUTS) -> str:
    """Describe the rows of a split, and which of them were dropped."""
    rows = scores["rows"]
    return (
        f"{rows['train']} rows to train with, {rows['val']} for validation, {rows['test']} for the test; "
        + describe_repeats(scores, repeated)
    )


def describe_repeats(scores: Mapping[str, Any], repeated: str) -> str:
    """Count the test rows that repeat an input, and name objects without a test row."""
    counts = scores["duplicates"]
    found = ", ".join(f"{parts['test']} of {name}" for name, parts in counts.items() if parts["test"])
    lost = ", ".join(f"{key} ({name})" for name, keys in scores.get("untested", {}).items() for key in keys)
    untested = f" Without a test row: {lost}." if lost else ""
    return f"test rows that {repeated}: {found or 'none'}.{untested}"


def describe_uncertain(keys: Sequence[str]) -> str:
    """Name objects that a task leaves out, since it uses sound."""
    return f"left out, since their sound is marked uncertain: {', '.join(keys)}"


def format_rate(share: Mapping[str, Any]) -> str:
    """Format a success rate and its interval, in percent."""
    low, high = share["interval_95"]
    return f"{100 * share['rate']:.0f} ({100 * low:.0f}-{100 * high:.0f})"


def format_interval(score: Mapping[str, Any], factor: float, digits: str) -> str:
    """Format a half width; empty for a single seed."""
    half = score["interval_95"]
    return "" if half is None else f" ± {factor * half:{digits}}"


def format_figure(value: float | None, digits: int = 4) -> str:
    """Format a figure; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"
