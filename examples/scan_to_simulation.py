"""Drop an object onto a tactile sensor in MuJoCo; hear it, feel it, draw both: docs/tutorials/scan.md.

python CLONE/examples/scan_to_simulation.py build/red_mug/ObjectFile.safetensors out/drop
"""

import copy
import sys
from pathlib import Path

import mujoco
import numpy as np
import soundfile
from matplotlib.figure import Figure

from objectfolder import ObjectFile
from objectfolder.sim.body import add_body, as_rigid_body
from objectfolder.sim.clip import SceneCamera, SceneView
from objectfolder.sim.feeling import Feeling
from objectfolder.sim.hearing import Hearing

SECONDS, RATE, LISTENER = 1.5, 48000, [0.5, 0, 0.3]  # s, Hz, m


def main(file: Path, out: Path) -> None:
    """Write drop.wav and drop.webp, and the object's hulls."""
    thing, spec = ObjectFile.load(file), mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], rgba=[0.6, 0.5, 0.4, 1])
    sensor = spec.worldbody.add_body(pos=[0, 0, 0.02])
    sensor.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.016, 0.012, 0.01], pos=[0, 0, -0.01])
    sensor.add_site(name="gel", quat=[0.5**0.5, 0, -(0.5**0.5), 0])  # its x axis, out of the gel, is up
    body = add_body(spec, as_rigid_body(thing, out / "hulls"), "thing")
    body.pos, body.quat = [0, 0, 0.02 + 0.7 * thing.scale], [np.cos(0.3), 0, np.sin(0.3), 0]  # tilted
    model, sounds, states = spec.compile(), [], []
    data, hearing = mujoco.MjData(model), Hearing(model, {"thing": thing}, LISTENER, RATE)
    while data.time < SECONDS:
        sounds.append(hearing.simulate(data))
        states.append(copy.copy(data))
    sound, felt = np.concatenate(sounds), Feeling(model, "gel", {"thing": thing}).feel(states)
    peak, best = abs(sound).max(), felt.force[:, 0, 0].argmax()  # Pa; step of the strongest press
    soundfile.write(out / "drop.wav", 0.9 * sound / peak, RATE)
    print(f"loudest {peak:.2f} Pa ({20 * np.log10(peak / 20e-6):.0f} dB); press {felt.force.max():.1f} N")
    curves = ["height of the centre, mm", "press (blue), friction, N", "sound pressure, Pa", "frequency, Hz"]
    figure, times = Figure(figsize=(12, 9), layout="constrained"), [state.time for state in states]
    axes = figure.subplot_mosaic([[name, "scene" if name in curves[:2] else "gel"] for name in curves])
    axes[curves[0]].plot(times, [1000 * state.body("thing").xpos[2] for state in states])
    axes[curves[1]].plot(times, felt.force[:, 0, 0], times, np.hypot(*felt.force[:, 0, 1:].T))
    axes[curves[2]].plot(np.arange(len(sound)) / RATE, sound, linewidth=0.5)
    axes[curves[3]].specgram(np.random.default_rng(0).normal(sound, 2e-5), NFFT=1024, Fs=RATE, noverlap=768)
    for name in curves:
        axes[name].set(xlabel="time, s", ylabel=name, xlim=(0, SECONDS))
    view = SceneView(thing.scale * np.array([2.2, -3, 2]), thing.scale * np.array([0, 0, 0.5]), 25)
    seen = SceneCamera(model, {"thing": thing}, view, 360, 480).picture(states[best])
    for name, picture in (("scene", seen), ("gel", felt.images[best, 0])):
        axes[name].imshow(picture)
        axes[name].set(xticks=[], yticks=[], title=f"{name} at the strongest press")
    figure.savefig(out / "drop.webp", pil_kwargs={"quality": 80})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
