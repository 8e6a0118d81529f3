"""Gymnasium wrapper that adds what is heard and felt to the observations of a MuJoCo environment."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces

from objectfolder.base.checks import finite_number, require_memory
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.sim.calls import MAX_PRESSURE
from objectfolder.sim.feeling import Feeling, pad_names
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.sounding import Objects, name_objects
from objectfolder.sound.synthesis import checked_sample_rate
from objectfolder.touch.profiles import SensorProfile

TIME_TOLERANCE = 1e-6  # s, by which simulation and hearing differ by rounding


class Senses(gymnasium.Wrapper[dict[str, Any], Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Adds ``audio`` and ``touch`` to the observations of an environment.

    The observation is a dict: the environment's own entries, or its observation as ``observation``;
    ``audio``, the last ``seconds`` of sound, (samples,) float32, Pa; ``touch``, images of the pads,
    (P, H, W, 3) uint8.

    Parameters
    ----------
    env : gymnasium.Env
        With the attributes ``model`` and ``data``, as those of gymnasium and of this package. It is heard if
        it steps by its own ``mj_step(model, data, nstep=1)``: an attribute with the function of MuJoCo, whose
        place the listening step takes during `step`.
    objects : mapping or iterable
        See `objectfolder.sim.hearing.Hearing`.
    listener : str or (3,) array, optional
        Site or place of the ear; None for no ``audio``.
    pads : sequence of str
        Sites of tactile sensors; none for no ``touch``.
    seconds : float
        Of sound in an observation.
    sample_rate : float
        Hz.
    sensor : str or SensorProfile
        Of the pads.
    audio, touch : str
        Names of the entries. Two ears are two wrappers, around each other, with a name each.
    intercept : bool
        Hear an environment without such an attribute, as gymnasium's, that calls ``mujoco.mj_step``: the
        function of the module is replaced during `step`, and put back after it. Such environments of one
        process must not step in several threads.

    Raises
    ------
    ObjectFolderError
        If the environment has no model and data, no ``mj_step`` to be heard by, or an entry of the same name,
        there is neither a listener nor a pad, or an argument is wrong. `reset` and `step` raise it as
        `Hearing` and `Feeling` do.

    Examples
    --------
    >>> env = gymnasium.make("objectfolder.sim:ObjectFolder/Reach-v0", file="mug.safetensors")
    >>> env = Senses(env, {"object": ObjectFile.load("mug.safetensors")}, listener=[0, 0.4, 0.4])
    >>> env.reset(seed=0)[0]["audio"].shape
    (4800,)
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], objects: Objects,
        listener: "str | Sequence[float] | np.ndarray | None" = None, pads: Sequence[str] = (),
        seconds: float = 0.1, sample_rate: float = 48000, sensor: "str | SensorProfile" = "digit",
        audio: str = "audio", touch: str = "touch", intercept: bool = False,
    ):  # fmt: skip
        objects, pads = name_objects(objects), pad_names(pads)
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, objects=objects, listener=listener, pads=pads, seconds=seconds, sample_rate=sample_rate,
            sensor=sensor, audio=audio, touch=touch, intercept=intercept, _disable_deepcopy=True,
        )  # fmt: skip
        inner: Any = getattr(env, "unwrapped", env)
        if not isinstance(getattr(inner, "model", None), mujoco.MjModel) or not hasattr(inner, "data"):
            raise ObjectFolderError(
                f"{type(inner).__name__} has no model and data of MuJoCo; expected an environment with both, "
                "such as those of gymnasium's MuJoCo and of objectfolder.sim"
            )
        super().__init__(env)
        if listener is None and not pads:
            raise ObjectFolderError(
                "there is neither a listener nor a pad: give the name of a site to either"
            )
        own_step = callable(getattr(inner, "mj_step", None))
        if listener is not None and not own_step and not intercept:
            raise ObjectFolderError(
                f"{type(inner).__name__} has no mj_step by which it could be heard: let it step by an "
                "attribute of this name, mj_step = staticmethod(mujoco.mj_step); or, if it calls "
                "mujoco.mj_step, give intercept=True"
            )
        self._stepper: Any = inner if own_step else mujoco  #: whose ``mj_step`` is replaced during `step`
        model = inner.model
        self._hearing = None if listener is None else Hearing(model, objects, listener, sample_rate)
        self._feeling = Feeling(model, pads, objects, sensor) if pads else None
        self._audio, self._touch = audio, touch
        samples = round(finite_number("seconds", seconds) * checked_sample_rate(sample_rate))
        if samples < 1:
            raise ObjectFolderError(f"seconds is {seconds!r}, expected at least one sample of sound")
        require_memory(f"seconds is {seconds:g}", 4 * samples, "ask for fewer")
        self._sound = np.zeros(samples, np.float32)
        added: list[tuple[str, spaces.Space[Any]]] = []
        if self._hearing:
            added.append((audio, spaces.Box(-MAX_PRESSURE, MAX_PRESSURE, (samples,), np.float32)))
        if self._feeling:
            shape = (len(pads), self._feeling.profile.height, self._feeling.profile.width, 3)
            added.append((touch, spaces.Box(0, 255, shape, np.uint8)))
        own = env.observation_space
        entries = {**own.spaces} if isinstance(own, spaces.Dict) else {"observation": own}
        for name, space in added:
            if not isinstance(name, str) or not name:
                raise ObjectFolderError(f"{quoted(name)} is not the name of an entry, expected a text")
            if name in entries:
                raise ObjectFolderError(
                    f"the observation has an entry {name!r} already; give another name by audio= or touch="
                )
            entries[name] = space
        self.observation_space = spaces.Dict(entries)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, in silence."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._sound = np.zeros_like(self._sound)
        if self._hearing:
            self._hearing.reset(self._data)
        return self._add_senses(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, and hear each step of its simulation."""
        if self._hearing is None:
            observation, *rest = self.env.step(action)
        else:
            with _replaced_step(self._stepper, self._hear):
                observation, *rest = self.env.step(action)
            if abs(unheard := self._data.time - self._hearing.time) > TIME_TOLERANCE:
                raise ObjectFolderError(
                    f"{type(self.env.unwrapped).__name__} simulated {unheard:g} s that were not heard: step "
                    "by its mj_step, or with intercept=True by mujoco.mj_step, called by that name, or use "
                    "Hearing without this wrapper"
                )
        return self._add_senses(observation), *rest  # type: ignore[return-value]

    @property
    def _data(self) -> mujoco.MjData:
        data = self.env.unwrapped.data  # type: ignore[attr-defined]
        if not isinstance(data, mujoco.MjData):
            name = type(self.env.unwrapped).__name__
            raise ObjectFolderError(f"data of {name} is {quoted(data)}, expected a mujoco.MjData")
        return data

    def _add_senses(self, observation: Any) -> dict[str, Any]:
        seen = dict(observation) if isinstance(observation, dict) else {"observation": observation}
        if self._hearing:
            seen[self._audio] = self._sound.clip(-MAX_PRESSURE, MAX_PRESSURE)
        if self._feeling:
            seen[self._touch] = self._feeling.feel(self._data).images
        return seen

    def _hear(self, data: mujoco.MjData) -> None:
        """Listen to a step, if it was one of the environment's simulation."""
        if data is self._data and self._hearing:
            sound = self._hearing.hear(data)
            self._sound = np.concatenate([self._sound, sound])[-len(self._sound) :]


@contextmanager
def _replaced_step(owner: Any, hear: Callable[[mujoco.MjData], None]) -> Iterator[None]:
    """Replace ``mj_step`` of an environment, or of the module ``mujoco``, by one that then calls ``hear``."""
    made, own = owner.mj_step, "mj_step" in vars(owner)

    def step(model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
        for _ in range(nstep):
            made(model, data)
            hear(data)

    owner.mj_step = step
    try:
        yield
    finally:
        if own:
            owner.mj_step = made
        else:
            del owner.mj_step  # the class has it
