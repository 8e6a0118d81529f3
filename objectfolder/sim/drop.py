"""Drop: an object falls onto a table unseen; tell by ear which one it was, and of what material."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import material
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.body import add_body, density, rigid_body, rotation, scaled_body
from objectfolder.sim.game import Game
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.sounding import Sounding, require_audible
from objectfolder.sound.synthesis import count_samples

MATERIALS = ("ceramic", "glass", "wood", "plastic", "steel")
HEIGHTS = 0.1, 0.4  #: range of the fall, m
SIZES = 0.8, 1.25  #: range of the size, of the object's own
_EAR = np.array([0.5, -0.4, 0.4])  # m


class DropEnv(Game):
    """One unseen fall, registered as ``ObjectFolder/Drop-v0``.

    **Observation**: the sound of the fall, from the first contact, (samples,) float32, Pa.
    **Action**: the numbers of the object and of the material. **Reward**: half for each that is right. An
    episode has one step. ``info`` of both holds ``object`` and ``material``, the right numbers, ``scale`` (m)
    and ``height`` (m): the oracle's.

    Each episode draws an object, its material, its size (0.8 to 1.25 times its own), the height of the fall
    (0.1 to 0.4 m), its orientation and its spin. Objects collide as their convex hulls. Modes of other
    materials are those of `ObjectFile.tuning`.

    Parameters
    ----------
    objects : sequence of str or ObjectFile
        Names of samples of the package, or Object Files; of different keys. One may stand for itself.
    materials : sequence of str
        Different ones, or a single one.
    seconds : float
        Of sound.
    sample_rate : float
        Hz.
    """

    _changing = ("_episode",)

    def __init__(
        self, objects: "str | ObjectFile | Sequence[str | ObjectFile]" = ("mug", "die", "bell"),
        materials: str | Sequence[str] = MATERIALS, seconds: float = 0.5, sample_rate: float = 48000,
    ):  # fmt: skip
        self.files = calls.open_files(objects)
        self.materials = calls.distinct_materials(materials)
        self._arguments = (self.files, self.materials, seconds, sample_rate)
        self._rate, self._samples = sample_rate, count_samples(sample_rate, seconds)
        require_audible(self.files, self.materials, SIZES[0], sample_rate)
        self._bodies = [rigid_body(file, [file.to_mesh().convex_hull]) for file in self.files]
        loudest = calls.MAX_PRESSURE
        self.observation_space = spaces.Box(-loudest, loudest, (self._samples,), np.float32)
        self.action_space = spaces.MultiDiscrete([len(self.files), len(self.materials)])
        self._episode = {}

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        kind, stuff = int(rng.integers(len(self.files))), int(rng.integers(len(self.materials)))
        ratio = float(np.exp(rng.uniform(*np.log(SIZES))))
        height, turn, spin = rng.uniform(*HEIGHTS), rng.normal(size=4), rng.normal(size=3)
        scale = ratio * self.files[kind].scale
        self._episode = {"object": kind, "material": stuff, "scale": scale, "height": float(height)}
        return self._simulate(ratio, height, turn / np.linalg.norm(turn), spin), dict(self._episode)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Answer; the episode ends."""
        calls.require_reset(bool(self._episode))
        if not self.action_space.contains(np.asarray(action)):
            raise ObjectFolderError(
                f"action is {quoted(action)}, expected the numbers of an object below {len(self.files)} "
                f"and of a material below {len(self.materials)}"
            )
        info, self._episode = self._episode, {}
        right = [int(action[0]) == info["object"], int(action[1]) == info["material"]]
        return np.zeros(self._samples, np.float32), sum(right) / 2, True, False, info

    def _simulate(self, ratio: float, height: float, turn: np.ndarray, spin: np.ndarray) -> np.ndarray:
        """Simulate a fall and return its sound from the first contact on."""
        file, stuff = self.files[self._episode["object"]], self.materials[self._episode["material"]]
        own, made = self._bodies[self._episode["object"]], material(stuff)
        body = replace(scaled_body(own, ratio, made.density / density(file)), friction=made.friction)
        spec, plane = mujoco.MjSpec(), mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(type=plane, size=[5, 5, 0.1], friction=[made.friction, 0.005, 0.0001])
        fallen = add_body(spec, body, "object")
        low = (body.points @ rotation(turn).T)[:, 2].min()
        fallen.pos, fallen.quat = [0, 0, height - low], turn
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qvel[3:] = spin
        objects = {"object": Sounding(file, stuff, ratio * file.scale)}
        hearing = Hearing(model, objects, _EAR, self._rate)
        # Silent until the lowest point that its spin may turn down has fallen to the floor.
        centre = height - low + (rotation(turn) @ body.centre)[2]
        fall = max(centre - np.linalg.norm(body.points - body.centre, axis=1).max(), 0.0)
        skipped = int(np.sqrt(2 * fall / 9.81) / model.opt.timestep) - 5
        mujoco.mj_step(model, data, max(skipped, 0))
        hearing.reset(data)
        sound = np.zeros(0, np.float32)
        while len(sound) < self._samples:
            new = hearing.simulate(data)
            sound = np.concatenate([sound, new]) if len(sound) or new.any() else sound
        start = np.flatnonzero(sound)[0]
        while len(sound) < start + self._samples:
            sound = np.concatenate([sound, hearing.simulate(data)])
        return sound[start : start + self._samples].clip(-calls.MAX_PRESSURE, calls.MAX_PRESSURE)
