"""Commands that write observations in the formats of other libraries: export."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from objectfolder.cli.console import console
from objectfolder.errors import ObjectFolderError

if TYPE_CHECKING:
    from objectfolder.benchmarks.export import Report
    from objectfolder.benchmarks.observations import Observations
    from objectfolder.benchmarks.splits import Split

export_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Write observations as a `webdataset` or for Hugging Face `datasets`.",
)

OutArgument = Annotated[Path, typer.Argument(metavar="OUT", help="Folder to make.")]
FoldersArgument = Annotated[
    list[Path], typer.Argument(metavar="FOLDER...", help="Folders of observations, or what holds them.")
]
SplitOption = Annotated[
    str,
    typer.Option(help="seen: every object in all splits; unseen: objects of the test in no other split."),
]


@export_app.command()
def webdataset(
    out: OutArgument,
    folders: FoldersArgument,
    split: SplitOption = "seen",
    shard: Annotated[int, typer.Option(min=1, help="Samples of a tar file.")] = 1000,
) -> None:
    """Write tar files for the WebDataset library: train-000000.tar ... val- ... test-...

    A sample has vision.png, audio.wav (float, absolute scale), touch.png and json: label, key, material,
    scale and what was asked. index.json names the labels. Then, in Python:

    `webdataset.WebDataset("OUT/train-{000000..000003}.tar").decode("rgb")`
    """
    from objectfolder.benchmarks.export import write_webdataset

    def write(observations: "Observations", chosen: "Split", report: "Report") -> None:
        write_webdataset(observations, chosen, out, shard, report)

    _export(out, folders, split, write, "webdataset")


@export_app.command()
def datasets(out: OutArgument, folders: FoldersArgument, split: SplitOption = "seen") -> None:
    """Write a folder for the Datasets library of Hugging Face: Parquet files and a card, README.md.

    Then, in Python, without a network: `datasets.load_dataset("OUT")`
    """
    from objectfolder.benchmarks.export import write_datasets

    def write(observations: "Observations", chosen: "Split", report: "Report") -> None:
        write_datasets(observations, chosen, out, report)

    _export(out, folders, split, write, "datasets")


def _export(
    out: Path,
    folders: list[Path],
    split: str,
    write: "Callable[[Observations, Split, Report], None]",
    library: str,
) -> None:
    from importlib.util import find_spec

    from objectfolder.benchmarks.observations import Observations, find_folders
    from objectfolder.benchmarks.splits import named_split

    if find_spec(library) is None:
        raise ObjectFolderError(f"{library} is not installed; this needs: pip install 'objectfolder[hub]'")
    observations = Observations(find_folders(folders))
    chosen = named_split(split, observations.keys, observations.count)
    with console.status("") as status:
        write(observations, chosen, lambda done, total: status.update(f"{done} of {total} samples"))
    console.print(
        f"{len(observations.keys)} objects in {out}/: {len(chosen.train)} samples to train, "
        f"{len(chosen.val)} to validate, {len(chosen.test)} to test",
        highlight=False,
        soft_wrap=True,
    )
