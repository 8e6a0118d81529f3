"""Draw docs/strikes.webp, of the samples mug, bell and die: `python docs/strikes.py [FOLDER]`.

One strike of each: summed displacements, what its modes send to a listener, and the click added. FOLDER
receives the nine sounds as WAV.
"""

import sys
from pathlib import Path

import numpy as np
import soundfile
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from scipy.signal import ShortTimeFFT

from objectfolder import ObjectFile
from objectfolder.base.figures import page
from objectfolder.sound.click import recoil_pressure

RATE, SECONDS = 44100, 1.0
LISTENER = np.array([[0.6, -0.6, 0.5]])  # metres
BEFORE, SHOWN = 0.005, 0.1  # seconds of silence, and of the whole picture
RANGE = 70  # dB
WINDOW, HOP = 256, 32


def strike(obj: ObjectFile) -> dict[str, np.ndarray]:
    """Return the sounds of one strike of 10 mN s against the surface."""
    point = obj.sample_surface(1, seed=4)
    impulse = -0.01 * point / np.linalg.norm(point)
    played = {"sample_rate": RATE, "duration": SECONDS}
    heard = obj.impact(point, impulse, listener=LISTENER, **played)[0]
    density = obj._parts.audio.own_material.density
    body = obj._parts.radiation.recoil(density, obj.scale)
    click = recoil_pressure(body, impulse, LISTENER, RATE, len(heard), obj.contact_time())[0]
    return {
        "summed displacements": obj.impact(point, impulse, **played)[0],
        "pressure, modes only": heard - click,
        "pressure with the click": heard,
    }


def decibels(sound: np.ndarray) -> np.ndarray:
    """Return the spectrogram of a sound after some silence, dB below its peak; (frequencies, times)."""
    padded = np.concatenate([np.zeros(round(BEFORE * RATE)), sound])
    transform = ShortTimeFFT(np.hanning(WINDOW), HOP, RATE, mfft=1024)
    level = abs(transform.stft(padded, p0=0, p1=round(SHOWN * RATE / HOP)))
    return 20 * np.log10(np.maximum(level / level.max(), 10 ** (-RANGE / 20)))


def main(folder: Path | None) -> None:
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
    figure = page(9.5, 6.6, "One strike: no air, a listener, and the click (70 dB below each peak)")
    rows = figure.subplots(3, 3, sharex=True, sharey=True)
    for axes, key in zip(rows, ("mug", "bell", "die")):
        for place, (name, sound) in zip(axes, strike(ObjectFile.sample(key)).items()):
            extent = (-1000 * BEFORE, 1000 * (SHOWN - BEFORE), 0, RATE / 2000)
            place.imshow(decibels(sound), origin="lower", aspect="auto", extent=extent, cmap="magma")
            place.set_title(f"{key}: {name}", fontsize=9)
            if folder:
                path = folder / f"{key}_{name.replace(', ', '_').replace(' ', '_')}.wav"
                soundfile.write(path, 0.9 * sound / np.abs(sound).max(), RATE)
        axes[0].set_ylabel("kHz")
    for place in rows[-1]:
        place.set_xlabel("ms after the strike")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    picture.save(Path(__file__).with_suffix(".webp"), quality=80, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
