"""Recordings of taps on real objects."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objectfolder.errors import ObjectFolderError

LOUDEST = 0.999  # of full scale; samples above are clipped if several follow each other
CLIPPED = 3  # samples
SILENT = 1e-4  # of full scale, peak
MIN_RATE = 8000.0  # Hz
MAX_SECONDS = 600.0


def read_recording(path: Path) -> tuple[np.ndarray, float]:
    """Read a recording: the loudest of its channels, full scale 1, and its sample rate in Hz.

    Raises
    ------
    ObjectFolderError
        If it is not an audio file, or is silent, clipped, too long or of a low rate.
    """
    import soundfile

    try:
        with soundfile.SoundFile(path) as file:
            rate, seconds = float(file.samplerate), file.frames / file.samplerate
            if rate < MIN_RATE or seconds > MAX_SECONDS:
                raise ObjectFolderError(
                    f"{path} has {rate:g} Hz and {seconds:.1f} s, expected at least {MIN_RATE:g} Hz and at "
                    f"most {MAX_SECONDS:g} s"
                )
            channels = file.read(dtype="float64", always_2d=True)
    except (soundfile.LibsndfileError, OSError) as error:
        raise ObjectFolderError(
            f"{path} is not a readable audio file ({error}); expected WAV, FLAC or OGG"
        ) from error
    peaks = np.abs(channels).max(0, initial=0)
    if not peaks.max(initial=0) > SILENT:
        raise ObjectFolderError(f"{path} is silent: its peak is {peaks.max(initial=0):.1g} of full scale")
    sound = channels[:, peaks.argmax()]
    clipped = np.convolve(np.abs(sound) > LOUDEST, np.ones(CLIPPED), "valid").max(initial=0) >= CLIPPED
    if clipped:
        raise ObjectFolderError(f"{path} is clipped: record it again at a lower level, or leave it out")
    return sound, rate


def at_one_rate(recordings: Sequence[tuple[np.ndarray, float]]) -> tuple[list[np.ndarray], float]:
    """Resample recordings to the lowest of their rates."""
    from scipy.signal import resample_poly

    rate = min(rate for _, rate in recordings)
    return [
        sound if own == rate else resample_poly(sound, int(rate), int(own)) for sound, own in recordings
    ], rate
