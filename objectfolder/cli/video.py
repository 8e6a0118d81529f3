"""Command that films Object Files: video."""

from pathlib import Path
from typing import Annotated

import typer

from objectfolder.cli.encoding import encoder, write_video
from objectfolder.cli.files import FilesArgument, bounded


def video(
    files: FilesArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Video to write, .mp4.")] = Path("objects.mp4"),
    seconds: Annotated[float, typer.Option(metavar="SECONDS", help="Duration of each object's turn.")] = 8.0,
    size: Annotated[
        int, typer.Option(**bounded(16), help="Width and height in pixels, even, at least 16.")
    ] = 384,
    rate: Annotated[int, typer.Option(**bounded(1, 1000), help="Frames per second, 1 to 1000.")] = 25,
    contacts: Annotated[
        int, typer.Option(**bounded(1), help="Strikes and touches per object, at least 1.")
    ] = 4,
    seed: Annotated[int, typer.Option(**bounded(0), help="Random seed for their positions, 0 or more.")] = 0,
) -> None:
    """Render a video of objects on a turntable, struck and touched, with sound.

    `objectfolder video mug die bell --out samples.mp4`

    Needs ffmpeg (Debian: apt-get install ffmpeg). A frame takes about 0.3 s.
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
