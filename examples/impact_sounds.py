"""Strike an object, and fit its material to recordings that are made up here: docs/tutorials/sounds.md.

python CLONE/examples/impact_sounds.py build/red_mug/ObjectFile.safetensors out/sounds
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile
from matplotlib.figure import Figure

from objectfolder import ObjectFile
from objectfolder.base.materials import Material
from objectfolder.sound.fitting import fit_sound

RATE, SECONDS, IMPULSE, LISTENER = 48000, 1.5, 0.02, [[0.6, -0.6, 0.5]]  # Hz, s, N s, m
STIFFER, LOSS, HISS = 1.015, 0.003, 1e-3  # of the object on the recordings, and their noise in pascals


def main(file: Path, out: Path) -> None:
    """Write sounds, and taps to fit, as WAV, and sounds.webp."""
    thing = ObjectFile.load(file)
    points, _ = thing.nearest([*thing.scale / 2 * np.eye(3), *thing.sample_surface(6)])  # object frame, m
    impulses = -IMPULSE * points / np.linalg.norm(points, axis=1, keepdims=True)
    at, there, rng = (RATE, SECONDS), {"listener": LISTENER}, np.random.default_rng(0)
    sounds = dict(zip(("right", "back", "top"), thing.impact(points[:3], impulses[:3], *at, **there)))
    sounds["half"] = thing.impact(points[:1] / 2, impulses[:1], *at, scale=thing.scale / 2, **there)[0]
    for name, peak in ((name, abs(sound).max()) for name, sound in sounds.items()):
        print(f"{name}: peak {peak:.2f} Pa, {20 * np.log10(peak / 20e-6):.0f} dB")
    for name in ("steel", "wood"):  # without a listener: the summed accelerations of the modes
        sounds[name] = thing.impact(points[:1], impulses[:1], *at, "acceleration", material=name)[0]
    own = Material(thing.material, **thing.header["material_properties"])
    other = replace(own, youngs_modulus=STIFFER * own.youngs_modulus, loss_factor=[(1000, LOSS)])
    taps = thing.impact(points[3:], impulses[3:], *at, material=other, **there)
    taps = rng.normal(taps, HISS)
    fit = fit_sound(thing.frequencies, own, taps, RATE, "loss_factor")
    sounds |= {f"tap{number}": tap for number, tap in enumerate(taps, 1)}
    out.mkdir(parents=True, exist_ok=True)
    for name, sound in sounds.items():
        soundfile.write(out / f"{name}.wav", 0.9 * sound / abs(sound).max(), RATE)
    axes = (figure := Figure(figsize=(12, 11), layout="constrained")).subplots(4, 3)
    for place, (name, sound) in zip(axes.flat[:3], sounds.items()):
        place.plot(1000 * np.arange(960) / RATE, sound[:960], linewidth=0.7)
        place.set(title=name, xlabel="time, ms", ylabel="sound pressure, Pa")
    for place, (name, sound) in zip(axes.flat[3:10], sounds.items()):
        place.specgram(rng.normal(sound / abs(sound).max(), 1e-6), NFFT=512, Fs=RATE, noverlap=384)
        place.set(title=name, xlabel="time, s", ylabel="frequency, Hz", xlim=(0, 0.6), ylim=(0, 20000))
    match, hertz = fit.match, fit.heard.frequency[fit.match.heard]
    axes[3, 1].plot(hertz, hertz / thing.frequencies[match.computed] - 1, "o", hertz, match.residual, ".")
    axes[3, 1].set(title="o before, . after fit", xlabel="frequency, Hz", ylabel="recorded / computed - 1")
    axes[3, 2].semilogy(hertz, np.log(1000) / own.damping((2 * np.pi * hertz) ** 2), "x")
    axes[3, 2].semilogy(hertz, fit.heard.decay_time[match.heard], "o", hertz, fit.decay_time, ".")
    axes[3, 2].set(title="x built, o recorded, . fitted", xlabel="frequency, Hz", ylabel="T60, s")
    figure.savefig(out / "sounds.webp", pil_kwargs={"quality": 80})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
