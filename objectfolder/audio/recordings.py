"""Recordings of taps on real objects."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from objectfolder.errors import ObjectFolderError

LOUDEST = 0.999  # of full scale; samples above are clipped if several follow each other
CLIPPED = 3  # samples
CUT = 2  # samples in a row at the highest level, where a sound was cut off below full scale
LEVELS = 8  # below the highest, which together are taken more often unless the sound is cut off
UNBOUNDED = ("FLOAT", "DOUBLE")  # subtypes of files that hold samples above full scale
SILENT = 1e-4  # of full scale, peak
MIN_RATE = 8000.0  # Hz
MAX_SECONDS = 600.0
MAX_RATIO = 1.5  # of the highest to the lowest sample rate
USABLE = 0.45  #: of the sample rate: modes above are not looked for


def read_recording(path: Path) -> tuple[np.ndarray, float]:
    """Read a recording: the loudest of its channels, full scale 1, and its sample rate in Hz.

    Raises
    ------
    ObjectFolderError
        If it is not an audio file, or is silent, clipped, not finite, too long or of a low rate.
    """
    import soundfile

    try:
        if path.is_dir() or not path.exists():
            problem = "is a folder" if path.is_dir() else "does not exist"
            raise ObjectFolderError(f"{path} {problem}; expected a recording: WAV, FLAC or OGG")
        with soundfile.SoundFile(path) as file:
            rate, seconds = float(file.samplerate), file.frames / file.samplerate
            if rate < MIN_RATE or seconds > MAX_SECONDS:
                raise ObjectFolderError(
                    f"{path} has {rate:g} Hz and {seconds:.1f} s, expected at least {MIN_RATE:g} Hz and at "
                    f"most {MAX_SECONDS:g} s"
                )
            channels, bounded = file.read(dtype="float64", always_2d=True), file.subtype not in UNBOUNDED
    except (soundfile.LibsndfileError, OSError) as error:
        raise ObjectFolderError(
            f"{path} is not a readable audio file ({error}); expected WAV, FLAC or OGG"
        ) from error
    sound = loudest_channel(channels, path)
    peak = np.abs(sound).max(initial=0)
    if not peak > SILENT:
        raise ObjectFolderError(f"{path} is silent: its peak is {peak:.1g} of full scale")
    full = bounded and _in_a_row(np.abs(sound) > LOUDEST, CLIPPED)
    if full or _cut_off(sound) or _cut_off(-sound):
        raise ObjectFolderError(f"{path} is clipped: record it again at a lower level, or leave it out")
    return sound, rate


def loudest_channel(channels: np.ndarray, path: Path) -> np.ndarray:
    """Return the channel of a recording, (samples, channels), that has the highest peak; (samples,).

    Raises
    ------
    ObjectFolderError
        If a channel holds values that are not finite.
    """
    peaks = np.abs(channels).max(0, initial=0)
    if not np.isfinite(peaks).all():
        raise ObjectFolderError(
            f"{path} holds values that are not finite, expected numbers; export it again, or leave it out"
        )
    return channels[:, peaks.argmax()]


def at_one_rate(
    recordings: Sequence[tuple[np.ndarray, float]], names: Sequence[object] | None = None
) -> tuple[list[np.ndarray], float]:
    """Resample recordings to the lowest of their rates.

    Parameters
    ----------
    recordings : sequence of ((samples,) array, float)
        Sounds and their sample rates, Hz.
    names : sequence, optional
        Names of the recordings in error messages.

    Raises
    ------
    ObjectFolderError
        If the rates differ so much that high modes would be lost.
    """
    names = names or [f"recording {i}" for i in range(1, len(recordings) + 1)]
    rates = [rate for _, rate in recordings]
    lowest, highest = min(rates), max(rates)
    if highest > MAX_RATIO * lowest:
        raise ObjectFolderError(
            f"{names[rates.index(lowest)]} has {lowest:g} Hz, the others up to {highest:g} Hz; all are "
            f"brought to the lowest rate, and modes above {USABLE * lowest:.0f} Hz would be lost: leave out "
            f"recordings of {lowest:g} Hz"
        )
    return [at_rate(sound, own, lowest) for sound, own in recordings], lowest


def at_rate(sound: np.ndarray, own: float, rate: float) -> np.ndarray:
    """Resample a sound, (samples,), from its own sample rate to another, Hz."""
    from scipy.signal import resample_poly

    return sound if own == rate else resample_poly(sound, int(rate), int(own))


def _in_a_row(flags: np.ndarray, count: int) -> bool:
    return bool(np.convolve(flags, np.ones(count), "valid").max(initial=0) >= count)


def _cut_off(sound: np.ndarray) -> bool:
    """Tell whether the tops of a sound are cut off, at any level.

    A round top takes the levels just below it more often than its highest, however coarse the levels are.
    """
    highest = sound.max()
    levels, counts = np.unique(sound[sound > highest / 2], return_counts=True)
    piled = len(levels) > LEVELS and counts[-1] > counts[-LEVELS - 1 : -1].sum()
    return bool(piled) and _in_a_row(sound == highest, CUT)
