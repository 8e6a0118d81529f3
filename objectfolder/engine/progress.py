"""Progress of a build: live on a terminal that redraws, else a line per event; of one elsewhere; summary."""

import statistics
import time
from datetime import timedelta
from types import TracebackType
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import plural, shortened
from objectfolder.base.terminal import Terminal
from objectfolder.engine.journal import BuildState
from objectfolder.engine.summary import (
    Disturbed,
    Event,
    Finished,
    Lost,
    Planned,
    StageOutcome,
    StageResult,
    Started,
    Stopping,
    Summary,
    Tally,
)

MAX_ROWS = 60  # of the summary table; with more results, one row per stage and outcome
STYLES = {
    StageOutcome.RAN: "green",
    StageOutcome.RESTORED: "cyan",
    StageOutcome.SKIPPED: "dim",
    StageOutcome.FAILED: "bold red",
    StageOutcome.BLOCKED: "yellow",
}
#: Outcomes after which a stage is up to date.
UP_TO_DATE = (StageOutcome.RAN, StageOutcome.RESTORED, StageOutcome.SKIPPED)


class Progress(Tally):
    """Progress display: a listener of `objectfolder.engine.build.build` and a context manager.

    Parameters
    ----------
    console : Console, optional
        Output; default: standard error.
    task : str
        What happens before the stages are known.
    """

    def __init__(self, console: Console | None = None, task: str = "reading the pipeline"):
        super().__init__()
        self.task = task
        self.console = console or Terminal(stderr=True)
        self._live = (
            Live(get_renderable=self._render, console=self.console, refresh_per_second=4, transient=True)
            if self.console.is_terminal and not self.console.is_dumb_terminal  # which cannot redraw lines
            else None
        )

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        if kind is KeyboardInterrupt:
            self._line(self._interruption(), "yellow")

    def __call__(self, event: Event) -> None:
        """Show one event of the build."""
        self.add(event)
        match event:
            case Planned():
                self._line(plural(self.total, "stage"))
            case Started(address):
                if self._live is None:
                    self._line(f"started  {address}")
            case Lost(address, reason):
                self._line(f"lost     {address} {reason}; it will run again", "yellow")
            case Disturbed(address, files):
                text = f"again    {address} {', '.join(files)} changed while it ran; nothing was saved"
                self._line(text, "yellow")
            case Stopping():
                self._line("stopping: running stages are killed, finished ones are kept", "yellow")
            case Finished(result):
                # Skipped stages are only counted: there may be thousands.
                if result.status is not StageOutcome.SKIPPED:
                    self._line(self._describe(result), STYLES[result.status])

    def _times(self) -> str:
        return _describe_times(self.elapsed, self.seconds_left())

    def _interruption(self) -> str:
        if not self.total:
            return "interrupted"
        kept = sum(self.counts[status] for status in UP_TO_DATE)
        stages = f"{kept} of {plural(self.total, 'stage')} {'is' if self.total == 1 else 'are'} up to date"
        return f"interrupted: {stages}; `objectfolder build` continues"

    def _describe(self, result: StageResult) -> str:
        place = f"[{self.done}/{self.total}]"
        seconds = f"{result.seconds:.1f} s" if result.seconds else ""
        peak = "" if result.peak_mb is None else f"{result.peak_mb:.0f} MB"
        detail = result.error or f"{seconds} {peak}".strip()
        line = f"{result.status:<8} {result.address} {place} {detail}".rstrip()
        return (
            f"{line}; {self._times()}" if result.status is StageOutcome.RAN and self._live is None else line
        )

    def _line(self, text: str, style: str = "") -> None:
        self.console.print(Text(text, style=style), soft_wrap=True)

    def _render(self) -> Group:
        now = time.monotonic()
        # Copied in one step, because this runs in the display thread.
        if not self.total:
            return Group(Text(f"{self.task} ...  {_duration(self.elapsed)}"))
        lines = [f"  {address}  {now - start:.0f} s" for address, start in self.running.copy().items()]
        running = [Text(line, style="bold", no_wrap=True, overflow="ellipsis") for line in lines]
        counts = "  ".join(f"{count} {status}" for status, count in self.counts.copy().items() if count)
        bar = Table.grid(padding=(0, 1))
        for _ in range(3):
            bar.add_column(no_wrap=True)
        bar.add_row(
            ProgressBar(total=self.total, completed=self.done, width=20),
            f"{self.done}/{self.total}",
            self._times(),
        )
        return Group(*running, bar, Text(f"  {counts}", no_wrap=True, overflow="ellipsis"))


def print_build(build: BuildState, console: Console) -> None:
    """Print what a build in another process does, and how far it is; outside a terminal, in whole lines."""
    whole = not console.is_terminal
    times = _describe_times(build.elapsed, build.left)
    console.print(Text(f"a build runs (process {build.pid} on {build.host}): {times}"), soft_wrap=whole)
    for address, seconds in build.running.items():
        line = Text(f"  {_duration(seconds)}  {address}", style="bold")
        console.print(line, soft_wrap=whole, no_wrap=True, overflow="ignore" if whole else "ellipsis")
    for address, error in build.failed.items():
        text = Text(f"  failed  {address}: {error}", style=STYLES[StageOutcome.FAILED])
        console.print(text, soft_wrap=whole)
    console.print(Text(_counted(build)), soft_wrap=whole)


def print_death(build: BuildState, console: Console) -> None:
    """Print how far the last build was when it died."""
    running = f" with {shortened(', '.join(build.running), 300)} running" if build.running else ""
    died = (
        f"the last build (process {build.pid} on {build.host}) died after {_duration(build.elapsed)}{running}"
    )
    text = Text(f"{died}; {_counted(build)}; `objectfolder build` continues", style="yellow")
    console.print(text, soft_wrap=True)


def print_summary(summary: Summary, console: Console | None = None) -> None:
    """Print the stages that ran or were restored, the failures with the end of their logs, and the totals."""
    console = console or Terminal()
    shown = [
        result
        for result in summary.stages.values()
        if result.status in (StageOutcome.RAN, StageOutcome.RESTORED)
    ]
    if shown:
        console.print(_table(shown) if len(shown) <= MAX_ROWS else _totals(shown))
    for result in summary.failures[:MAX_ROWS]:
        console.print(_failure(result), soft_wrap=True)
    if len(summary.failures) > MAX_ROWS:
        console.print(
            f"... and {len(summary.failures) - MAX_ROWS} more failed; `objectfolder status` lists them"
        )
    counts = ", ".join(f"{count} {status}" for status, count in summary.counts().items() if count)
    console.print(f"{counts or 'nothing to do'} in {summary.seconds:.1f} s", soft_wrap=True, highlight=False)


def _table(results: list[StageResult]) -> Table:
    table = Table("stage", "object", "", box=None)
    table.add_column("wall s", justify="right")
    table.add_column("peak MB", justify="right")
    for result in results:
        peak = "" if result.peak_mb is None else f"{result.peak_mb:.0f}"
        status = Text(result.status, style=STYLES[result.status])
        table.add_row(result.stage, result.key, status, f"{result.seconds:.1f}", peak)
    return table


def _totals(results: list[StageResult]) -> Table:
    table = Table("stage", "", box=None)
    for name in ("objects", "total s", "median s", "most s", "peak MB"):
        table.add_column(name, justify="right")
    groups: dict[tuple[str, StageOutcome], list[StageResult]] = {}
    for result in results:
        groups.setdefault((result.stage, result.status), []).append(result)
    for (stage, status), group in groups.items():
        seconds = [result.seconds for result in group]
        times = (f"{value:.1f}" for value in (sum(seconds), statistics.median(seconds), max(seconds)))
        peaks = [result.peak_mb for result in group if result.peak_mb is not None]
        peak = f"{max(peaks):.0f}" if peaks else ""
        table.add_row(stage, Text(status, style=STYLES[status]), str(len(group)), *times, peak)
    return table


def _failure(result: StageResult) -> Text:
    place = f"{result.stage} of {result.key}" if result.key else result.stage
    text = Text(f"{place} failed: {result.error}\n", style=STYLES[StageOutcome.FAILED])
    for line in result.tail:
        text.append(f"  | {line}\n", style="default")
    if result.log is not None:
        text.append(f"  log: {result.log}\n", style="default")
    return text


def _counted(build: BuildState) -> str:
    if not build.total:
        return "reading the pipeline"
    counts = ", ".join(f"{count} {status}" for status, count in build.counts.items())
    done = f"{build.done} of {plural(build.total, 'stage')} done" + (f" ({counts})" if counts else "")
    return f"{done}, {len(build.running)} running, {build.total - build.done} left"


def _describe_times(elapsed: float, left: float | None) -> str:
    text = f"{_duration(elapsed)} elapsed"
    return f"{text}, about {_duration(left)} left" if left else text


def _duration(seconds: float) -> str:
    """Return a time as hours, minutes and seconds, such as ``0:08:51``."""
    return str(timedelta(seconds=round(seconds)))
