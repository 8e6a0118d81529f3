"""Commands that run the benchmark tasks on Object Files, without the pipeline: bench."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from objectfolder.cli.console import print_line, print_wide, track_progress
from objectfolder.cli.files import SAMPLE, files_or_folders

if TYPE_CHECKING:
    from objectfolder.benchmarks.reporting.tables import Table
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.running import Task

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Run the paper's benchmark tasks on Object Files: `recognition`, `retrieval`, `reconstruction`,"
    " `localization`, `vision-to-touch`, and, with a robot, `stability`, `grasping`, `reach`.\n\n"
    "Random views, impacts and touches of each Object File are sampled first and kept in OUT/observations, "
    "grasps in OUT/grasps, close views in OUT/glances; later tasks reuse them. Interrupted "
    "commands resume when repeated, and more --seeds train only the missing ones.",
)


class Label(StrEnum):
    """What `recognition` recognizes."""

    object = "object"
    material = "material"


FilesArgument = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[FILE]...",
        help=f"Object Files, folders of builds, releases, or {SAMPLE}; default: build.",
        callback=files_or_folders,
    ),
]
PresetOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="quick, laptop, standard, faithful or faithful-small: samples and training (params/NAME.yaml). "
        "Default: the settings in params.yaml. With it and files, no workspace is needed.",
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of results; default: benchmarks/PRESET, or benchmarks/own without --preset.",
    ),
]
SplitOption = Annotated[
    list[str] | None,
    typer.Option(
        "--split",
        help="seen: test on new observations of the training objects; unseen: test on new objects. Repeat "
        "for both; default: all splits of the task that can be made of these objects.",
    ),
]
SeedsOption = Annotated[
    int | None, typer.Option(min=1, help="Training runs to average; default: the preset's.")
]
EncoderOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.py:NAME",
        help="Encoder of views, spectrograms and touches: resnet18, resnet18_half, resnet18_quarter, or one "
        "registered by FILE.py (docs/benchmarks.md).",
    ),
]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.pth",
        help="Initial weights, such as torchvision's ImageNet weights of resnet18; default: random.",
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Default: all cores, shared by the splits, which run in parallel. Results are reproducible for "
        "a given number; what was finished with another is kept.",
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option(help="Device to train on, such as cpu or cuda; default: a GPU if there is one.")
]


@bench_app.command()
def recognition(
    files: FilesArgument = None,
    label: Annotated[
        Label, typer.Option(help="What is recognized: the object, or its material, also of unseen objects.")
    ] = Label.object,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Recognize an object, or its material, from a view, an impact sound, a touch, or any combination.

    Accuracy on held-out observations with its 95 % interval over seeds, next to chance and published figures;
    also of several touches together. The figure OUT/recognize_seen.png
    (OUT/materials_SPLIT.png) shows what is taken for what.

    `objectfolder bench recognition --preset quick`

    `objectfolder bench recognition --preset laptop --label material --split unseen`
    """
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.recognition import MATERIALS, RECOGNIZE

    options = BenchmarkOptions(
        files=files,
        preset=preset,
        out=out,
        splits=split,
        seeds=seeds,
        encoder=encoder,
        weights=weights,
        threads=threads,
        device=device,
    )
    run_on_splits(MATERIALS if label is Label.material else RECOGNIZE, options)


@bench_app.command()
def retrieval(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Retrieve observations of the same object in another modality, such as sounds from views.

    Mean average precision for all six directions, next to CCA, chance and the paper's Table 3.

    `objectfolder bench retrieval --preset quick --split unseen`
    """
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.retrieval import RETRIEVE

    options = BenchmarkOptions(
        files=files,
        preset=preset,
        out=out,
        splits=split,
        seeds=seeds,
        encoder=encoder,
        weights=weights,
        threads=threads,
        device=device,
    )
    run_on_splits(RETRIEVE, options)


@bench_app.command()
def reconstruction(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    weights: WeightsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Reconstruct an object's shape from a view, an impact sound, both, or several touches.

    IoU, Chamfer-L1 and normal consistency, next to the average shape and the paper's Table 4. The model for
    views is kept: `objectfolder reconstruct PHOTO.jpg MESH.ply --model OUT/reconstruct_seen.safetensors`.

    `objectfolder bench reconstruction --preset quick --split seen`
    """
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.reconstruction import RECONSTRUCT

    options = BenchmarkOptions(
        files=files,
        preset=preset,
        out=out,
        splits=split,
        seeds=seeds,
        encoder=encoder,
        weights=weights,
        threads=threads,
        device=device,
    )
    run_on_splits(RECONSTRUCT, options)


@bench_app.command()
def localization(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    seeds: SeedsOption = None,
    encoder: EncoderOption = None,
    jobs: Annotated[int, typer.Option(min=1, help="Objects in parallel, which share the threads.")] = 1,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Default: all cores. Results are reproducible for a given number."),
    ] = None,
    device: DeviceOption = None,
) -> None:
    """Find where a known object was touched or struck: by one touch, one sound, both, or eight in a row.

    Mean errors in percent of the object's longest side, next to the most similar contact of the training, the
    best constant answer and a random one.

    `objectfolder bench localization --preset quick build/mug`
    """
    from objectfolder.benchmarks.reporting.tables import localization_table
    from objectfolder.benchmarks.run import BenchmarkOptions, run_on_contacts

    options = BenchmarkOptions(
        files=files, preset=preset, out=out, seeds=seeds, encoder=encoder, threads=threads, device=device
    )
    scores = run_on_contacts(options, print_line, jobs)
    print_scores(localization_table(scores))
    for key in scores:
        print_line(
            f"{options.folder.result('localize', key)}  curves: {options.folder.curve('localize', key)}"
        )


@bench_app.command("vision-to-touch")
def vision_to_touch(
    files: FilesArgument = None,
    preset: PresetOption = None,
    out: OutOption = None,
    split: SplitOption = None,
    seeds: SeedsOption = None,
    threads: ThreadsOption = None,
    device: DeviceOption = None,
) -> None:
    """Draw the tactile image of a contact from a close view of it.

    PSNR and SSIM on held-out contacts of the training objects or of new ones, next to the touch of the most
    similar view and to the mean touch. The figure OUT/vision_to_touch_SPLIT.png shows view, answer and truth.

    `objectfolder bench vision-to-touch --preset quick --split unseen`
    """
    from objectfolder.benchmarks.run import BenchmarkOptions
    from objectfolder.benchmarks.tasks.vision_to_touch import VISION_TO_TOUCH

    options = BenchmarkOptions(
        files=files, preset=preset, out=out, splits=split, seeds=seeds, threads=threads, device=device
    )
    run_on_splits(VISION_TO_TOUCH, options)


def run_on_splits(task: "Task", options: "BenchmarkOptions") -> None:
    """Run a task on its splits and print the tables."""
    from objectfolder.benchmarks import run
    from objectfolder.benchmarks.reporting.tables import score_table

    folder = options.folder
    for split, scores in run.run_on_splits(task, options, print_line, track_progress).items():
        print_scores(score_table(task.name, split, scores))
        print_line(f"{folder.result(task.name, split)}  curves: {folder.curve(task.name, split)}")


def print_scores(table: "Table") -> None:
    """Print a table of scores and its note."""
    from rich.table import Table

    grid = Table(title=table.title)
    for i, column in enumerate(table.columns):
        grid.add_column(column, justify="right" if i else "left")
    for row in table.rows:
        grid.add_row(*row)
    print_wide(grid)
    print_line(table.note)
