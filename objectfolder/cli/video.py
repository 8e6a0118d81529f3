"""Command that films Object Files: video."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.cli.encoding import encoder, write_video
from objectfolder.cli.files import FilesArgument


def video(
    files: FilesArgument,
    out: Annotated[Path, typer.Option(help="Video to write, .mp4.")] = Path("objects.mp4"),
    seconds: Annotated[float, typer.Option(help="Seconds of each object's turn.")] = 8.0,
    size: Annotated[int, typer.Option(min=16, help="Width and height, pixels; even.")] = 384,
    rate: Annotated[int, typer.Option(min=1, max=1000, help="Pictures per second.")] = 25,
    contacts: Annotated[int, typer.Option(min=1, help="Strikes and touches of each object.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Seed of their places.")] = 0,
) -> None:
    """Film objects on a turntable, struck and touched, with sound.

    Needs the program ffmpeg (Debian: apt-get install ffmpeg). A picture takes some 0.3 seconds.

    Example: objectfolder video mug die bell --out samples.mp4
    """
    import numpy as np

    from objectfolder.objectfile import turntable as film
    from objectfolder.objectfile.file import ObjectFile

    program = encoder("video", out, size)
    settings = film.Turntable(seconds, size, rate, contacts, seed)
    film.require_room(settings, len(files))
    objects = [ObjectFile.load(path) for path in files]
    chosen = [film.contacts(file, settings) for file in objects]
    sounds = [film.sound(file, settings, found) for file, found in zip(objects, chosen)]
    frames = (frame for file, found in zip(objects, chosen) for frame in film.pictures(file, settings, found))
    count, track = len(settings) * len(objects), np.concatenate(sounds)
    write_video(program, out, frames, count, rate, (size, size), track, settings.sample_rate)
