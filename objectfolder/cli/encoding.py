"""Videos with sound, by the program ffmpeg."""

import subprocess
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import atomic, check_output
from objectfolder.cli.console import print_line, track_progress
from objectfolder.sound.recordings import find_ffmpeg


def encoder(command: str, out: Path, *sides: int) -> str:
    """Return the path of ffmpeg, for a command that writes a video of these width and height.

    Raises ObjectFolderError if it is not installed, the video has another name than .mp4 or cannot be
    written, or a side is odd.
    """
    if out.suffix.lower() != ".mp4":
        raise ObjectFolderError(f"{out}: expected a name that ends in .mp4")
    for side in sides:
        if side < 2 or side % 2:
            raise ObjectFolderError(
                f"resolution is {side}, expected an even number, which the video codec needs"
            )
    program = find_ffmpeg(command)
    check_output(out)
    return program


def write_video(
    program: str,
    out: Path,
    pictures: Iterable[np.ndarray],
    count: int,
    rate: float,
    size: tuple[int, int],
    sound: np.ndarray,
    sample_rate: int,
) -> None:
    """Encode pictures and sound, and say so.

    ``program``: see `encoder`; ``pictures`` (H, W, 3); ``count``: how many pictures there are; ``rate``:
    frames per second; ``size`` (int, int): width and height, pixels; ``sound`` (samples,): in [-1, 1];
    ``sample_rate``: Hz.
    """
    import soundfile

    with atomic(out) as path, TemporaryDirectory() as folder, TemporaryFile() as log:
        track = Path(folder, "sound.wav")
        soundfile.write(track, sound, sample_rate)
        shape = "x".join(map(str, size))
        frames = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", shape, "-r", str(rate), "-i", "-"]
        codecs = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-c:a", "aac", "-b:a", "160k"]
        command = [program, "-y", "-loglevel", "error", *frames, "-i", str(track), *codecs]
        with subprocess.Popen([*command, str(path)], stdin=subprocess.PIPE, stderr=log) as running:
            assert running.stdin is not None
            try:
                for picture in track_progress(pictures, "frames", count):
                    running.stdin.write(picture.tobytes())
            except BrokenPipeError:
                pass  # it says why
        if running.returncode:
            log.seek(0)
            said = log.read().decode(errors="replace").strip()
            raise ObjectFolderError(f"{out}: ffmpeg failed: {shortened(said, 300)}")
    print_line(f"{out} ({out.stat().st_size / 1e6:.1f} MB)")
