"""Grasping one object by touch: the environment ``ObjectFolder/Grasp-v0`` (supplementary I.4).

An episode has two steps. Before each, the jaws close gently, both fingers feel the object, and the jaws open
again; the action moves the hand. After the second step the jaws close, and the hand lifts and holds: reward 1
if the object is held. Where the open gripper would collide with the object, the grasp fails.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from objectfolder.base.checks import one_of, whole_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.body import Hulls
from objectfolder.sim.camera import ExternalCamera
from objectfolder.sim.features import CONTRAST, FeatureFunction, TouchFeatures
from objectfolder.sim.fingers import Presses
from objectfolder.sim.game import Game
from objectfolder.sim.grasp_scene import lowest_hand
from objectfolder.sim.grasp_task import STEPS, GraspTask, make_task
from objectfolder.sim.gripper import STROKE

OBSERVATIONS = ("features", "tactile", "images", "width", "blind")
STATE = 3  #: size of the state that is observed beside touches: step, height, opening


class GraspEnv(Game):
    """One object and one gripper with two tactile sensors.

    ``gymnasium.make("objectfolder.sim:ObjectFolder/Grasp-v0", file="build/mug/ObjectFile.safetensors")``

    Observation (float32): features of the left and the right finger's tactile images, the number of the step,
    the height of the hand, and the opening of the jaws in contact. Action: dx, dy, dz, dphi in [-1, 1], in
    units of `objectfolder.sim.grasp_task.ACTION_SCALE`. Reward: 1 if the object is held after the last step,
    else 0.

    Parameters
    ----------
    file : ObjectFile or path
    observation : {"features", "tactile", "images", "width", "blind"}
        tactile: features of both images alone; images: a dict with the images themselves, and the state;
        width: the state alone; blind: the same without the opening of the jaws.
    hulls : path or sequence of trimesh.Trimesh, optional
        Folder in which convex hulls are cached, or the hulls, object frame, m; default: a folder of the
        user's.
    render_mode : {None, "rgb_array"}

    Raises
    ------
    ObjectFolderError
        If the object does not fit the gripper, or the file lacks touch; on a step after the end of an
        episode; otherwise as `objectfolder.sim.game.Game`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self, file: ObjectFile | str | Path, observation: str = "features", hulls: Hulls = None,
        render_mode: str | None = None,
    ):  # fmt: skip
        self._arguments = (file, observation, hulls, render_mode)
        self.render_mode = calls.check_render_mode(render_mode)
        one_of("observation", observation, OBSERVATIONS)  # before hulls are computed
        self._episodes = Episodes(make_task(calls.object_file(file), hulls), observation)
        self.observation_space = self._episodes.space()
        self.action_space = spaces.Box(-1, 1, (4,), np.float32)

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        return _first(self._episodes.begin(1, rng)), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move the hand, and grasp after the last step."""
        self._episodes.check_running()
        reward = float(self._episodes.act(calls.check_actions(action, (4,))[None])[0])
        done = self._episodes.step >= STEPS
        info = {"success": bool(reward)} if done else {}
        return _first(self._episodes.observe()), reward, done, False, info

    def render(self) -> np.ndarray | None:
        """Return the external camera's picture, (256, 256, 3) uint8; None without ``render_mode``."""
        if self.render_mode is None:
            return None
        calls.require_reset(len(self._episodes.hands) > 0)
        return self._episodes.picture(0)

    def __reduce__(self) -> tuple[Any, ...]:
        made, arguments, kept = super().__reduce__()
        of = self._episodes  # places and hands are never changed in place, so that a copy may share them
        return made, arguments, (kept, (of.objects, of.hands, of.step))

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Restore the episode and the random generator of a pickle."""
        kept, (self._episodes.objects, self._episodes.hands, self._episodes.step) = state
        self.__dict__ |= kept


class GraspVectorEnv(gymnasium.vector.VectorEnv[Any, np.ndarray, np.ndarray]):
    """Many episodes of one object, simulated together; otherwise as `GraspEnv`.

    All episodes end in the same step, which returns the first observations of the next episodes (autoreset
    mode SAME_STEP). ``info`` then has ``final_obs`` and ``final_info`` as gymnasium's own vector environments
    have them, and ``success`` once more beside them.

    Parameters
    ----------
    num_envs : int
    file : ObjectFile or path
    observation : str
    hulls : path or sequence of trimesh.Trimesh, optional
    task : GraspTask, optional
        Used instead of ``file`` and ``hulls``.
    features : callable, optional
        Replaces queries of the Object File; a `objectfolder.sim.features.TouchBank` is fast.
    render_mode : {None, "rgb_array"}

    Raises
    ------
    ObjectFolderError
        As `GraspEnv`, or if neither a file nor a task is given, or a reset has another number of seeds.
    """

    metadata = {  # noqa: RUF012
        "autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 2,
    }

    def __init__(
        self, num_envs: int = 1, file: ObjectFile | str | Path | None = None, observation: str = "features",
        hulls: Hulls = None, task: GraspTask | None = None, features: FeatureFunction | None = None,
        render_mode: str | None = None,
    ):  # fmt: skip
        self.render_mode = calls.check_render_mode(render_mode)
        one_of("observation", observation, OBSERVATIONS)
        if task is None:
            if file is None:
                raise ObjectFolderError("Grasp-v0 needs an Object File: file=...")
            task = make_task(calls.object_file(file), hulls)
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self._generators: list[np.random.Generator] = []  #: one for each environment, or none
        self._episodes = Episodes(task, observation, features)
        self.single_observation_space = self._episodes.space()
        self.single_action_space = spaces.Box(-1, 1, (4,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes anew.

        A seed is one of all environments, whose generator serves them all; or one for each, which then draws
        what `GraspEnv` draws with that seed. None leaves generators as they are.
        """
        calls.refuse_options(options)
        if isinstance(seed, list | tuple | np.ndarray):
            self._generators = self._seed([*seed])
        elif seed is not None:
            super().reset(seed=whole_number("seed", seed))
            self._generators = []
        return self._begin(), {}

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Move all hands; after the last step grasp, and start anew."""
        self._episodes.check_running()
        rewards = self._episodes.act(calls.check_actions(actions, (self.num_envs, 4)))
        ended = np.full(self.num_envs, self._episodes.step >= STEPS)
        observed, info = self._episodes.observe(), {}
        if ended.all():
            last = np.empty(self.num_envs, object)
            last[:] = [*gymnasium.vector.utils.iterate(self.observation_space, observed)]
            success = {"success": rewards > 0, "_success": ended}
            info = {"final_obs": last, "_final_obs": ended, "final_info": success, "_final_info": ended}
            info |= success
            observed = self._begin()
        return observed, rewards, ended, np.zeros(self.num_envs, bool), info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return the external camera's pictures, (256, 256, 3) uint8; None without ``render_mode``."""
        if self.render_mode is None:
            return None
        calls.require_reset(len(self._episodes.hands) > 0)
        return tuple(self._episodes.picture(row) for row in range(self.num_envs))

    def _begin(self) -> Any:
        if self._generators:
            return self._episodes.begin(1, *self._generators)
        return self._episodes.begin(self.num_envs, self.np_random)

    def _seed(self, seeds: Sequence[int | None]) -> list[np.random.Generator]:
        """Return a generator for each environment; without a seed, it keeps the one that it has."""
        if len(seeds) != self.num_envs:
            raise ObjectFolderError(
                f"seed is {quoted(seeds)}, expected one, or one for each of {self.num_envs} environments"
            )
        numbers = [None if seed is None else whole_number("seed", seed) for seed in seeds]
        new = [gymnasium.utils.seeding.np_random(number)[0] for number in numbers]
        kept = self._generators or new
        return [new[k] if seeds[k] is not None else kept[k] for k in range(self.num_envs)]


def _first(observation: Any) -> Any:
    """Return the observation of the first episode."""
    if isinstance(observation, dict):
        return {name: values[0] for name, values in observation.items()}
    return observation[0]


@dataclass
class Episodes:
    """N episodes side by side, shared by the single and the vector environment."""

    task: GraspTask
    observation: str  #: one of ``OBSERVATIONS``
    features: FeatureFunction | None = None  #: default: queries of the Object File
    objects: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  #: (N, 3) x, y, yaw
    hands: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  #: (N, 4) x, y, z, yaw
    step: int = 0

    def __post_init__(self) -> None:
        one_of("observation", self.observation, OBSERVATIONS)
        if self.features is None and self.observation in ("features", "tactile", "images"):
            self.features = TouchFeatures(self.task.file)

    def space(self) -> spaces.Space[Any]:
        """Return the observation space of one episode."""
        state = spaces.Box(-CONTRAST, CONTRAST, (STATE,), np.float32)
        if self.observation == "images":
            profile = self.task.file.sensor_profile
            shape = (2, profile.height, profile.width, 3)
            return spaces.Dict({"touch": spaces.Box(0, 255, shape, np.uint8), "state": state})
        if self.observation in ("features", "tactile"):
            size = 2 * TouchFeatures.size + STATE * (self.observation == "features")
            return spaces.Box(-CONTRAST, CONTRAST, (size,), np.float32)
        return state

    def begin(self, count: int, *generators: np.random.Generator) -> Any:
        """Start new episodes, ``count`` with each generator, and return their observations."""
        begun = [self.task.start(count, rng) for rng in generators]
        self.objects, self.hands = (np.concatenate(places) for places in zip(*begun))
        self.step = 0
        return self.observe()

    def check_running(self) -> None:
        """Raise ObjectFolderError unless the episodes have begun and not ended."""
        calls.require_reset(len(self.hands) > 0)
        if self.step >= STEPS:
            raise ObjectFolderError(f"the episode has ended after {STEPS} steps; call reset()")

    def act(self, actions: np.ndarray) -> np.ndarray:
        """Move the hands, and grasp after the last step; rewards (N,)."""
        self.hands = self.task.move(self.hands, actions)
        self.step += 1
        if self.step < STEPS:
            return np.zeros(len(self.hands))
        return self.task.grasp(self.objects, self.hands).astype(np.float64)

    def observe(self) -> Any:
        """Return the observations of all episodes."""
        if self.observation == "blind":
            return self._state(np.zeros(len(self.hands)))
        touch = self.task.touch(self.objects, self.hands)
        state = self._state(touch.width)
        if self.observation == "width":
            return state
        rows = np.flatnonzero(touch.touched.ravel())
        pressed = touch.presses.take(rows)
        if self.observation == "images":
            return {"touch": self._images(rows, pressed), "state": state}
        features = self._features(rows, pressed)
        return features if self.observation == "tactile" else np.concatenate([features, state], 1)

    def picture(self, row: int) -> np.ndarray:
        """Draw an episode as seen by the external camera; (256, 256, 3) uint8."""
        place, hand = self.objects[row], self.hands[row]
        width = self.task.touch(place[None], hand[None]).width[0] or STROKE
        return ExternalCamera(256).picture(self.task.file, self.task.place_object(place), hand, width)

    def _state(self, width: np.ndarray) -> np.ndarray:
        """Return step, height of the hand and opening of the jaws in contact, scaled; (N, 3) float32."""
        step = np.full(len(self.hands), float(self.step))
        height = (self.hands[:, 2] - lowest_hand()) / max(float(self.task.size[2]), 1e-3)
        return np.stack([step, height, 2 * width / STROKE], 1).astype(np.float32)

    def _images(self, rows: np.ndarray, pressed: Presses) -> np.ndarray:
        """Return tactile images (N, 2, H, W, 3) uint8, of which ``rows`` touch the object."""
        assert isinstance(self.features, TouchFeatures)
        untouched = self.features.untouched
        images = np.tile(untouched, (2 * len(self.hands), 1, 1, 1))
        images[rows] = self.features.images(pressed)
        return images.reshape(-1, 2, *untouched.shape)

    def _features(self, rows: np.ndarray, pressed: Presses) -> np.ndarray:
        """Return features of both fingers (N, 2 F) float32; 0 for all but ``rows``."""
        assert self.features is not None
        features = np.zeros((2 * len(self.hands), TouchFeatures.size), np.float32)
        features[rows] = self.features(pressed)
        return features.reshape(len(self.hands), -1)
