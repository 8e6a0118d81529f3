"""Recordings of taps on real objects."""

import io
import math
import re
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import content_hint

if TYPE_CHECKING:
    import soundfile

CLIPPING_LEVEL = 0.999  # of full scale; samples above are clipped if several follow each other
CLIPPED_RUN = 3  # samples
FLAT_TOP_RUN = 2  # samples in a row at the highest level, where a sound was cut off below full scale
LEVELS = 8  # below the highest, which together are taken more often unless the sound is cut off
FLOAT_SUBTYPES = ("FLOAT", "DOUBLE")  # subtypes of files that hold samples above full scale
FORMATS = "WAV, FLAC, OGG, M4A or another container that ffmpeg decodes"
MIN_PEAK = 1e-4  # of full scale, peak
MIN_RATE = 8000.0  # Hz
MAX_SECONDS = 600.0
MAX_RATIO = 1.5  # of the highest to the lowest sample rate
LENGTH_TOLERANCE = 0.05  # s that may lack at the end: some encoders write lengths that are wrong by less
# Bytes; such sizes, and 0, stand for one that was not known when the header was written
UNKNOWN_SIZE = 0x7FFF0000
UNKNOWN_LENGTH = 2**62  # samples; as many or more stand for a number that is not known
#: In the log of libsndfile: bytes of sound that the header says, and that the file has.
_SIZES = re.compile(r"^\s*(?:data|SSND|Data Size|riff|Riff size)\s*: (\d+) \(should be (\d+)\)", re.MULTILINE)
#: What files begin with that ffmpeg decodes: Matroska and WebM, AMR, AAC, ASF. MP4 has b"ftyp" at byte 4.
_CONTAINERS = (b"\x1aE\xdf\xa3", b"#!AMR", b"\xff\xf1", b"\xff\xf9", b"0&\xb2u")
_PAGE = 65307  # bytes, of the longest page of Ogg
USABLE_BAND = 0.45  #: of the sample rate: modes above are not looked for


def read_recording(path: Path) -> tuple[np.ndarray, float]:
    """Read a recording: the loudest of its channels, full scale 1, and its sample rate in Hz.

    Raises ObjectFolderError if it is not an audio file, or is silent, clipped, not finite, too long, of a low
    rate or cut off.
    """
    with open_sound(path) as file:
        rate, seconds = float(file.samplerate), file.frames / file.samplerate
        if rate < MIN_RATE or seconds > MAX_SECONDS:
            raise ObjectFolderError(
                f"{path} has {rate:g} Hz and {seconds:.1f} s, expected at least {MIN_RATE:g} Hz and at "
                f"most {MAX_SECONDS:g} s"
            )
        channels, bounded = read_channels(file, path), file.subtype not in FLOAT_SUBTYPES
    sound = loudest_channel(channels, path)
    peak = np.abs(sound).max(initial=0)
    if not peak > MIN_PEAK:
        raise ObjectFolderError(
            f"{path} is silent: its peak is {peak:.1g} of full scale; record it again, or leave it out"
        )
    full = bounded and _in_a_row(np.abs(sound) > CLIPPING_LEVEL, CLIPPED_RUN)
    if full or _cut_off(sound) or _cut_off(-sound):
        raise ObjectFolderError(f"{path} is clipped: record it again at a lower level, or leave it out")
    return sound, rate


@contextmanager
def open_sound(path: Path) -> Iterator["soundfile.SoundFile"]:
    """Open an audio file; its errors, also of what is done with it, become ObjectFolderError.

    A WAV file whose header has no sizes, as of a program that wrote to a pipe, goes on to its end. M4A and
    other containers are decoded by ffmpeg. Raises ObjectFolderError if it does not exist, cannot be read, or
    does not say how long it is; if an OGG file lacks its end, or ffmpeg is needed and not installed.
    """
    import soundfile

    try:
        if path.is_dir() or not path.exists():
            problem = "is a folder" if path.is_dir() else "does not exist"
            raise ObjectFolderError(f"{path} {problem}; expected a recording: {FORMATS}")
        if _lacks_end(path):
            raise ObjectFolderError(
                f"{path} is cut off: its last page is not that of the end; copy or record it again"
            )
        with _decoded(path) as sound, soundfile.SoundFile(_sized(sound) or sound) as file:
            if file.frames >= UNKNOWN_LENGTH:
                raise ObjectFolderError(
                    f"{path} does not say how long it is; convert it, as by `ffmpeg -i FILE sound.wav`"
                )
            yield file
    except (soundfile.LibsndfileError, OSError) as error:
        raise ObjectFolderError(
            f"{path} is not a readable audio file ({error}){content_hint(path)}; expected {FORMATS}"
        ) from error


def find_ffmpeg(needed_by: object) -> str:
    """Return the path of ffmpeg; if it is not installed, raise ObjectFolderError that names what needs it."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise ObjectFolderError(
            f"{needed_by} needs the program ffmpeg, which is not on the PATH: apt-get install ffmpeg"
        )
    return program


@contextmanager
def _decoded(path: Path) -> Iterator[Path]:
    """Give the path of a sound that libsndfile reads: the file itself, or what ffmpeg decodes of it."""
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] != b"ftyp" and not head.startswith(_CONTAINERS):
        yield path
        return
    program = find_ffmpeg(path)
    with TemporaryDirectory() as folder:
        sound = Path(folder, "sound.wav")
        # No file that it names is read. 24 bits are clipped where a recording is.
        source = ["-nostdin", "-v", "error", "-protocol_whitelist", "file", "-i", f"file:{path}"]
        written = ["-vn", "-t", str(MAX_SECONDS + 1), "-c:a", "pcm_s24le", str(sound)]
        done = subprocess.run([program, *source, *written], stderr=subprocess.PIPE, check=False)
        if done.returncode or done.stderr:
            said = shortened(done.stderr.decode(errors="replace").strip().partition("\n")[0], 200)
            raise ObjectFolderError(f"{path} cannot be decoded by ffmpeg ({said}); expected {FORMATS}")
        yield sound


def read_channels(file: "soundfile.SoundFile", path: Path, most: float = math.inf) -> np.ndarray:
    """Return the sound of an open file, (samples, channels), or its first ``most`` seconds.

    Raises ObjectFolderError if it holds less than its header says.
    """
    import soundfile

    rate, expected = file.samplerate, float(file.frames)
    for said, there in _SIZES.findall(file.extra_info):
        if int(there) < int(said) < UNKNOWN_SIZE:
            expected = max(expected, file.frames * int(said) / max(int(there), 1))
    failed: soundfile.LibsndfileError | None = None
    try:
        channels = file.read(int(min(file.frames, most * rate)), "float64", always_2d=True)
        found = len(channels)
    except soundfile.LibsndfileError as error:  # amid a block of FLAC
        failed, found = error, _readable(path)
    if (found or not failed) and found < min(expected, most * rate) - LENGTH_TOLERANCE * rate:
        raise ObjectFolderError(
            f"{path} is cut off or damaged: {found / rate:.2f} s can be read of the {expected / rate:.2f} s "
            "that its header says; copy or record it again, or save what is there as a new file"
        ) from failed
    if failed:
        raise failed
    return channels


def _readable(path: Path) -> int:
    """Return how many samples can be read of a file that has an error."""
    import soundfile

    found, block = 0, 1024
    with soundfile.SoundFile(path) as file:
        try:
            while count := len(file.read(block, always_2d=True)):
                found += count
        except soundfile.LibsndfileError:
            pass
    return found


def _lacks_end(path: Path) -> bool:
    """Return whether a file is of Ogg, whose last page is cut off or is not the last one of a stream."""
    with path.open("rb") as file:
        if file.read(4) != b"OggS":
            return False
        size = file.seek(0, io.SEEK_END)
        file.seek(max(size - _PAGE, 0))
        tail = file.read()
    page = tail[tail.rfind(b"OggS") :]
    sizes = page[27 : 27 + page[26]] if len(page) > 26 else b""
    return not (len(page) > 26 and page[5] & 4 and 27 + page[26] + sum(sizes) <= len(page))


def _sized(path: Path) -> io.BytesIO | None:
    """Return a WAV file with sizes in its header if its own have none; else None."""
    with path.open("rb") as file:
        head, whole = file.read(12), path.stat().st_size
        if len(head) < 12 or head[:4] != b"RIFF" or head[8:] != b"WAVE":
            return None
        if struct.unpack("<I", head[4:8])[0] == whole - 8:  # a file without sound says so, too
            return None
        while len(chunk := file.read(8)) == 8:
            name, size = struct.unpack("<4sI", chunk)
            start = file.tell()
            if name == b"data":
                if size or start == whole:
                    return None
                file.seek(0)
                data = bytearray(file.read())
                data[4:8], data[start - 4 : start] = (struct.pack("<I", whole - n) for n in (8, start))
                return io.BytesIO(data)
            file.seek(start + size + size % 2)
    return None


def loudest_channel(channels: np.ndarray, path: Path) -> np.ndarray:
    """Return the channel of a recording, (samples, channels), that has the highest peak; (samples,).

    Raises ObjectFolderError if a channel holds values that are not finite.
    """
    peaks = np.abs(channels).max(0, initial=0)
    if not np.isfinite(peaks).all():
        raise ObjectFolderError(
            f"{path} holds values that are not finite, expected numbers; export it again, or leave it out"
        )
    return channels[:, peaks.argmax()]


def resample_to_lowest(
    recordings: Sequence[tuple[np.ndarray, float]], names: Sequence[object] | None = None
) -> tuple[list[np.ndarray], float]:
    """Resample recordings, (samples,) of a rate in Hz each, to the lowest of their rates.

    Raises ObjectFolderError, with the names of the recordings, if the rates differ so much that high modes
    would be lost.
    """
    names = names or [f"recording {i}" for i in range(1, len(recordings) + 1)]
    rates = [rate for _, rate in recordings]
    lowest, highest = min(rates), max(rates)
    if highest > MAX_RATIO * lowest:
        raise ObjectFolderError(
            f"{names[rates.index(lowest)]} has {lowest:g} Hz, the others up to {highest:g} Hz; all are "
            f"brought to the lowest rate, and modes above {USABLE_BAND * lowest:.0f} Hz would be lost: leave "
            f"out recordings of {lowest:g} Hz"
        )
    return [resample_sound(sound, own, lowest) for sound, own in recordings], lowest


def resample_sound(sound: np.ndarray, own: float, rate: float) -> np.ndarray:
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
    return bool(piled) and _in_a_row(sound == highest, FLAT_TOP_RUN)
