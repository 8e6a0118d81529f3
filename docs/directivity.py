"""Draw docs/directivity.png, of the samples mug and bell: `python docs/directivity.py [FOLDER]`.

Directivities of two modes, and one strike without and with a listener; FOLDER receives its sounds as WAV.
"""

import sys
from pathlib import Path

import numpy as np
import soundfile

from objectfolder import ObjectFile
from objectfolder.base.figures import page, page_rows, save_page
from objectfolder.report.inspect_sound import show_directivity
from objectfolder.sound.spectrogram import SAMPLE_RATE, show_spectrogram

MODES = {"mug": 4, "bell": 2}
LISTENER = [[0.6, -0.6, 0.5]]


def main(folder: Path | None) -> None:
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
    figure = page(13, 8.5, "Radiation: two directivities (dB below the loudest), one strike before and after")
    upper, lower = page_rows(figure, 1, 1)
    for axes, (key, mode) in zip(upper.subplots(1, 2), MODES.items()):
        obj = ObjectFile.sample(key)
        field = obj._parts.radiation.field
        shown = show_directivity(axes, field, mode, f"{key}: mode at {obj.frequencies[mode]:.0f} Hz")
    upper.colorbar(shown, ax=upper.axes, label="dB", shrink=0.7)
    mug = ObjectFile.sample("mug")
    point = mug.sample_surface(1, seed=4)
    sounds = {
        "summed displacements": mug.impact(point, [[0.006, 0.005, 0.007]])[0],
        "sound pressure": mug.impact(point, [[0.006, 0.005, 0.007]], listener=LISTENER)[0],
    }
    for axes, (name, sound) in zip(lower.subplots(1, 2), sounds.items()):
        show_spectrogram(axes, sound[: SAMPLE_RATE // 2], f"mug: {name}")
        if folder:
            peak = np.abs(sound).max()
            soundfile.write(folder / f"{name.replace(' ', '_')}.wav", 0.9 * sound / peak, SAMPLE_RATE)
            print(f"{name}: peak {peak:.3g}")
    save_page(figure, Path(__file__).with_suffix(".png"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
