"""Commands on a workspace: build, preset, inspect."""

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.cli.console import console, print_line
from objectfolder.cli.files import Targets

MAX_SCORES = 40  # objects whose scores a build prints
#: Presets, and what an object then costs (docs/pipeline.md, docs/faithful.md).
COSTS = {
    "quick": "about two minutes of CPU time per object",
    "laptop": "as long as with quick (only its benchmarks differ)",
    "standard": "tens of minutes per object on one core",
    "faithful": "months of CPU time per object, less on a GPU",
    "faithful-small": "5 to 10 CPU hours per object",
}


class Engine(StrEnum):
    """Execution backend of a build."""

    LOCAL = "local"
    RAY = "ray"


def build(
    targets: Targets = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", "-j", min=1, help="Cores to use; default: all (--engine ray: of the cluster)."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Rerun stages that are up to date.")] = False,
    keep_going: Annotated[
        bool,
        typer.Option(
            "--keep-going/--fail-fast",
            help="After a failure, continue with the stages that do not need what failed, or stop.",
        ),
    ] = True,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0, metavar="SECONDS", help="Time limit of each stage; 0: none; default: hours, by stage."
        ),
    ] = None,
    engine: Annotated[
        Engine, typer.Option(help="Run stages on this machine or on a Ray cluster.")
    ] = Engine.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Head node of the Ray cluster; default: auto, the cluster of this machine.",
        ),
    ] = None,
    pull: Annotated[
        bool, typer.Option("--pull", help="First fetch from the default DVC remote what it has.")
    ] = False,
    wait: Annotated[
        bool,
        typer.Option("--wait", help="Wait while another process uses the workspace, instead of failing."),
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Show which stages would run or be restored, and why; change nothing. Of the other options, "
            "only --wait has an effect; --force and --pull are refused.",
        ),
    ] = False,
) -> None:
    """Build what is out of date: all objects, or the targets. Results are cached by DVC.

    Examples: `objectfolder build -j 2`, `objectfolder build mug`, `objectfolder build modal@mug`,
    `objectfolder build --engine ray` (requirements of a cluster: docs/pipeline.md).

    The stage `observe` runs only for tasks that `benchmarks` in params.yaml lists, or if a target names it.
    Stage logs are in build/.logs. `dvc status`, `dvc repro` and `dvc metrics show` work as usual.
    """
    from objectfolder.base.io import check_output
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.summary import NO_OBJECTS
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
    if not targets and not any(result.key for result in summary.stages.values()):
        console.print(NO_OBJECTS, soft_wrap=True, highlight=False)
    evaluated = sorted(a.partition("@")[2] for a in summary.stages if a.startswith("evaluate@"))
    if summary.ok and 0 < len(evaluated) <= MAX_SCORES:
        _print_metrics(evaluated)
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
            metavar="NAME", help="; ".join(f"{name}: {cost}" for name, cost in COSTS.items()) + "."
        ),
    ],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the changes; change nothing.")] = False,
) -> None:
    """Set params.yaml to a preset: number of views, grid sizes, training length and more.

    quick is the defaults; params/NAME.yaml holds what differs from them, and may be your own. Objects, seed
    and selected benchmarks are kept. Each setting that changes is printed.
    """
    from objectfolder.workspace.presets import apply_preset

    changed = apply_preset(name, dry_run=dry_run)
    for line in changed:
        print_line(line)
    count = plural(len(changed), "setting") if changed else "nothing"
    done = f"would change {count}" if dry_run else f"changed {count}; next: objectfolder build"
    console.print(f"preset {name}: {done}")
    if name in COSTS:
        console.print(f"a build then takes {COSTS[name]}", highlight=False, soft_wrap=True)


def inspect(
    target: Annotated[
        str, typer.Argument(metavar="STAGE@OBJECT", help="Stage and object, such as `modal@mug`.")
    ],
    vtu: Annotated[bool, typer.Option(help="Also export the solid for ParaView (voxelize only).")] = False,
) -> None:
    """Summarize what a stage wrote in a table, and save a picture beside it."""
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
    title = "Held-out PSNR in dB / that of a white image, silence or the mean touch"
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
        if warning := uncertainty_warning(report := read_json(b.modal), key):
            if not report.get("uncertain"):  # else it says so itself
                warning += "; thicken them, or raise modal.fine.max_degrees_of_freedom in params.yaml"
            console.print(f"warning: {warning}", style="yellow", soft_wrap=True, highlight=False)
        sheets = (b.views_sheet, b.touch_sheet, b.vision_sheet, b.sound_sheet)
        print_line(f"{b.object_file}  pictures: {' '.join(map(str, sheets))}")
