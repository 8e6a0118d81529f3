"""Display of stage status: table of objects, detailed reasons, dry run, JSON."""

from collections import Counter
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import plural
from objectfolder.cli.console import print_wide
from objectfolder.engine.status import Outlook, StageStatus, State
from objectfolder.engine.summary import NO_OBJECTS
from objectfolder.workspace.stages import TASKS

MARKS = {
    State.FRESH: (".", "dim"),
    State.STALE: ("S", "yellow"),
    State.UPSTREAM: ("u", "yellow"),
    State.MISSING: ("M", "magenta"),
    State.FAILED: ("F", "bold red"),
    State.NEVER: ("-", "cyan"),
}
#: Actions of a build in its summary.
WORDS = {
    Outlook.SKIP: "up to date",
    Outlook.RESTORE: "to bring back",
    Outlook.RUN: "to run",
    Outlook.PERHAPS: "perhaps to run",
}
#: Number of most common reasons, shown below the table.
CAUSES = 5


def print_table(found: Sequence[StageStatus], console: Console) -> None:
    """Print objects that are not fresh with a mark per stage, and the most common reasons."""
    objects: dict[str, dict[str, StageStatus]] = {}
    for one in found:
        if one.key:
            objects.setdefault(one.key, {})[one.stage] = one
    lines = {
        key: row for key, row in objects.items() if any(s.state is not State.FRESH for s in row.values())
    }
    for one in found:
        if not one.key and one.state is not State.FRESH:
            console.print(Text.assemble(_mark(one.state), f" {one.address}  {one.state}"), soft_wrap=True)
    if lines:
        stages = list(dict.fromkeys(stage for row in lines.values() for stage in row))
        table = Table("", *(name.replace("_", "\n") for name in stages), box=None, padding=(0, 1, 0, 0))
        for key, row in sorted(lines.items()):
            table.add_row(key, *(_mark(row[s].state) if s in row else "" for s in stages))
        print_wide(table, console)
        shown = [
            state
            for state in MARKS
            if any(one.state is state for row in lines.values() for one in row.values())
        ]
        legend = [Text.assemble(_mark(state), f" {state}") for state in shown]
        console.print(Text("   ").join(legend), soft_wrap=True)
    causes = Counter(reason for one in found for reason in one.reasons)
    for reason, count in causes.most_common(CAUSES):
        console.print(Text(f"{count:5d} x {reason}"), soft_wrap=True)
    keys = {one.key for one in found if one.key and one.stage not in TASKS}  # theirs are splits
    fresh = len(keys - set(lines))
    if not keys:
        complete = NO_OBJECTS
    else:
        complete = f"{fresh} of {plural(len(keys), 'object')} complete" if fresh else "no object is complete"
    console.print(f"{_states(found)}; {complete}", highlight=False, soft_wrap=True)
    if lines:
        hint = (
            "`objectfolder status OBJECT` explains why; `objectfolder build --dry-run` shows what would run"
        )
        console.print(hint, soft_wrap=True)


def print_details(found: Iterable[StageStatus], console: Console) -> None:
    """Print every stage, with the reasons if it is not fresh."""
    found = list(found)
    width = max(len(one.address) for one in found)
    for one in found:
        mark, style = MARKS[one.state]
        line = Text(f"{mark} {one.address.ljust(width)}  ", style=style).append(one.state)
        console.print(line, soft_wrap=True)
        for reason in (*_reasons(one), *([f"log: {one.log}"] if one.log else [])):
            console.print(Text(f"    {reason}"), soft_wrap=True)
    console.print(_states(found), highlight=False)


def print_outlook(found: Iterable[StageStatus], console: Console) -> None:
    """Print the action of a build for every stage that is not fresh, and the reasons."""
    found = list(found)
    acting = [one for one in found if one.outlook is not Outlook.SKIP]
    width = max((len(one.address) for one in acting), default=0)
    styles = {Outlook.RUN: "yellow", Outlook.RESTORE: "cyan", Outlook.PERHAPS: "dim"}
    for one in acting:
        line = Text(f"{one.outlook:<11}  ", style=styles[one.outlook])
        line.append(f"{one.address.ljust(width)}  ", style="default")
        line.append("; ".join(_reasons(one)) or one.state, style="default")
        console.print(line, soft_wrap=True)
    counts = Counter(one.outlook for one in found if not _is_source(one) or one in acting)
    text = ", ".join(f"{counts[outlook]} {words}" for outlook, words in WORDS.items() if counts[outlook])
    console.print(text or "no stages", highlight=False)


def as_json(found: Iterable[StageStatus]) -> list[dict[str, object]]:
    """Return the status as values for JSON."""
    return [
        {
            **{"address": one.address, "stage": one.stage, "object": one.key, "state": one.state},
            **{"next": one.outlook, "reasons": one.reasons, "waits_for": one.waits_for, "log": one.log},
        }
        for one in found
    ]


def _reasons(one: StageStatus) -> list[str]:
    waits = [f"{', '.join(one.waits_for)} not up to date"] if one.waits_for else []
    return [*one.reasons, *waits]


def _mark(state: State) -> Text:
    mark, style = MARKS[state]
    return Text(mark, style=style)


def _states(found: Iterable[StageStatus]) -> str:
    """Count stages by state, and sources that are not as their .dvc files say."""
    stages, sources = Counter[State](), Counter[State]()
    for one in found:
        (sources if _is_source(one) else stages)[one.state] += 1
    states = [state for state in State if stages[state]]
    texts = [f"{stages[state]} {state}" for state in states]
    if states:
        texts[0] = f"{plural(stages[states[0]], 'stage')} {states[0]}"
    changed = [state for state in State if sources[state] and state is not State.FRESH]
    return ", ".join([*(texts or ["no stages"]), *(f"{plural(sources[s], 'source')} {s}" for s in changed)])


def _is_source(one: StageStatus) -> bool:
    """Return whether it is a .dvc file, such as that of an added mesh, which no command makes."""
    return one.address.endswith(".dvc")
