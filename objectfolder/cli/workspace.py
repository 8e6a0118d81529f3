"""Commands on a workspace: build, preset, inspect."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from objectfolder.cli.console import console
from objectfolder.errors import ObjectFolderError

MAX_SCORES = 40  # of objects that a build prints


class Engine(StrEnum):
    """Where a build runs its stages."""

    LOCAL = "local"
    RAY = "ray"


def build(
    targets: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TARGET]...", help="`modal@mug`, `train_audio` or `mug`; default: all."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", "-j", min=1, help="Cores to use; default: all (--engine ray: of the cluster)."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", "-f", help="Run even what is up to date.")] = False,
    keep_going: Annotated[
        bool,
        typer.Option("--keep-going/--fail-fast", help="After a failure, go on with what does not need it."),
    ] = True,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0, help="Seconds after which a stage is killed; 0: never. Default: hours, by stage."
        ),
    ] = None,
    engine: Annotated[
        Engine, typer.Option(help="Run stages on this machine, or on the nodes of a Ray cluster.")
    ] = Engine.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Head of the Ray cluster; default: auto, the one this machine is in."
        ),
    ] = None,
    pull: Annotated[
        bool, typer.Option("--pull", help="First fetch what is built from DVC's default remote.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="If another process uses the workspace, wait; else refuse.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would run or come back, and why; change nothing.")
    ] = False,
) -> None:
    """Build what is out of date, in parallel, through DVC's graph and cache.

    Examples: `objectfolder build -j 2`, `objectfolder build mug`, `objectfolder build modal@mug`,
    `objectfolder build --engine ray` (docs/pipeline.md: what a cluster must share).
    Logs of stages are in build/.logs. `dvc status`, `dvc repro` and `dvc metrics show` work as usual.
    """
    from objectfolder.engine.build import BuildOptions, local_workers
    from objectfolder.engine.build import build as run_build
    from objectfolder.engine.progress import Progress, print_summary
    from objectfolder.engine.ray import ray_workers
    from objectfolder.io import check_writable
    from objectfolder.touch.profiles import load_profile, require_renderer
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_all

    if address is not None and engine is Engine.LOCAL:
        raise ObjectFolderError(f"--address {address} is for --engine ray; give both")
    values = params.read()
    check_all(values)
    require_renderer(load_profile(values["sensor"]), values["render_touch"]["renderer"])
    if dry_run:
        from objectfolder.cli.statusview import print_outlook
        from objectfolder.engine.status import status

        if force or pull:
            raise ObjectFolderError("--dry-run tells from what is here; --force and --pull are for a build")
        print_outlook(status(targets or ()), console)
        return
    check_writable(Path("build"))
    with Progress() as progress:
        summary = run_build(
            targets or (),
            BuildOptions(jobs, force, keep_going, timeout, pull, wait),
            on_event=progress,
            make_workers=ray_workers(address or "auto") if engine is Engine.RAY else local_workers,
        )
    print_summary(summary)
    evaluated = sorted(a.partition("@")[2] for a in summary.stages if a.startswith("evaluate@"))
    if summary.ok and 0 < len(evaluated) <= MAX_SCORES:
        _print_metrics(evaluated)
    elif summary.ok and evaluated:
        console.print(f"{len(evaluated)} objects are evaluated; `dvc metrics show` prints their scores")
    raise typer.Exit(not summary.ok)


def preset(name: Annotated[str, typer.Argument(help="quick, standard or paper (files in params/).")]) -> None:
    """Merge a preset into params.yaml: how many views, how fine the FEM, how long to train."""
    from objectfolder.workspace.presets import apply_preset

    changed = apply_preset(name)
    console.print(f"preset {name}: changed {', '.join(changed) or 'nothing'}; next: objectfolder build")


def inspect(
    target: Annotated[str, typer.Argument(metavar="STAGE@OBJECT", help="Such as `modal@mug`.")],
    vtu: Annotated[bool, typer.Option(help="Export the solid for ParaView (voxelize).")] = False,
) -> None:
    """Show what a stage's artifacts hold: a table, and a picture beside them."""
    from objectfolder.inspection import inspect_stage, print_inspection

    stage, at, key = target.partition("@")
    if not at:
        raise ObjectFolderError(f"{target!r} is not STAGE@OBJECT, such as modal@mug")
    print_inspection(inspect_stage(stage, key, vtu=vtu), console)


def _print_metrics(keys: list[str]) -> None:
    """Print the metrics table, and where to look."""
    from objectfolder.io import read_json
    from objectfolder.objectfile.evaluation import summary_row
    from objectfolder.workspace.layout import Build

    rows = [summary_row(key, read_json(Build(key).metrics)) for key in keys]
    table = Table(title="Held-out PSNR in dB / that of a baseline that knows nothing")
    for name in rows[0]:
        table.add_column(name, justify="left" if name == "object" else "right", no_wrap=name == "object")
    for row in rows:
        table.add_row(*row.values())
    console.print(table)
    for key in keys:
        b = Build(key)
        sheets = (b.views_sheet, b.touch_sheet, b.vision_sheet, b.sound_sheet)
        console.print(f"{b.object_file}  pictures: {' '.join(map(str, sheets))}", soft_wrap=True)
