"""Tap: objects of one look stand in a row, one of another material; find the odd one by tapping."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.voice import Voice
from objectfolder.sim import calls
from objectfolder.sim.drop import MATERIALS, SIZES
from objectfolder.sim.game import Game
from objectfolder.sim.sounding import require_audible
from objectfolder.sound.contact import contact_time, load_striker
from objectfolder.sound.stream import ModalStream, Pulse
from objectfolder.sound.synthesis import count_samples

SIZE_SPREAD = 0.03  #: greatest relative difference of a copy's size from that of the row
IMPULSES = 0.005, 0.02  #: range of a tap, N s
STRIKER = "wood"
COST = 0.02  #: of a tap
_EAR = np.array([0.5, -0.4, 0.4])  # m, from the tapped object


class TapEnv(Game):
    """Find the odd one by tapping, registered as ``ObjectFolder/Tap-v0``.

    **Observation**, a dict: ``sound`` of the last tap, (samples,) float32, Pa, silence at first; ``tapped``,
    the number of the object that was tapped, or ``count`` at first; ``taps``, how often each was, (count,).
    **Action**: i below ``count`` taps object i; ``count`` + i declares that i is the odd one, which ends the
    episode. **Reward**: 1 for declaring the odd one, 0 for another, -0.02 for a tap. The tap number ``limit``
    truncates the episode. ``info`` holds ``odd``, the right number; ``object``; ``material`` and ``other``,
    the numbers of the materials of the row and of the odd one; and ``scales`` (m).

    Each episode draws an object, two materials, the odd one's place, a size (0.8 to 1.25 times the object's
    own), and for each copy a size within 3 % of that, so that pitch alone does not tell. A tap is of a wooden
    tip at a drawn place, along the surface's normal, with a drawn impulse, and is heard 0.75 m away.

    Parameters
    ----------
    objects : sequence of str or ObjectFile
        Names of samples of the package, or Object Files; of different keys. One may stand for itself.
    materials : sequence of str
        At least two different ones.
    count : int
        Objects in the row, at least 3.
    seconds : float
        Of sound.
    sample_rate : float
        Hz.
    limit : int
        Greatest number of taps.

    Notes
    -----
    Taps use `ObjectFile.voice`, the modes that `objectfolder.sim.hearing.Hearing` plays, without a
    simulation: the objects hang free.
    """

    _changing = ("_episode", "_taps")

    def __init__(
        self, objects: "str | ObjectFile | Sequence[str | ObjectFile]" = ("mug", "die", "bell"),
        materials: Sequence[str] = MATERIALS, count: int = 4, seconds: float = 0.2,
        sample_rate: float = 48000, limit: int = 20,
    ):  # fmt: skip
        self.files = calls.open_files(objects)
        self.materials = calls.distinct_materials(materials, 2)
        self.count, self.limit = whole_number("count", count), whole_number("limit", limit)
        if self.count < 3 or self.limit < 1:
            raise ObjectFolderError(
                f"count is {count} and limit {limit}: expected at least 3 objects, since of two either is "
                "the odd one, and at least 1 tap"
            )
        self.sample_rate, self._samples = sample_rate, count_samples(sample_rate, seconds)
        require_audible(self.files, self.materials, SIZES[0] * (1 - SIZE_SPREAD), sample_rate)
        self._arguments = (self.files, self.materials, self.count, seconds, sample_rate, self.limit)
        self.observation_space = spaces.Dict(
            {
                "sound": spaces.Box(-calls.MAX_PRESSURE, calls.MAX_PRESSURE, (self._samples,), np.float32),
                "tapped": spaces.Discrete(self.count + 1),
                "taps": spaces.Box(0, self.limit, (self.count,), np.int64),
            }
        )
        self.action_space = spaces.Discrete(2 * self.count)
        self._episode = {}
        self._voices: dict[int, Voice] = {}
        self._taps = np.zeros(self.count, np.int64)

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        kind, odd = int(rng.integers(len(self.files))), int(rng.integers(self.count))
        stuff, other = (int(k) for k in rng.choice(len(self.materials), 2, replace=False))
        ratio = np.exp(rng.uniform(*np.log(SIZES)))
        scales = self.files[kind].scale * ratio * (1 + rng.uniform(-SIZE_SPREAD, SIZE_SPREAD, self.count))
        self._episode = {"odd": odd, "object": kind, "material": stuff, "other": other, "scales": scales}
        self._voices, self._taps = {}, np.zeros(self.count, np.int64)
        return self._observe(np.zeros(self._samples, np.float32), self.count), self._info()

    def step(self, action: int) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Tap an object, or declare one."""
        calls.require_reset(bool(self._episode))
        chosen = calls.check_action(action, 2 * self.count)
        info = self._info()
        if chosen >= self.count:
            right, self._episode = chosen - self.count == info["odd"], {}
            silence = np.zeros(self._samples, np.float32)
            return self._observe(silence, self.count), float(right), True, False, info
        sound = self._tap(chosen)
        self._taps = self._taps + (np.arange(self.count) == chosen)
        cut = int(self._taps.sum()) >= self.limit
        if cut:
            self._episode = {}
        return self._observe(sound, chosen), -COST, False, cut, info

    def _info(self) -> dict[str, Any]:
        return {**self._episode, "scales": self._episode["scales"].copy()}

    def _observe(self, sound: np.ndarray, tapped: int) -> dict[str, Any]:
        return {"sound": sound, "tapped": np.int64(tapped), "taps": self._taps.copy()}

    def _tap(self, number: int) -> np.ndarray:
        """Return the sound of a tap at a drawn place; (samples,) Pa."""
        file, rng, voice = self.files[self._episode["object"]], self.np_random, self._voice(number)
        surface = file.surface
        vertex = rng.integers(len(surface.vertices))
        point = surface.vertices[vertex] * voice.scale
        gains = voice.gains(point[None], -rng.uniform(*IMPULSES) * surface.normals[vertex][None])[0]
        lasting = contact_time(load_striker(STRIKER), voice.material, voice.mass)
        stream = ModalStream([voice.poles], self.sample_rate, self._samples, [voice.accelerated])
        stream.listen(0, voice.weights(_EAR))
        stream.strike(0, Pulse(0, lasting * self.sample_rate, gains))
        sound = stream.play(self._samples)
        return sound.astype(np.float32).clip(-calls.MAX_PRESSURE, calls.MAX_PRESSURE)

    def _voice(self, number: int) -> Voice:
        """Return the voice of an object of the row, made when it is first tapped."""
        if number not in self._voices:
            row = self._episode
            stuff = self.materials[row["other" if number == row["odd"] else "material"]]
            file = self.files[row["object"]]
            self._voices[number] = file.voice(self.sample_rate, stuff, float(row["scales"][number]))
        return self._voices[number]
