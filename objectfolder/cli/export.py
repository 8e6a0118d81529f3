"""Commands that export observations and objects for other libraries and engines: export."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.installation import install_command
from objectfolder.cli.console import App, print_line, show_status, track_progress
from objectfolder.cli.files import FilesArgument, folder_to_write

if TYPE_CHECKING:
    from objectfolder.benchmarks.datasets.export import Report
    from objectfolder.benchmarks.datasets.observations import Observations
    from objectfolder.benchmarks.datasets.splits import Split
    from objectfolder.objectfile.file import ObjectFile

export_app = App(
    help="Export objects to physics engines (`mjcf`, `urdf`, `usd`), game engines (`glb`) and viewers of "
    "Gaussian splats (`splats`), and training data to `webdataset`, Hugging Face `datasets`, `nerfstudio` "
    "and `lerobot`.",
)

SIMULATION = ("mujoco", "coacd", "manifold3d")  #: libraries of rigid bodies

# Checked before the files: in earlier versions it came before them.
OutArgument = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="Folder to create.", callback=folder_to_write, is_eager=True),
]
FoldersArgument = Annotated[
    list[Path],
    typer.Argument(metavar="DIR...", help="Folders that hold observations, or whose subfolders do."),
]
HullsOption = Annotated[int, typer.Option(min=1, help="Maximum number of convex hulls per object.")]
SplitOption = Annotated[
    str,
    typer.Option(
        metavar="seen|unseen",
        help="seen: all objects in all parts; unseen: test objects only in the test part.",
    ),
]


@export_app.command()
def webdataset(
    folders: FoldersArgument,
    out: OutArgument,
    split: SplitOption = "seen",
    shard: Annotated[int, typer.Option(min=1, help="Samples per tar file.")] = 1000,
) -> None:
    """Write tar files for the WebDataset library: train-000000.tar ... val- ... test-...

    A sample has vision.png, audio.wav (float, absolute scale), touch.png and json: label, key, material,
    scale and the queries. index.json names the labels. Then, in Python:

    `webdataset.WebDataset("OUT/train-{000000..000003}.tar").decode("rgb")`
    """
    from objectfolder.benchmarks.datasets.export import write_webdataset

    def write(observations: "Observations", chosen: "Split", report: "Report") -> None:
        write_webdataset(observations, chosen, out, shard, report)

    _export(out, folders, split, write, "webdataset")


@export_app.command()
def datasets(folders: FoldersArgument, out: OutArgument, split: SplitOption = "seen") -> None:
    """Write a folder for the Datasets library of Hugging Face: Parquet files and a card, README.md.

    Then, in Python, without a network: `datasets.load_dataset("OUT")`
    """
    from objectfolder.benchmarks.datasets.export import write_datasets

    def write(observations: "Observations", chosen: "Split", report: "Report") -> None:
        write_datasets(observations, chosen, out, report)

    _export(out, folders, split, write, "datasets")


@export_app.command()
def mjcf(files: FilesArgument, out: OutArgument, hulls: HullsOption = 16) -> None:
    """Write a folder OUT/KEY per object for MuJoCo: a body with free joint, hulls, texture, mass and inertia.

    Then, in Python: `mujoco.MjModel.from_xml_path("OUT/KEY/KEY.xml")`. Takes half a minute per object.
    """
    require_libraries("rl", *SIMULATION)
    from objectfolder.sim.export import write_mjcf

    _export_objects(out, files, hulls, write_mjcf)


@export_app.command()
def urdf(files: FilesArgument, out: OutArgument, hulls: HullsOption = 16) -> None:
    """Write a folder OUT/KEY per object for PyBullet and other URDF readers: a link, with what `mjcf` writes.

    Then, in Python: `loadURDF("OUT/KEY/KEY.urdf", flags=URDF_USE_INERTIA_FROM_FILE)`. Takes half a minute per
    object.
    """
    require_libraries("rl", *SIMULATION)
    from objectfolder.sim.export import write_urdf

    _export_objects(out, files, hulls, write_urdf)


@export_app.command()
def glb(files: FilesArgument, out: OutArgument, hulls: HullsOption = 16) -> None:
    """Write OUT/KEY/KEY.glb per object: glTF with its look, mass, hulls and vibration modes.

    Any glTF reader draws it. Rigid body and sound are the draft extensions KHR_physics_rigid_bodies and
    KHR_audio_rigid_bodies (docs/robots.md). Half a minute per object.
    """
    require_libraries("rl", *SIMULATION)
    from objectfolder.sim.gltf import write_glb

    _export_objects(out, files, hulls, write_glb)


@export_app.command()
def usd(
    files: FilesArgument,
    out: OutArgument,
    hulls: HullsOption = 16,
    label: Annotated[str, typer.Option(help="Class of the objects, such as mug.")] = "physical object",
    qcode: Annotated[str, typer.Option(help="Code of the class in Wikidata.")] = "Q223557",
    author: Annotated[str, typer.Option(help="Author of the objects.")] = "unknown",
    licence: Annotated[str, typer.Option(help="Licence of the objects, such as CC-BY-4.0.")] = "unknown",
) -> None:
    """Write OUT/KEY/usd/KEY.usd per object: OpenUSD with look, mass, inertia, friction, hulls and labels.

    Then, in Python: `pxr.Usd.Stage.Open("OUT/KEY/usd/KEY.usd")`. Takes half a minute per object. Valid for
    the profile Robotics-Prop 4.0.0 of SimReady (docs/robots.md).
    """
    require_libraries("usd", "pxr")
    require_libraries("rl", *SIMULATION)
    from objectfolder.sim.usd import AssetInfo, write_usd

    info = AssetInfo(label, qcode, author, licence)
    _export_objects(out, files, hulls, lambda file, folder, most: write_usd(file, folder, most, info=info))


@export_app.command("splats")
def export_splats(
    files: FilesArgument,
    out: OutArgument,
    count: Annotated[int, typer.Option(min=100, help="Splats per object, about.")] = 100_000,
    degree: Annotated[
        int, typer.Option(min=0, max=3, help="Of the harmonics; 0: the same colour from everywhere.")
    ] = 2,
    lights: Annotated[
        str,
        typer.Option(
            metavar="studio|FILE.npy", help="Lights: studio, or a file (L, 6): position xyz, linear RGB."
        ),
    ] = "studio",
    environment: Annotated[
        Path | None, typer.Option(help="Environment map as light, equirectangular: .hdr or .exr.")
    ] = None,
    resolution: Annotated[
        int, typer.Option(min=16, help="Side of the views for which outlines are right, pixels.")
    ] = 256,
) -> None:
    """Write OUT/KEY/KEY.ply per object: Gaussian splats under a fixed light, for viewers of splats.

    The format is that of 3D Gaussian Splatting, in metres, z up. An environment replaces the lights. Half a
    minute per object.
    """
    from objectfolder.cli.objectfile import read_lamps
    from objectfolder.objectfile.splats import write_splats

    lamps = None if environment is not None else read_lamps(lights)
    for file in _load_objects(out, files, "geometry", "vision"):
        with show_status("") as show:

            def report(done: int, total: int, key: str = file.key) -> None:
                show(f"{key}: {done} of {total} views")

            path = write_splats(file, out, count, degree, lamps, environment, resolution, report)
        print_line(str(path))


@export_app.command()
def nerfstudio(
    files: FilesArgument,
    out: OutArgument,
    views: Annotated[int, typer.Option("-n", "--views", min=1, help="Images per object.")] = 100,
    resolution: Annotated[int, typer.Option(min=1, help="Side of the square images, pixels.")] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    fixed_light: Annotated[
        bool, typer.Option("--fixed-light", help="One light for all views, for nets that cannot relight.")
    ] = False,
) -> None:
    """Write OUT/KEY/transforms.json and images/ per object: rendered views with cameras and lights.

    Then: `ns-train nerfacto --data OUT/KEY`. The images have an alpha channel.
    """
    from objectfolder.benchmarks.datasets.nerfstudio import write_nerfstudio

    objects = _load_objects(out, files, "vision")
    for file in objects:
        if file.header["vision"]["kind"] == "surface":
            file.require("geometry")
    for file in objects:
        with show_status("") as show:

            def report(done: int, total: int, key: str = file.key) -> None:
                show(f"{key}: {done} of {total} views")

            path = write_nerfstudio(file, out, views, resolution, seed, fixed_light, report)
        print_line(str(path))


@export_app.command()
def lerobot(
    files: FilesArgument,
    out: OutArgument,
    episodes: Annotated[int, typer.Option("-n", "--episodes", min=1, help="Contacts per object.")] = 10,
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length of an episode.")] = 1.0,
    fps: Annotated[int, typer.Option(min=1, help="Frames per second; divides the sample rate.")] = 25,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
) -> None:
    """Write a LeRobot dataset (format v3.0): tactile images of presses, and their sounds.

    Then, in Python: `LeRobotDataset("objectfolder/touch", root="OUT")`.
    """
    require_libraries("hub", "datasets")
    from objectfolder.benchmarks.datasets.lerobot import write_lerobot
    from objectfolder.objectfile.file import ObjectFile

    objects = [ObjectFile.load(file) for file in files]
    for found in objects:
        found.require("geometry", "audio", "touch")
    with show_status("") as show:
        write_lerobot(
            objects,
            out,
            episodes,
            duration,
            fps,
            seed=seed,
            report=lambda done, total: show(f"{done} of {total} episodes"),
        )
    print_line(f"{plural(len(objects), 'object')} in {out}/: {plural(episodes, 'episode')} of each")


def _export_objects(
    out: Path, files: list[Path], hulls: int, write: "Callable[[ObjectFile, Path, int], Path]"
) -> None:
    from objectfolder.sim.body import density

    objects = _load_objects(out, files, "geometry")
    for found in objects:
        density(found)
    for found in track_progress(objects, "exporting objects", len(objects)):
        print_line(str(write(found, out, hulls)))


def _load_objects(out: Path, files: list[Path], *needs: str) -> "list[ObjectFile]":
    """Load objects, each of which gets a new folder and has the parts; checked before anything is written."""
    from objectfolder.objectfile.file import ObjectFile

    objects = [ObjectFile.load(file) for file in files]
    for i, (file, found) in enumerate(zip(files, objects)):
        if os.path.lexists(out / found.key):
            raise ObjectFolderError(f"{out / found.key} exists already: choose another folder, or delete it")
        if found.key in (other.key for other in objects[:i]):
            raise ObjectFolderError(f"{file}: a second object {found.key}; export it to another folder")
        found.require(*needs)
    return objects


def require_libraries(extra: str, *libraries: str) -> None:
    """Raise ObjectFolderError if a library is not installed, with the extra that has it."""
    from importlib.util import find_spec

    for library in libraries:
        if find_spec(library) is None:
            raise ObjectFolderError(f"{library} is not installed; this needs: {install_command(extra)}")


def _export(
    out: Path,
    folders: list[Path],
    split: str,
    write: "Callable[[Observations, Split, Report], None]",
    library: str,
) -> None:
    from objectfolder.benchmarks.datasets.observations import Observations, find_folders
    from objectfolder.benchmarks.datasets.splits import named_split

    require_libraries("hub", library)
    observations = Observations(find_folders(folders))
    chosen = named_split(split, observations.keys, observations.count)
    with show_status("") as show:
        write(observations, chosen, lambda done, total: show(f"{done} of {total} samples"))
    print_line(
        f"{plural(len(observations.keys), 'object')} in {out}/: {len(chosen.train)} samples to train, "
        f"{len(chosen.val)} to validate, {len(chosen.test)} to test"
    )
