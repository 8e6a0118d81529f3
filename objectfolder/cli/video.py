"""Command that renders a video of Object Files: video."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.cli.encoding import encoder, write_video
from objectfolder.cli.files import FilesArgument


def video(
    files: FilesArgument,
    out: Annotated[Path, typer.Option(help="Video to write, .mp4.")] = Path("objects.mp4"),
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length per object.")] = 8.0,
    resolution: Annotated[
        int, typer.Option(min=16, help="Side of the square frames, pixels; even, at least 16.")
    ] = 384,
    fps: Annotated[int, typer.Option(min=1, max=1000, help="Frames per second, at most 1000.")] = 25,
    contacts: Annotated[int, typer.Option(min=1, help="Strikes and touches per object.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the contact points.")] = 0,
) -> None:
    """Render a video of objects on a turntable, struck and touched, with sound.

    Needs the program ffmpeg (Debian: `apt-get install ffmpeg`). A frame takes about 0.3 seconds.

    Example: `objectfolder video mug die bell --out samples.mp4`
    """
    import numpy as np

    from objectfolder.objectfile import turntable as film
    from objectfolder.objectfile.file import ObjectFile

    program = encoder("video", out, resolution)
    settings = film.Turntable(duration, resolution, fps, contacts, seed)
    film.require_room(settings, len(files))
    objects = [ObjectFile.load(path) for path in files]
    chosen = [film.contacts(file, settings) for file in objects]
    sounds = [film.sound(file, settings, found) for file, found in zip(objects, chosen)]
    frames = (frame for file, found in zip(objects, chosen) for frame in film.pictures(file, settings, found))
    count, track = len(settings) * len(objects), np.concatenate(sounds)
    shape = (resolution, resolution)
    write_video(program, out, frames, count, fps, shape, track, settings.sample_rate)
