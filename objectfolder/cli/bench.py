"""Commands that run the benchmark tasks on Object Files, without a build: bench.

Each command and its options follow from the declaration of its task (`objectfolder.benchmarks.tasks.task`).
"""

from collections.abc import Callable, Iterator
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.main import get_group

from objectfolder.cli.console import App, Group, print_line, print_wide, track_progress
from objectfolder.cli.files import FORMS, object_files

if TYPE_CHECKING:
    from objectfolder.benchmarks.reporting.tables import Table
    from objectfolder.benchmarks.tasks.task import Task, Variant


class _Tasks(Group):
    """Commands of tasks, whose declarations are read when they are asked for: other commands need none."""

    _commands: Any

    @property
    def commands(self) -> Any:
        """Commands by name."""
        if not self._commands:
            app = App()
            add_commands(app)
            self._commands = get_group(app).commands
        return self._commands

    @commands.setter
    def commands(self, given: Any) -> None:
        self._commands = given


bench_app = App(
    cls=_Tasks,
    help="Run the paper's benchmark tasks and robot tasks on Object Files.\n\n"
    "Random views, impacts and touches of each Object File are sampled first and kept in OUT/observations, "
    "grasps in OUT/grasps, close views in OUT/close_ups; later tasks reuse them. Interrupted "
    "commands resume when repeated, and more --seeds train only the missing ones.",
)

FILES = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[FILE]...",
        help=f"Object Files, each a {FORMS}; default: build.",
        callback=object_files,
    ),
]
PRESET = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="quick, laptop, standard, faithful or faithful-small: samples and training (params/NAME.yaml). "
        "Default: the settings in params.yaml. With it and files, no workspace is needed.",
    ),
]
OUT = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder of results; default: benchmarks/PRESET, or benchmarks/own without --preset.",
    ),
]
SPLIT = Annotated[
    list[str] | None,
    typer.Option(
        "--split",
        metavar="seen|unseen",
        help="seen: test on new observations of the training objects; unseen: test on new objects. Repeat "
        "for both; default: all splits of the task that these objects allow.",
    ),
]
SEEDS = Annotated[int | None, typer.Option(min=1, help="Training runs to average; default: the preset's.")]
ENCODER = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.py:NAME",
        help="Encoder of views, spectrograms and touches: resnet18, resnet18_half, resnet18_quarter, or one "
        "registered by FILE.py (docs/benchmarks.md).",
    ),
]
WEIGHTS = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.pth",
        help="Initial weights, such as torchvision's ImageNet weights of resnet18; default: random.",
    ),
]
THREADS = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="CPU threads; default: all cores, shared by the splits or objects that run in parallel. "
        "Results are reproducible for a given number; finished ones are kept when it changes.",
    ),
]
DEVICE = Annotated[
    str | None,
    typer.Option(metavar="DEVICE", help="Device to train on: cpu, cuda ...; default: a GPU if there is one."),
]
JOBS = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Objects in parallel, which share the threads; default: one, or the number of cores for tasks "
        "that use one thread.",
    ),
]


def add_commands(app: typer.Typer) -> None:
    """Add the command of each task, also by its former names."""
    from objectfolder.benchmarks.tasks.task import find_task
    from objectfolder.workspace.stages import BENCHMARKS

    for task in map(find_task, BENCHMARKS):
        for name in (task.name.replace("_", "-"), *task.former):
            app.command(name, help=task.help, hidden=name in task.former)(make_command(task))


def make_command(task: "Task") -> Callable[..., None]:
    """Return the function of a task's command, with the parameters that concern the task."""

    def command(**given: Any) -> None:
        chosen = task
        if task.variant is not None and given.pop(task.variant.option) == task.variant.values[1]:
            chosen = task.variant.task
        run_task(chosen, given)

    parameters = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=hint) for name, hint in options(task)
    ]
    if task.variant is not None:
        parameters.append(_variant_parameter(task.variant))
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return command


def options(task: "Task") -> Iterator[tuple[str, Any]]:
    """Yield the options that concern a task: fields of `objectfolder.benchmarks.run.BenchmarkOptions`."""
    yield from (("files", FILES), ("preset", PRESET), ("out", OUT), ("seeds", SEEDS))
    if task.splits:
        yield "splits", SPLIT
    else:
        yield "jobs", JOBS
    if task.encodes:
        yield from (("encoder", ENCODER), ("weights", WEIGHTS))
    if not task.single_threaded:
        yield "threads", THREADS
    if task.trains_nets:
        yield "device", DEVICE


def _variant_parameter(variant: "Variant") -> Parameter:
    default = variant.values[0]
    kind: Any = bool if isinstance(default, bool) else Literal[variant.values]
    hint = Annotated[kind, typer.Option(f"--{variant.option}", help=variant.help)]
    return Parameter(variant.option, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def run_task(task: "Task", given: dict[str, Any]) -> None:
    """Run a task, and print its tables and where its results are."""
    from objectfolder.benchmarks import run  # imports torch

    options = run.BenchmarkOptions(**given)
    scores = run.run_task(task, options, print_line, track_progress)
    paths = [_describe_files(task.name, part, options.folder) for part in scores]
    for table in task.tables(scores):
        print_scores(table)
        if task.splits:
            print_line(paths.pop(0))
    for path in paths:
        print_line(path)


def _describe_files(task: str, part: str, folder: Any) -> str:
    film = folder.film(task, part)
    shown = f"  film: {film}" if film.is_file() else ""
    return f"{folder.result(task, part)}  curves: {folder.curve(task, part)}{shown}"


def print_scores(table: "Table") -> None:
    """Print a table of scores and its note."""
    from rich.table import Table as Grid

    grid = Grid(title=table.title)
    for i, column in enumerate(table.columns):
        grid.add_column(column, justify="right" if i else "left")
    for row in table.rows:
        grid.add_row(*row)
    print_wide(grid)
    print_line(table.note)
