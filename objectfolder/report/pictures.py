"""Pictures and sounds of a report, as data URIs."""

import base64
import io

import numpy as np
import soundfile
from PIL import Image

from objectfolder.objectfile.file import ObjectFile
from objectfolder.sound.spectrogram import SAMPLE_RATE

QUALITY = 80  # of WebP
FULL_RATE = 48000  # Hz, of sounds with modes above 8 kHz


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
    scaled = 0.9 * sound / peak if peak > 0 else sound
    return flac_uri(scaled.clip(-1, 1), rate)


def flac_uri(sound: np.ndarray, rate: int) -> str:
    """Return a (samples,) sound in [-1, 1] as FLAC."""
    buffer = io.BytesIO()
    soundfile.write(buffer, sound, rate, format="FLAC", subtype="PCM_16")
    return _uri("audio/flac", buffer)


def _uri(kind: str, buffer: io.BytesIO) -> str:
    return f"data:{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"
