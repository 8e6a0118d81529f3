"""Grasp an object by touch: the environment ``ObjectFolder/Grasp-v0`` (supplementary I.4).

An episode has two steps. Before each the jaws close gently, both fingers feel, and the jaws open again; the
action moves the hand. After the second the jaws close, and the hand lifts and holds: reward 1 if the object
is held. Where the open gripper would run into the object there is no grasp, and the reward is 0.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from objectfolder.envs.body import RigidBody, rigid_body
from objectfolder.envs.features import CONTRAST, Feel, TouchBank, TouchFeatures
from objectfolder.envs.fingers import Presses, presses, sensor_profile
from objectfolder.envs.grasping import GraspScene, lowest_hand
from objectfolder.envs.gripper import PAD, STROKE
from objectfolder.envs.hulls import cached_hulls
from objectfolder.envs.poses import rotation, turn_poses
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.seeding import numpy_generator

STEPS = 2  #: of an episode
OBSERVATIONS = ("features", "images", "width", "blind")
FORCE = 15.0  #: of each jaw, N
STATE = 3  #: numbers beside what is felt: see `GraspEnv`
#: An object starts up to so far from under the hand along its short side, m; along its long side, share of
#: it; turned by so much, rad.
START = (0.02, 0.4, 0.75)
#: What an action of 1 moves: across and along, m; up, m; rad.
ACTION = np.array([0.012, 0.025, 0.008, 0.35])
START_HEIGHT = 0.5  #: hands start within this share of the object's height, but not lower than they can
PAD_RAYS = (7, 9)  #: across and up a pad, to see what it would touch first
DROPS = 12  #: of the object, of which that is taken which lies lowest
TOUCHING = 0.0007  #: what is so close behind the first touch is touched, too, m


@dataclass(frozen=True)
class Touch:
    """What both fingers would feel at N poses of the hand."""

    pressed: Presses  #: 2N rows; of those that touch nothing, anything
    touched: np.ndarray  #: (N, 2) bool
    width: np.ndarray  #: (N,) opening of the closed jaws, m; 0 unless both touch


class GraspTask:
    """Episodes of an object that lies on the table, as many at a time as wanted.

    Everything is relative: physics does not know where on the table the object lies.

    Parameters
    ----------
    file : ObjectFile
    body : RigidBody
        The same object's.
    threads : int
        Of the simulation.

    Raises
    ------
    ObjectFolderError
        If the object does not fit the gripper, or the file lacks touch.
    """

    def __init__(self, file: ObjectFile, body: RigidBody, threads: int = 1):
        if "touch" not in file.header:
            raise ObjectFolderError(f"{file.key}: the Object File holds no touch; build it whole")
        self.file, self.scene = file, GraspScene(body, threads=threads)
        self.rest = _lying(self.scene, numpy_generator(0, file.key, "rests"))
        points = np.concatenate([hull.vertices for hull in body.hulls]) @ rotation(self.rest[3:]).T
        self.size = np.ptp(points, axis=0)
        low = lowest_hand()
        self.heights = np.array([low, max(START_HEIGHT * self.size[2], low + 0.005)])

    def start(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Where objects lie, (N, 3) x, y, yaw, and hands are, (N, 4) x, y, z, yaw."""
        spread = np.array([START[0], START[1] * self.size[1], START[2]])
        objects = rng.uniform(-spread, spread, (count, 3))
        hands = np.zeros((count, 4))
        low, high = self.heights
        hands[:, 2] = rng.uniform(low, high, count)
        return objects, hands

    def moved(self, hands: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Poses of hands after actions (N, 4) in [-1, 1]."""
        hands = hands + ACTION * np.clip(actions, -1, 1)
        hands[:, 2] = np.clip(hands[:, 2], lowest_hand(), lowest_hand() + 2 * self.size[2])
        return hands

    def touch(self, objects: np.ndarray, hands: np.ndarray) -> Touch:
        """What fingers would touch first if the jaws closed gently; objects (N, 3), hands (N, 4)."""
        hands = self._relative(objects, hands)
        n, (across, up) = len(hands), PAD_RAYS
        y, z = np.meshgrid(_cells(PAD[1], across), _cells(PAD[2], up), indexing="ij")
        grid = np.stack([0 * y.ravel(), y.ravel(), z.ravel()], 1)
        starts = grid[None] + np.array([[[STROKE / 2, 0, 0]], [[-STROKE / 2, 0, 0]]])  # left, right
        towards = np.broadcast_to(np.array([[[-1.0, 0, 0]], [[1.0, 0, 0]]]), starts.shape)
        cos, sin = np.cos(hands[:, 3]), np.sin(hands[:, 3])
        turn = np.stack([cos, -sin, 0 * cos, sin, cos, 0 * cos, 0 * cos, 0 * cos, 0 * cos + 1], 1).reshape(
            -1, 3, 3
        )
        world = rotation(self.rest[3:])
        origins = np.einsum("nij,skj->nski", turn, starts) + hands[:, None, None, :3] - self.rest[:3]
        rays = np.einsum("nij,skj->nski", turn, towards)
        origins, rays = ((v @ world).reshape(-1, 3) for v in (origins, rays))
        found, _ = self.file.surface.caster.first_hit(origins / self.file.scale, rays)
        distance = (found * self.file.scale).reshape(n, 2, -1).astype(np.float64)
        first = distance.min(2)
        touched = first < STROKE
        near = distance < np.where(touched, first + TOUCHING, 0.0)[..., None]
        share = near / np.maximum(near.sum(2, keepdims=True), 1)
        hits = np.where(near[..., None], (origins + rays * distance.reshape(-1, 1)).reshape(n, 2, -1, 3), 0.0)
        both = touched.all(1)
        # Here objects are where the object frame is.
        frame = np.tile([0.0, 0, 0, 1, 0, 0, 0], (n, 1))
        pressed = presses(frame, hands, np.zeros((n, 2, 3)))
        outward, vertical = (
            pressed_axis.reshape(n, 2, 3) @ world for pressed_axis in (pressed.outward, pressed.up)
        )
        return Touch(
            Presses(
                (share[..., None] * hits).sum(2).reshape(-1, 3),
                outward.reshape(-1, 3),
                vertical.reshape(-1, 3),
            ),
            touched,
            np.where(both, STROKE - np.where(both[:, None], first, 0).sum(1), 0.0),
        )

    def held(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Whether grasps succeed; (N,) bool."""
        hands = self._relative(objects, hands)
        rests = np.tile(self.rest, (len(hands), 1))
        free = np.flatnonzero(self.scene.free(rests, hands))
        success = np.zeros(len(hands), bool)
        success[free] = self.scene.grasp(rests[free], hands[free], np.full(len(free), FORCE)).success
        return success

    def free(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Whether the open gripper comes down there; (N,) bool."""
        hands = self._relative(objects, hands)
        return self.scene.free(np.tile(self.rest, (len(hands), 1)), hands)

    def bank(
        self, count: int, seed: int, report: Callable[[int, int], None] = lambda done, total: None
    ) -> TouchBank:
        """Features of presses at ``count`` poses that episodes may come to."""
        rng = numpy_generator(seed, self.file.key, "bank")
        objects, hands = self.start(count, rng)
        for _ in range(STEPS):
            hands = self.moved(hands, rng.uniform(-1, 1, (count, 4)) * rng.integers(0, 2, (count, 1)))
        touch = self.touch(objects, hands)
        rows = np.flatnonzero(touch.touched.ravel())
        features, ask = [], TouchFeatures(self.file)
        for part in np.split(rows, range(64, len(rows), 64)):
            features.append(ask(_taken(touch.pressed, part)))
            report(min(len(features) * 64, len(rows)), len(rows))
        return TouchBank(_taken(touch.pressed, rows), np.concatenate(features))

    def _relative(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Hands as seen from objects; (N, 4)."""
        cos, sin = np.cos(objects[:, 2]), np.sin(objects[:, 2])
        x, y = (hands[:, :2] - objects[:, :2]).T
        return np.stack([cos * x + sin * y, cos * y - sin * x, hands[:, 2], hands[:, 3] - objects[:, 2]], 1)


@dataclass
class Episodes:
    """N episodes side by side: what single and vector environments share."""

    task: GraspTask
    observation: str
    features: Feel | None
    objects: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  #: (N, 3)
    hands: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  #: (N, 4)
    step: int = 0

    def __post_init__(self) -> None:
        if self.observation not in OBSERVATIONS:
            raise ObjectFolderError(
                f"observation {self.observation!r} is unknown, expected one of {', '.join(OBSERVATIONS)}"
            )
        if self.features is None and self.observation in ("features", "images"):
            self.features = TouchFeatures(self.task.file)

    def space(self) -> spaces.Space[Any]:
        """Of one episode's observations."""
        state = spaces.Box(-CONTRAST, CONTRAST, (STATE,), np.float32)
        if self.observation == "images":
            profile = sensor_profile(self.task.file)
            shape = (2, profile.height, profile.width, 3)
            return spaces.Dict({"touch": spaces.Box(0, 255, shape, np.uint8), "state": state})
        if self.observation == "features":
            return spaces.Box(-CONTRAST, CONTRAST, (2 * TouchFeatures.size + STATE,), np.float32)
        return state

    def begin(self, count: int, rng: np.random.Generator) -> Any:
        """Start anew, and look."""
        self.objects, self.hands = self.task.start(count, rng)
        self.step = 0
        return self.look()

    def act(self, actions: np.ndarray) -> np.ndarray:
        """Move hands, and after the last step grasp; rewards (N,)."""
        self.hands = self.task.moved(self.hands, actions)
        self.step += 1
        if self.step < STEPS:
            return np.zeros(len(self.hands))
        return self.task.held(self.objects, self.hands).astype(np.float64)

    def look(self) -> Any:
        """Observations of all episodes."""
        if self.observation == "blind":
            return self._state(np.zeros(len(self.hands)), self.hands)
        touch = self.task.touch(self.objects, self.hands)
        state = self._state(touch.width, self.hands)
        if self.observation == "width":
            return state
        rows = np.flatnonzero(touch.touched.ravel())
        pressed = _taken(touch.pressed, rows)
        if self.observation == "images":
            ask = self.features
            assert isinstance(ask, TouchFeatures)
            images = np.empty((2 * len(state), *ask.untouched.shape), np.uint8)
            images[:] = ask.untouched
            images[rows] = ask.images(pressed)
            return {"touch": images.reshape(len(state), 2, *images.shape[1:]), "state": state}
        assert self.features is not None
        felt = np.zeros((2 * len(state), TouchFeatures.size), np.float32)
        felt[rows] = self.features(pressed)
        return np.concatenate([felt.reshape(len(state), -1), state], 1)

    def _state(self, width: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Which step it is, how high the hand, how open the jaws when they touch; scaled; (N, 3)."""
        height = (hands[:, 2] - lowest_hand()) / max(float(self.task.size[2]), 1e-3)
        return np.stack([np.full(len(hands), float(self.step)), height, 2 * width / STROKE], 1).astype(
            np.float32
        )


class GraspEnv(gymnasium.Env[Any, np.ndarray]):
    """One object, one gripper, two fingers that feel.

    ``gymnasium.make("objectfolder.envs:ObjectFolder/Grasp-v0", file="build/mug/ObjectFile.safetensors")``

    Observation (float32): features of the left and the right finger's tactile images; then which step it is,
    the height of the hand, and the opening of the jaws when they touch. Action: dx, dy, dz, dphi in [-1, 1],
    in units of `ACTION`. Reward: 1 for an object that is held after the last step, else 0.

    Parameters
    ----------
    file : ObjectFile or path
    observation : {"features", "images", "width", "blind"}
        images: a dict with the tactile images themselves; width: without them; blind: without touching.
    hulls : path
        Folder in which convex hulls are kept.
    render_mode : {None, "rgb_array"}

    Raises
    ------
    ObjectFolderError
        If the object does not fit the gripper, or the file lacks touch.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self,
        file: ObjectFile | str | Path,
        observation: str = "features",
        hulls: str | Path = "benchmarks/hulls",
        render_mode: str | None = None,
    ):
        file = file if isinstance(file, ObjectFile) else ObjectFile.load(file)
        self._episode = Episodes(make_task(file, hulls), observation, None)
        self.observation_space = self._episode.space()
        self.action_space = spaces.Box(-1, 1, (4,), np.float32)
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Put the object elsewhere."""
        super().reset(seed=seed)
        return _first(self._episode.begin(1, self.np_random)), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move the hand; after the last step, grasp."""
        reward = float(self._episode.act(np.asarray(action, np.float64)[None])[0])
        done = self._episode.step >= STEPS
        return _first(self._episode.look()), reward, done, False, {"success": bool(reward)} if done else {}

    def render(self) -> np.ndarray | None:
        """Return what the external camera sees; (256, 256, 3) uint8."""
        if self.render_mode is None:
            return None
        return picture(self._episode, 0)


class GraspVectorEnv(gymnasium.vector.VectorEnv[Any, np.ndarray, np.ndarray]):
    """Many episodes of one object, simulated together; otherwise as `GraspEnv`.

    All episodes end in the same step, and the next observation is the first of the next episodes
    (autoreset mode SAME_STEP).

    Parameters
    ----------
    num_envs : int
    file : ObjectFile or path
    observation : str
    hulls : path
    task : GraspTask, optional
        Made already, instead of a file.
    features : callable, optional
        Such as a `TouchBank`, which is fast.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        file: ObjectFile | str | Path | None = None,
        observation: str = "features",
        hulls: str | Path = "benchmarks/hulls",
        task: GraspTask | None = None,
        features: Feel | None = None,
    ):
        if task is None:
            if file is None:
                raise ObjectFolderError("Grasp-v0 needs an Object File: file=...")
            task = make_task(file if isinstance(file, ObjectFile) else ObjectFile.load(file), hulls)
        self.num_envs = num_envs
        self._episodes = Episodes(task, observation, features)
        self.single_observation_space = self._episodes.space()
        self.single_action_space = spaces.Box(-1, 1, (4,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin all episodes anew; an int seeds all of them together."""
        if isinstance(seed, list):
            seed = seed[0]
        super().reset(seed=seed)
        return self._episodes.begin(self.num_envs, self.np_random), {}

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Move all hands; after the last step grasp, and begin anew."""
        rewards = self._episodes.act(np.asarray(actions, np.float64))
        ended = np.full(self.num_envs, self._episodes.step >= STEPS)
        seen = self._episodes.look()
        info: dict[str, Any] = {}
        if ended.all():
            info = {"final_obs": seen, "success": rewards > 0}
            seen = self._episodes.begin(self.num_envs, self.np_random)
        return seen, rewards, ended, np.zeros(self.num_envs, bool), info


def make_task(file: ObjectFile, hulls: str | Path, threads: int = 1) -> GraspTask:
    """Make the task of an Object File, whose hulls are kept in a folder."""
    return GraspTask(file, rigid_body(file, cached_hulls(file, hulls)), threads)


def picture(episodes: Episodes, row: int, resolution: int = 256) -> np.ndarray:
    """Draw an episode; (resolution, resolution, 3) uint8."""
    from objectfolder.envs.camera import ExternalCamera

    task = episodes.task
    x, y, yaw = episodes.objects[row]
    place = turn_poses(task.rest[None], np.array([yaw]), np.array([[x, y]]))[0]
    width = task.touch(episodes.objects[row : row + 1], episodes.hands[row : row + 1]).width[0]
    return ExternalCamera(resolution).picture(task.file, place, episodes.hands[row], width or STROKE)


def _lying(scene: GraspScene, rng: np.random.Generator) -> np.ndarray:
    """Of all resting poses that with the lowest centre of mass, its longer side along y; (7,)."""
    rests = scene.rests(rng, DROPS)
    heights = [(rotation(pose[3:]) @ scene.body.centre + pose[:3])[2] for pose in rests]
    pose = rests[int(np.argmin(np.round(heights, 4)))]
    points = np.concatenate([hull.vertices for hull in scene.body.hulls]) @ rotation(pose[3:]).T
    turns = np.linspace(0, np.pi, 180, endpoint=False)
    extents = np.ptp(points[:, 0, None] * np.cos(turns) - points[:, 1, None] * np.sin(turns), axis=0)
    return turn_poses(pose[None], turns[[int(extents.argmin())]], np.zeros((1, 2)))[0]


def _cells(half: float, count: int) -> np.ndarray:
    """Middles of equal parts of [-half, half]."""
    return ((np.arange(count) + 0.5) / count * 2 - 1) * half


def _taken(pressed: Presses, rows: np.ndarray) -> Presses:
    return Presses(*(values[rows] for values in vars(pressed).values()))


def _first(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {name: values[0] for name, values in observation.items()}
    return observation[0]
