"""Commands that write query files: sample."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from objectfolder.base.arrays import write_npy
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import check_output
from objectfolder.cli.console import App, print_line
from objectfolder.cli.objectfile import FileArgument

sample_app = App(
    help="Write files of random queries: `vision`, `audio` or `touch`. `objectfolder query` answers them.",
)

_TAP = 0.01, 0.05  # impulses of taps with a small hammer or a finger, N s

OutArgument = Annotated[Path, typer.Argument(metavar="OUT.npy", help="File to write.")]
CountOption = Annotated[int, typer.Option("-n", "--count", min=1, help="Number of queries, one per row.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Random seed.")]


@sample_app.command()
def vision(
    out: OutArgument,
    count: CountOption = 20,
    seed: SeedOption = 0,
    radius: Annotated[float, typer.Option(help="Radius of the sphere of cameras.")] = 2.5,
    light_radius: Annotated[float, typer.Option(help="Radius of the sphere of lights.")] = 1.0,
    cameras_only: Annotated[
        bool,
        typer.Option(
            "--cameras-only",
            help="Leave out the lights: (N, 3), as `query vision` expects with --lights or --environment.",
        ),
    ] = False,
) -> None:
    """Write views, (N, 6): camera xyz, light xyz, each uniform on a sphere around the object.

    Positions are in the unit frame, the same for all objects. Then:

    `objectfolder query vision FILE OUT.npy IMAGES/`
    """
    from objectfolder.objectfile.query_files import sample_views

    views = sample_views(count, seed, radius, light_radius)
    _write({out: views[:, :3] if cameras_only else views})


@sample_app.command()
def audio(
    file: FileArgument,
    out: OutArgument,
    count: CountOption = 20,
    seed: SeedOption = 0,
    force: Annotated[
        float | None,
        typer.Option(help="Size of every impulse, N s; default: taps, random between 0.01 and 0.05."),
    ] = None,
    directions: Annotated[
        str,
        typer.Option(
            metavar="normal|random",
            help="normal: along the inward surface normal, like a hammer; random: any inward direction.",
        ),
    ] = "normal",
    forces: Annotated[
        Path | None,
        typer.Option(
            metavar="FORCES.npy", help="Write impulses (N, 3) to this file, and only points to OUT.npy."
        ),
    ] = None,
) -> None:
    """Write strikes, (N, 6): points on the surface (metres), uniform by area, and impulses (N s).

    The published dataset has points and impulses in two files: `--forces` writes these. Then:

    `objectfolder query audio FILE OUT.npy SOUNDS/ --sample-rate 48000 --listener 0.5 0 0.3 --normalize`
    """
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.objectfile.query_files import sample_strikes

    _check_names(out, forces)
    rows = sample_strikes(ObjectFile.load(file), count, seed, 1.0 if force is None else force, directions)
    if force is None:  # drawn by a generator independent of those of points and directions
        rows[:, 3:] *= np.random.default_rng(seed).spawn(2)[1].uniform(*_TAP, (count, 1))
    _write({out: rows} if forces is None else {out: rows[:, :3], forces: rows[:, 3:]})


@sample_app.command()
def touch(
    file: FileArgument,
    out: OutArgument,
    count: CountOption = 20,
    seed: SeedOption = 0,
    gelinfo: Annotated[
        Path | None,
        typer.Option(
            metavar="GELINFO.npy",
            help="Also write (N, 3): tilt theta up to 15 degrees, its direction phi (both in radians), depth "
            "in the sensor's range (metres).",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="SENSOR",
            help="Sensor of the depths: a name (`sensor list`) or .yaml file; default: the Object File's.",
        ),
    ] = None,
) -> None:
    """Write contacts, (N, 3): points on the surface (metres), uniform by area.

    With `--gelinfo`, also the tilt and press depth of the sensor. Then:

    `objectfolder query touch FILE OUT.npy IMAGES/ [--gelinfo GELINFO.npy]`
    """
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.objectfile.query_files import sample_presses
    from objectfolder.touch.profiles import load_profile

    _check_names(out, gelinfo)
    if sensor is not None and gelinfo is None:
        raise ObjectFolderError("--sensor has an effect only with --gelinfo, whose depths it determines")
    obj = ObjectFile.load(file)
    arrays = {out: obj.sample_surface(count, seed)}
    if gelinfo is not None:
        profile = None if sensor is None else load_profile(sensor)
        arrays[gelinfo] = sample_presses(obj, count, seed, profile)
    _write(arrays)


def _check_names(*paths: Path | None) -> None:
    given = [path for path in paths if path is not None]
    for path in given:
        if path.suffix != ".npy":
            raise ObjectFolderError(f"cannot write queries to {path}: expected the name of a .npy file")
    if len({path.resolve() for path in given}) < len(given):
        raise ObjectFolderError(f"{given[0]} is given twice: expected two files")
    for path in given:
        check_output(path)


def _write(arrays: dict[Path, np.ndarray]) -> None:
    _check_names(*arrays)
    for path, array in arrays.items():
        write_npy(path, array)
    shapes = " and ".join(f"{path} {array.shape}" for path, array in arrays.items())
    print_line(f"wrote {shapes}")
