"""Draw docs/drop.webp, docs/push.webp and what is heard: `python docs/clips.py [drop] [push]`."""

import sys
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
from PIL import Image

from objectfolder import ObjectFile
from objectfolder.base.io import atomic
from objectfolder.sim.body import add_body, rigid_body
from objectfolder.sim.clip import SceneCamera, SceneView, Take, simulate
from objectfolder.sim.hearing import Hearing

mpl.use("Agg")
from matplotlib import pyplot

SECONDS, RATE, SIZE = 1.6, 15, (210, 280)
HERE = Path(__file__).parent
VIEW = SceneView(np.array([0.45, -0.75, 0.42]), np.array([0.0, 0.0, 0.11]), 36.0)

#: Scenes: place (m), axis and angle (degrees), velocity (m/s) of each object.
SCENES: dict[str, dict[str, tuple[list[float], list[float], list[float]]]] = {
    "drop": {
        "mug": ([-0.11, 0.0, 0.25], [0.3, 1, 0, 25], [0.1, 0, 0]),
        "bell": ([0.12, 0.02, 0.32], [1, 0.2, 0, 30], [-0.1, 0, 0]),
    },
    "push": {
        "mug": ([-0.18, 0.0, 0.0565], [0, 0, 1, 150], [1.8, 0, 0]),
        "bell": ([0.05, 0.0, 0.04], [0, 0, 1, 0], [0, 0, 0]),
    },
}


def taken(name: str) -> tuple[Take, SceneCamera]:
    """Simulate a scene."""
    spec = mujoco.MjSpec()
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(
        name="table", type=box, size=[0.4, 0.3, 0.02], pos=[0, 0, -0.02], rgba=[0.55, 0.4, 0.27, 1]
    )
    files = {key: ObjectFile.sample(key) for key in SCENES[name]}
    for key, (place, turn, _) in SCENES[name].items():
        body = add_body(spec, rigid_body(files[key], [files[key].to_mesh().convex_hull]), key)
        body.pos, angle = place, np.radians(turn[3]) / 2
        axis = np.array(turn[:3]) / np.linalg.norm(turn[:3])
        body.quat = [np.cos(angle), *np.sin(angle) * axis]
    model = spec.compile()
    data = mujoco.MjData(model)
    for key, (_, _, velocity) in SCENES[name].items():
        start = int(model.joint(key).dofadr[0])
        data.qvel[start : start + 3] = velocity
    mujoco.mj_forward(model, data)
    take = simulate(model, data, Hearing(model, files, VIEW.eye), SECONDS, RATE)
    return take, SceneCamera(model, files, VIEW, *SIZE)


def draw(name: str) -> None:
    """Draw the clip of a scene, and its sound."""
    take, camera = taken(name)
    frames = [Image.fromarray(picture) for picture in camera.pictures(take)]
    with atomic(HERE / f"{name}.webp") as path:
        frames[0].save(
            path,
            "WEBP",
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 / RATE),
            loop=0,
            quality=60,
        )
    figure, axis = pyplot.subplots(figsize=(4, 2.6), layout="constrained")
    quiet = 1e-6 * np.random.default_rng(0).standard_normal(len(take.sound))  # no logarithm of 0
    axis.specgram(take.sound + quiet, NFFT=1024, Fs=48000, noverlap=768, vmin=-150, vmax=-50)
    axis.set(xlabel="s", ylabel="Hz", ylim=(0, 20000))
    with atomic(HERE / f"{name}_sound.png") as path:
        figure.savefig(path, format="png", dpi=100)


def main() -> None:
    for name in sys.argv[1:] or SCENES:
        draw(name)


if __name__ == "__main__":
    main()
