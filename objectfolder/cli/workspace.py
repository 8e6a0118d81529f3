"""Commands on a workspace: build, preset, inspect."""

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import NO_OBJECTS, console, print_line
from objectfolder.cli.files import Targets, bounded

MAX_SCORES = 40  # objects whose scores a build prints


class Engine(StrEnum):
    """Execution backend of a build."""

    LOCAL = "local"
    RAY = "ray"


def build(
    targets: Targets = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            **bounded(1),
            help="Number of cores to use, at least 1; default: all, with --engine ray those of the cluster.",
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", "-f", help="Also rerun stages that are up to date.")
    ] = False,
    keep_going: Annotated[
        bool,
        typer.Option(
            "--keep-going/--fail-fast", help="After a failure, continue with stages that do not depend on it."
        ),
    ] = True,
    timeout: Annotated[
        float | None,
        typer.Option(
            **bounded(0, kind=float, metavar="SECONDS"),
            help="Time limit of each stage; 0: none; default: hours, depending on the stage.",
        ),
    ] = None,
    engine: Annotated[
        Engine,
        typer.Option(metavar="local|ray", help="Where to run stages: on this machine or on a Ray cluster."),
    ] = Engine.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Head node of the Ray cluster; default: the cluster that this machine belongs to.",
        ),
    ] = None,
    pull: Annotated[
        bool, typer.Option("--pull", help="First pull available outputs from the default DVC remote.")
    ] = False,
    wait: Annotated[
        bool,
        typer.Option("--wait", help="If another process uses the workspace, wait instead of failing."),
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Show which stages would run or be restored, and why, without changing anything. Of the "
            "other options, only --wait has an effect; --force and --pull are refused.",
        ),
    ] = False,
) -> None:
    """Build the objects of the workspace: run outdated stages in parallel, with DVC's graph and cache.

    Examples: `objectfolder build -j 2`, `objectfolder build mug`, `objectfolder build modal@mug`,
    `objectfolder build --engine ray` (docs/pipeline.md says what a cluster needs).

    The stage `observe` runs only for tasks listed in `benchmarks` of params.yaml, or if a target names it.
    Logs of stages are in build/.logs. `dvc status`, `dvc repro` and `dvc metrics show` work as usual.
    """
    from objectfolder.base.io import check_output
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.unchanged import recall

    if address is not None and engine is Engine.LOCAL:
        raise ObjectFolderError(f"--address {address} requires --engine ray")
    summary = None
    if engine is Engine.LOCAL and timeout is None and not (force or pull or dry_run):
        with Progress() as progress:
            summary = recall(targets or (), on_event=progress)
    if summary is None:
        if Path("params.yaml").is_file() and not dry_run:
            check_output(Path("build/.writable"))  # this changes the folder, so before it is looked at
        from objectfolder.engine.build import BuildOptions, local_workers
        from objectfolder.engine.build import build as run_build
        from objectfolder.engine.ray import ray_workers

        start = time.time_ns()
        _check_params()
        if dry_run:
            from objectfolder.cli.statusview import print_outlook
            from objectfolder.engine.status import status

            if force or pull:
                raise ObjectFolderError("--dry-run cannot be combined with --force or --pull")
            print_outlook(status(targets or (), wait=wait), console)
            return
        with Progress() as progress:
            summary = run_build(
                targets or (),
                BuildOptions(jobs, force, keep_going, timeout, pull, wait, remember=start),
                on_event=progress,
                make_workers=ray_workers(address or "auto") if engine is Engine.RAY else local_workers,
            )
    print_summary(summary)
    evaluated = sorted(a.partition("@")[2] for a in summary.stages if a.startswith("evaluate@"))
    if summary.ok and 0 < len(evaluated) <= MAX_SCORES:
        _print_metrics(evaluated)
    elif summary.ok and not targets and not any("@" in address for address in summary.stages):
        console.print(NO_OBJECTS, highlight=False, soft_wrap=True)
    elif summary.ok and evaluated:
        console.print(f"{plural(len(evaluated), 'object')} evaluated; `dvc metrics show` prints their scores")
    raise typer.Exit(not summary.ok)


def _check_params() -> None:
    from objectfolder.touch.profiles import load_profile, require_renderer
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_all
    from objectfolder.workspace.installed import check_installed, sensor_file

    values = params.read()
    check_installed()  # a file of another version may lack what this one checks
    check_all(values)
    require_renderer(load_profile(sensor_file(values["sensor"])), values["render_touch"]["renderer"])


def preset(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="quick, laptop, standard, faithful, faithful-small, or your own (params/NAME.yaml).",
        ),
    ],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the changes without making them.")] = False,
) -> None:
    """Set params.yaml to a preset: numbers of views, FEM resolution, training length and more.

    `quick` is the defaults; params/NAME.yaml holds what differs from them. Objects, seed and selected
    benchmarks are kept. Each changed setting is printed.

    A build then takes, per object: `quick` and `laptop` about 130 s of CPU time and 24 MB; `standard` more;
    `faithful` a GPU, with 150 times as many samples of views as `quick`; `faithful-small` a night on two
    cores.
    """
    from objectfolder.workspace.presets import apply_preset

    changed = apply_preset(name, dry_run=dry_run)
    for line in changed:
        print_line(line)
    count = plural(len(changed), "setting") if changed else "nothing"
    done = f"would change {count}" if dry_run else f"changed {count}; next: objectfolder build"
    console.print(f"preset {name}: {done}")


def inspect(
    target: Annotated[str, typer.Argument(metavar="STAGE@OBJECT", help="Such as `modal@mug`.")],
    vtu: Annotated[bool, typer.Option(help="Also export the solid for ParaView; voxelize only.")] = False,
) -> None:
    """Summarize the artifacts of a stage in a table, and save a picture beside them."""
    from objectfolder.report.inspect_stage import STAGES, inspect_stage
    from objectfolder.report.inspection import print_inspection
    from objectfolder.workspace.params import PARAMS_FILE, outside_workspace

    if not Path(PARAMS_FILE).is_file():
        raise outside_workspace(Path(PARAMS_FILE))
    stage, at, key = target.partition("@")
    if not at:
        raise ObjectFolderError(
            f"{target!r} is not STAGE@OBJECT, such as modal@mug; the stages are {', '.join(STAGES)}"
        )
    print_inspection(inspect_stage(stage, key, vtu=vtu), console)


def _print_metrics(keys: list[str]) -> None:
    """Print the metrics of objects, what is uncertain, and the paths of Object Files and pictures."""
    from objectfolder.base.io import read_json
    from objectfolder.objectfile.evaluation import summary_row
    from objectfolder.sound.fem.certainty import uncertainty_warning
    from objectfolder.workspace.layout import Build

    rows = [summary_row(key, read_json(Build(key).metrics)) for key in keys]
    title = "Held-out PSNR in dB / PSNR of a trivial baseline"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, padding=0)
    for name in rows[0]:
        # In a narrow terminal names take more lines; scores stay whole.
        scores = name != "object"
        header = name.replace(" / ", "/").replace("/", "/\n").replace(" ", "\n")
        table.add_column(header, justify="right" if scores else "left", overflow="fold", no_wrap=scores)
    for row in rows:
        table.add_row(*(cell.replace(" / ", "/") for cell in row.values()))
    console.print(table)
    for key in keys:
        b = Build(key)
        report = read_json(b.modal)
        if warning := uncertainty_warning(report, key):
            if not report.get("uncertain"):  # whose warning says it
                warning += "; thicken them, or raise modal.fine.max_degrees_of_freedom in params.yaml"
            console.print(f"warning: {warning}", style="yellow", soft_wrap=True, highlight=False)
        sheets = (b.views_sheet, b.touch_sheet, b.vision_sheet, b.sound_sheet)
        print_line(f"{b.object_file}  pictures: {' '.join(map(str, sheets))}")
