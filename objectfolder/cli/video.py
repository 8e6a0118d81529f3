"""Command that films Object Files: video."""

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Annotated

import typer

from objectfolder.cli.console import console, tracked
from objectfolder.errors import ObjectFolderError, shortened


def video(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Object Files, or the samples mug, die and bell."),
    ],
    out: Annotated[Path, typer.Option(help="Video to write, .mp4.")] = Path("objects.mp4"),
    seconds: Annotated[float, typer.Option(help="Seconds of each object's turn.")] = 8.0,
    size: Annotated[int, typer.Option(help="Width and height, pixels; even.")] = 384,
    rate: Annotated[int, typer.Option(help="Pictures per second.")] = 25,
    contacts: Annotated[int, typer.Option(help="Strikes and touches of each object.")] = 4,
    seed: Annotated[int, typer.Option(help="Seed of their places.")] = 0,
) -> None:
    """Film objects on a turntable, struck and touched, with sound.

    Needs the program ffmpeg (Debian: apt-get install ffmpeg). A picture takes some 0.3 seconds.

    Example: objectfolder video mug die bell --out samples.mp4
    """
    import numpy as np
    import soundfile

    from objectfolder.io import atomic
    from objectfolder.objectfile import turntable as film
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.objectfile.samples import available_samples, sample_path

    program = shutil.which("ffmpeg")
    if program is None:
        raise ObjectFolderError(
            "video needs the program ffmpeg, which is not on the PATH: apt-get install ffmpeg"
        )
    if out.suffix.lower() != ".mp4":
        raise ObjectFolderError(f"{out}: expected a name that ends in .mp4")
    if size % 2:
        raise ObjectFolderError(f"size is {size}, expected an even number: the codec halves the colours")
    settings = film.Turntable(seconds, size, rate, contacts, seed)
    named = [sample_path(str(f)) if str(f) in available_samples() and not f.exists() else f for f in files]
    objects = [ObjectFile.load(path) for path in named]
    chosen = [film.contacts(file, settings) for file in objects]
    sounds = [film.sound(file, settings, found) for file, found in zip(objects, chosen)]
    shots = (shot for file, found in zip(objects, chosen) for shot in film.pictures(file, settings, found))
    with atomic(out) as path, TemporaryDirectory() as folder, TemporaryFile() as log:
        track = Path(folder, "sound.wav")
        soundfile.write(track, np.concatenate(sounds), settings.sample_rate)
        frames = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size}x{size}", "-r", str(rate), "-i", "-"]
        codecs = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-c:a", "aac", "-b:a", "160k"]
        command = [program, "-y", "-loglevel", "error", *frames, "-i", str(track), *codecs]
        with subprocess.Popen([*command, str(path)], stdin=subprocess.PIPE, stderr=log) as encoder:
            assert encoder.stdin is not None
            try:
                for shot in tracked(shots, "pictures", len(settings) * len(objects)):
                    encoder.stdin.write(shot.tobytes())
            except BrokenPipeError:
                pass  # it says why
        if encoder.returncode:
            log.seek(0)
            said = log.read().decode(errors="replace").strip()
            raise ObjectFolderError(f"{out}: ffmpeg failed: {shortened(said, 300)}")
    console.print(f"{out} ({out.stat().st_size / 1e6:.1f} MB)", highlight=False, soft_wrap=True)
