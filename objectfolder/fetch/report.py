"""Show a catalogue, the licences of what is fetched, progress and results."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from objectfolder.fetch.catalogue import Catalogue
from objectfolder.fetch.download import Report, Reporter
from objectfolder.fetch.run import Outcome, Status

STYLES = {Status.ADDED: "green", Status.PRESENT: "dim", Status.FAILED: "bold red"}


def print_catalogue(catalogue: Catalogue, present: Collection[str], console: Console) -> None:
    """Print one line for each object; those in the workspace are marked."""
    width = max(map(len, catalogue.objects))
    for key, entry in catalogue.objects.items():
        mark = "✓" if key in present else " "
        line = f"{mark} {key:{width}}  {entry.material:13}  {entry.scale:6.4g} m  {entry.name}"
        console.print(escape(line), soft_wrap=True, highlight=False)
    print_overview(catalogue, present, console)


def print_overview(catalogue: Catalogue, present: Collection[str], console: Console) -> None:
    """Print how many objects there are, and of which sources."""
    counts = Counter(entry.source for entry in catalogue.objects.values())
    there = sum(key in present for key in catalogue.objects)
    sources = ", ".join(f"{counts[name]} {name}" for name in catalogue.sources)
    console.print(f"{len(catalogue.objects)} objects ({sources}), {there} in this workspace", soft_wrap=True)


def print_licences(catalogue: Catalogue, keys: Sequence[str], console: Console) -> None:
    """Print the licence of each source that objects come from, once."""
    for name in dict.fromkeys(catalogue.objects[key].source for key in keys):
        source = catalogue.sources[name]
        text = f"{source.title}: {source.licence}. {source.attribution}."
        console.print(escape(text), soft_wrap=True, highlight=False)


def print_outcome(outcome: Outcome, console: Console) -> None:
    """Print one result."""
    style = STYLES[outcome.status]
    console.print(
        f"[{style}]{outcome.status:<7}[/] {outcome.key}: {escape(outcome.detail)}",
        soft_wrap=True,
        highlight=False,
    )


def print_totals(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print how many objects were added, were there, and failed, and what to do next."""
    counts = Counter(outcome.status for outcome in outcomes)
    text = ", ".join(f"{counts[status]} {status}" for status in Status if counts[status])
    failed = [outcome.key for outcome in outcomes if outcome.status is Status.FAILED]
    if failed:
        text += f" ({', '.join(failed)})"
    if counts[Status.ADDED]:
        text += "; next: objectfolder build"
    console.print(text or "nothing to do", soft_wrap=True, highlight=False)


@contextmanager
def download_progress(console: Console) -> Iterator[Reporter]:
    """Show a bar for each download, on a terminal only; gives what `fetch_all` takes as reporter."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:

        def reporter(name: str) -> Report:
            task = progress.add_task(escape(name), total=None)

            def report(done: int, total: int | None) -> None:
                progress.update(task, completed=done, total=total, visible=done != total)

            return report

        yield reporter
