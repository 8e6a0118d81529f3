"""Pictures and sounds of a report, as data URIs."""

import base64
import io

import numpy as np
import soundfile
from PIL import Image

from objectfolder.audio.spectrogram import DYNAMIC_RANGE, HOP, SAMPLE_RATE, magnitudes
from objectfolder.figures import ENLARGED
from objectfolder.objectfile.file import ObjectFile

QUALITY = 80  # of WebP
FULL_RATE = 48000  # Hz, of sounds with modes above 8 kHz
SHOWN_SECONDS = (0.1, 0.2, 0.5, 1.0)  # of a spectrogram: the shortest in which the sound decays


def playing_rate(file: ObjectFile) -> int:
    """Return 16 kHz if that holds every mode of a file, or the file stores spectrograms, else 48 kHz."""
    high = file.has_modes and (file.frequencies >= SAMPLE_RATE / 2).any()
    return FULL_RATE if high else SAMPLE_RATE


def picture_uri(image: np.ndarray) -> str:
    """Return an (H, W, 3) image, float in [0, 1] or uint8, as WebP."""
    if image.dtype != np.uint8:
        image = (image * 255).round().astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=QUALITY, method=6)
    return _uri("image/webp", buffer)


def sound_uri(sound: np.ndarray, peak: float, rate: int) -> str:
    """Return a (samples,) sound at ``rate`` samples per second, of which ``peak`` is full scale, as FLAC."""
    buffer = io.BytesIO()
    scaled = 0.9 * sound / peak if peak > 0 else sound
    soundfile.write(buffer, scaled.clip(-1, 1), rate, format="FLAC", subtype="PCM_16")
    return _uri("audio/flac", buffer)


def beside(truth: np.ndarray | None, answer: np.ndarray) -> np.ndarray:
    """Join truth, answer and their difference, dark on white, in a row; (H, W, 3) in [0, 1] each."""
    if truth is None:
        return answer
    return np.concatenate([truth, answer, 1 - (ENLARGED * np.abs(answer - truth)).clip(0, 1)], 1)


def spectrograms(truth: np.ndarray | None, answer: np.ndarray, rate: int) -> tuple[np.ndarray, float]:
    """Draw spectrograms of truth, answer and difference in a row: (H, W, 3) in [0, 1], and their seconds.

    Decibels are relative to the peak of the truth.
    """
    from matplotlib import colormaps

    sounds = [answer] if truth is None else [truth, answer, answer - truth]
    levels = [magnitudes(sound)[::-1] for sound in sounds]
    top = levels[0].max()
    floor = 10 ** (-DYNAMIC_RANGE / 20)
    ringing = np.flatnonzero(levels[0].max(0) > floor * top)
    lasts = ringing.max(initial=0) * HOP / rate
    seconds = next((shown for shown in SHOWN_SECONDS if shown > lasts), SHOWN_SECONDS[-1])
    levels = [level[:, : round(seconds * rate / HOP)] for level in levels]
    shown = [
        20 * np.log10(np.maximum(level / (top if top > 0 else 1), floor)) / DYNAMIC_RANGE + 1
        for level in levels
    ]
    gap = np.ones((len(shown[0]), 2))
    panels = [part for level in shown for part in (gap, level)][1:]
    return np.asarray(colormaps["magma"](np.concatenate(panels, 1)))[..., :3], seconds


def _uri(kind: str, buffer: io.BytesIO) -> str:
    return f"data:{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"
