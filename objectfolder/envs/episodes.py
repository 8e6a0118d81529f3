"""Episodes of the grasping environment, and what they observe."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces

from objectfolder.checks import one_of
from objectfolder.envs.calls import started
from objectfolder.envs.camera import ExternalCamera
from objectfolder.envs.features import CONTRAST, FeatureFunction, TouchFeatures
from objectfolder.envs.fingers import Presses
from objectfolder.envs.grasp_scene import lowest_hand
from objectfolder.envs.grasp_task import STEPS, GraspTask
from objectfolder.envs.gripper import STROKE
from objectfolder.errors import ObjectFolderError

OBSERVATIONS = ("features", "tactile", "images", "width", "blind")
STATE = 3  #: size of the state that is observed beside touches: step, height, opening


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

    def state(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return what changes in an episode, for `restore`."""
        return self.objects, self.hands, self.step

    def restore(self, state: tuple[np.ndarray, np.ndarray, int]) -> None:
        """Go on from a `state`; places and hands are never changed in place, so that it can be shared."""
        self.objects, self.hands, self.step = state

    def check_running(self) -> None:
        """Raise ObjectFolderError unless the episodes have begun and not ended."""
        started(len(self.hands) > 0)
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

    def picture(self, row: int, resolution: int = 256) -> np.ndarray:
        """Draw an episode as seen by the external camera; (resolution, resolution, 3) uint8."""
        place, hand = self.objects[row], self.hands[row]
        width = self.task.touch(place[None], hand[None]).width[0]
        camera = ExternalCamera(resolution)
        return camera.picture(self.task.file, self.task.placed(place), hand, width or STROKE)

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
