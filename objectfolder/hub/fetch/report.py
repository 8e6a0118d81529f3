"""Print a catalogue, licences, download progress and results."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from rich.text import Text

from objectfolder.base.download import ProgressCallback, ProgressFactory
from objectfolder.base.errors import plural
from objectfolder.hub.fetch.catalogue import Catalogue
from objectfolder.hub.fetch.run import FetchResult, FetchStatus

STYLES = {FetchStatus.ADDED: "green", FetchStatus.PRESENT: "dim", FetchStatus.FAILED: "bold red"}


def print_catalogue(catalogue: Catalogue, present: Collection[str], console: Console) -> None:
    """Print one line per object, with a mark if it is in the workspace."""
    width = max(map(len, catalogue.objects))
    longest = max(len(entry.category) for entry in catalogue.objects.values())
    for key, entry in catalogue.objects.items():
        name = f"{'✓' if key in present else ' '} {key:{width}}"
        category = f"{entry.category:{longest}}  " if longest else ""
        line = f"{name}  {entry.material:13}  {entry.scale:6.4g} m  {category}{entry.name}"
        console.print(line, soft_wrap=True, highlight=False)
    print_overview(catalogue, present, console)


def print_overview(catalogue: Catalogue, present: Collection[str], console: Console) -> None:
    """Print the number of objects, by source."""
    counts = Counter(entry.source for entry in catalogue.objects.values())
    there = sum(key in present for key in catalogue.objects)
    sources = ", ".join(f"{counts[name]} {name}" for name in catalogue.sources)
    count = plural(len(catalogue.objects), "object")
    console.print(f"{count} ({sources}), {there} in this workspace", soft_wrap=True)


def print_licences(catalogue: Catalogue, keys: Sequence[str], console: Console) -> None:
    """Print the licence of each source of the objects."""
    for name in dict.fromkeys(catalogue.objects[key].source for key in keys):
        source = catalogue.sources[name]
        text = f"{source.title}: {source.licence}. {source.attribution}."
        console.print(text, soft_wrap=True, highlight=False)


def print_result(result: FetchResult, console: Console) -> None:
    """Print one result."""
    status = f"{result.status:<7}", STYLES[result.status]
    console.print(Text.assemble(status, f" {result.key}: {result.detail}"), soft_wrap=True)


def print_totals(results: Sequence[FetchResult], console: Console) -> None:
    """Print the number of objects by status, and the next step."""
    counts = Counter(result.status for result in results)
    text = ", ".join(f"{counts[status]} {status}" for status in FetchStatus if counts[status])
    failed = [result.key for result in results if result.status is FetchStatus.FAILED]
    if failed:
        text += f" ({', '.join(failed)})"
    if counts[FetchStatus.ADDED]:
        text += "; next: objectfolder build"
    console.print(text or "nothing to do", soft_wrap=True, highlight=False)


@contextmanager
def download_progress(console: Console) -> Iterator[ProgressFactory]:
    """Show a bar for each download, on a terminal only; yields the ``progress`` argument of `fetch_all`."""
    name = TextColumn("{task.description}", markup=False)
    columns = (name, BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:

        def progress(name: str) -> ProgressCallback:
            task = bars.add_task(name, total=None)

            def report(done: int, total: int | None) -> None:
                bars.update(task, completed=done, total=total, visible=done != total)

            return report

        yield progress
