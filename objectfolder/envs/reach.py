"""Reach: a gripper moves to a goal, an object stands in between (Meta-World's reach-v3 on any Object File).

Observation, action, reward, ranges of goals and objects, control step and the hand's lag are those of
Meta-World 3.1.1 (Yu et al. 2020, CoRL); the Sawyer arm is left out: its hand floats.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box

from objectfolder.envs.body import RigidBody, add_body, rigid_body
from objectfolder.envs.drawing import draw_model, view_rays
from objectfolder.envs.hulls import cached_hulls
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile

if TYPE_CHECKING:
    import trimesh

TIME_STEP = 0.0025  #: s
SUBSTEPS = 5  #: of a control step
ACTION_SCALE = 0.01  #: m by which the hand's target moves in a control step, at action 1
#: Offset of the middle of the fingertips, which has to reach the goal, from the hand, m.
TIP = np.array([0.0, 0.0, -0.045])
HAND_START = np.array([0.0, 0.6, 0.2])  #: m
HAND_LOW, HAND_HIGH = np.array([-0.5, 0.4, 0.05]), np.array([0.5, 1.0, 0.5])  #: of the hand's target, m
OBJECT_LOW, OBJECT_HIGH = np.array([-0.1, 0.6]), np.array([0.1, 0.7])  #: where its origin is put, m
GOAL_LOW, GOAL_HIGH = np.array([-0.1, 0.8, 0.05]), np.array([0.1, 0.9, 0.3])  #: m
APART = 0.15  #: horizontal distance of goal and object at least, m
SUCCESS_RADIUS = 0.05  #: m
OPENING = 0.1  #: of the fingers, which is observed as 1, m
TALLEST = 0.15  #: object that stands under the open gripper at its start, m
WIDEST = APART - SUCCESS_RADIUS  #: distance of matter from the object's axis: goals stay free, m
SIGMOID = np.sqrt(1 / 0.1 - 1)  #: the reward's long tail is 0.1 at the margin

EYE, TARGET, FOV = np.array([1.1, 0.05, 0.6]), np.array([0.0, 0.74, 0.12]), 26.0  #: of `ReachEnv.render`

_REACH_HIGH = np.array([0.525, 1.025, 0.7])
_REACH_LOW = np.array([-0.525, 0.348, -0.0525])
_STATE_LOW = np.concatenate([_REACH_LOW, [-1], np.full(3, -2.0), np.full(11, -1.0)])
_STATE_HIGH = np.concatenate([_REACH_HIGH, [1], np.full(3, 2.0), np.full(11, 1.0)])


class ReachEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Meta-World's reach-v3 with an object of one's own, registered as ``ObjectFolder/Reach-v0``.

    **Observation**, 39 numbers: what is now (18), what was one step before (18), the goal (3). Each 18:
    position of the hand (m; fingertips are at `TIP` from it), opening of the gripper (1 = 0.1 m), position of
    the object's origin (m), its quaternion (x, y, z, w), seven zeros.
    **Action**, 4 numbers in [-1, 1]: motion of the hand's target (times 1 cm), and closing of the gripper.
    **Reward** of a step: 10 within `SUCCESS_RADIUS` of the goal, else 10 / (1 + 9 d^2) with the distance d of
    the fingertips from that radius, in units of the distance of the hand's start from the goal.
    Episodes end by truncation only. ``info`` holds ``success`` (0 or 1: near the goal now) and ``distance``
    (m).

    Parameters
    ----------
    file : ObjectFile, path or RigidBody
        What stands on the table.
    hulls : sequence of trimesh.Trimesh, optional
        Convex parts of the object, object frame, m; default: computed, and kept in the user's cache.
    horizon : int
        Control steps (12.5 ms) of an episode.
    render_mode : {"rgb_array"}, optional
        Frames of ``resolution``; rays are cast, nothing needs OpenGL.
    resolution : (int, int)
        Height and width of frames, pixels.

    Raises
    ------
    ObjectFolderError
        If the object is too large for the scene, or an argument is wrong.

    Examples
    --------
    >>> import gymnasium
    >>> env = gymnasium.make(
    ...     "objectfolder.envs:ObjectFolder/Reach-v0", file="build/mug/ObjectFile.safetensors"
    ... )
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 80}  # noqa: RUF012 - as the base class has it

    def __init__(
        self,
        file: "ObjectFile | RigidBody | str | Path",
        hulls: "Sequence[trimesh.Trimesh] | None" = None,
        horizon: int = 500,
        render_mode: str | None = None,
        resolution: tuple[int, int] = (180, 240),
    ):
        if horizon < 1:
            raise ObjectFolderError(f"horizon is {horizon}, expected 1 or more control steps")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ObjectFolderError(f"render_mode {render_mode!r} is unknown, expected rgb_array or None")
        body = as_rigid_body(file, hulls)
        self.model = scene(body)
        self.data = mujoco.MjData(self.model)
        self.horizon, self.render_mode, self.resolution = horizon, render_mode, resolution
        self._height = -lowest_point(body)  # of the object's origin when it stands on the table
        self._hand = [self.model.joint(f"hand_{axis}").qposadr[0] for axis in "xyz"]
        self._fingers = [self.model.joint(f"finger_{side}").qposadr[0] for side in ("right", "left")]
        self._object = int(self.model.joint("object").qposadr[0])
        self._target, self._mark = (self.model.body(name).mocapid[0] for name in ("target", "goal"))
        self.observation_space = Box(
            np.concatenate([_STATE_LOW, _STATE_LOW, GOAL_LOW]),
            np.concatenate([_STATE_HIGH, _STATE_HIGH, GOAL_HIGH]),
            dtype=np.float64,
        )
        self.action_space = Box(-1, 1, (4,), np.float32)
        self.goal = GOAL_LOW
        self._margin, self._steps, self._before = 1.0, 0, np.zeros(18)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Put hand and object back, the object and the goal at random places."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        place, self.goal = draw_placement(self.np_random)
        qpos = self.data.qpos
        qpos[self._hand] = self.data.mocap_pos[self._target] = HAND_START
        qpos[self._object : self._object + 3] = *place, self._height
        self.data.mocap_pos[self._mark] = self.goal
        mujoco.mj_forward(self.model, self.data)
        self._margin, self._steps, self._before = (
            float(np.linalg.norm(HAND_START - self.goal)),
            0,
            self._now(),
        )
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate one control step, 12.5 ms."""
        action = np.asarray(action, np.float64)
        if action.shape != (4,) or not np.isfinite(action).all():
            raise ObjectFolderError(f"action is {action.tolist()}, expected 4 finite numbers in [-1, 1]")
        action = np.clip(action, -1, 1)
        target = self.data.mocap_pos[self._target] + ACTION_SCALE * action[:3]
        self.data.mocap_pos[self._target] = np.clip(target, HAND_LOW, HAND_HIGH)
        self.data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(self.model, self.data, SUBSTEPS)
        self._steps += 1
        distance = float(np.linalg.norm(self.data.qpos[self._hand] + TIP - self.goal))
        info = {"success": float(distance <= SUCCESS_RADIUS), "distance": distance}
        return self._observation(), reward(distance, self._margin), False, self._steps >= self.horizon, info

    def render(self) -> np.ndarray | None:
        """Picture of the scene, (height, width, 3) uint8; None without ``render_mode``."""
        if self.render_mode is None:
            return None
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves positions of the one before
        return draw_model(
            self.model, self.data, EYE, view_rays(EYE, TARGET, FOV, *self.resolution), *self.resolution
        )

    def _now(self) -> np.ndarray:
        qpos = self.data.qpos
        right, left = qpos[self._fingers]
        opening = min(max((OPENING - right + left) / OPENING, 0.0), 1.0)
        x, y, z, qw, qx, qy, qz = qpos[self._object : self._object + 7]
        return np.array([*qpos[self._hand], opening, x, y, z, qx, qy, qz, qw, *np.zeros(7)])

    def _observation(self) -> np.ndarray:
        now = self._now()
        stacked = np.concatenate([now, self._before, self.goal])
        self._before = now
        return np.clip(stacked, self.observation_space.low, self.observation_space.high)  # type: ignore[attr-defined]


def draw_placement(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a place of the object (2,) and a goal (3,), m: uniform, but at least `APART` from each other."""
    while True:
        place, goal = rng.uniform(OBJECT_LOW, OBJECT_HIGH), rng.uniform(GOAL_LOW, GOAL_HIGH)
        if np.linalg.norm(place - goal[:2]) >= APART:
            return place, goal


def reward(distance: float, margin: float) -> float:
    """Reward of a step.

    Parameters
    ----------
    distance : float
        Of the fingertips from the goal, m.
    margin : float
        Of the hand's start from the goal, m.
    """
    beyond = max(distance - SUCCESS_RADIUS, 0.0) / margin
    return float(10 / (1 + (SIGMOID * beyond) ** 2))


def scene(body: RigidBody) -> mujoco.MjModel:
    """Table, floating gripper and an object, as a MuJoCo model.

    Raises
    ------
    ObjectFolderError
        If the object is too large, or MuJoCo too old.
    """
    check_size(body)
    if int(mujoco.__version__.partition(".")[0]) < 4:
        raise ObjectFolderError(
            f"MuJoCo {mujoco.__version__} is installed, expected 4 or newer (metaworld pins an older one, "
            "for an environment of its own): pip install 'objectfolder[rl]'"
        )
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world, shapes = spec.worldbody, mujoco.mjtGeom
    world.add_geom(
        name="table", type=shapes.mjGEOM_PLANE, size=[2, 2, 0.1], pos=[0, 0.6, 0], rgba=[0.75, 0.6, 0.45, 1]
    )
    add_body(spec, body, "object")
    _add_hand(spec)
    goal = world.add_body(name="goal", mocap=True)
    goal.add_geom(
        type=shapes.mjGEOM_SPHERE, size=[0.02, 0, 0], contype=0, conaffinity=0, rgba=[0.85, 0.1, 0.1, 1]
    )
    return spec.compile()


def _add_hand(spec: mujoco.MjSpec) -> None:
    """Add a gripper that follows the body ``target``: as soft and as far behind as Meta-World's.

    Fingers, their joints and motors are Meta-World's, too.
    """
    box, slide = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_SLIDE
    spec.worldbody.add_body(name="target", mocap=True)
    hand = spec.worldbody.add_body(name="hand", gravcomp=1)
    for axis, direction in zip("xyz", np.eye(3)):
        hand.add_joint(name=f"hand_{axis}", type=slide, axis=direction)
    hand.add_geom(type=box, size=[0.03, 0.055, 0.02], pos=[0, 0, 0.07], mass=0.5, rgba=[0.3, 0.3, 0.35, 1])
    for side, place, limits in (("right", -0.05, [0, 0.04]), ("left", 0.05, [-0.03, 0])):
        finger = hand.add_body(name=f"finger_{side}", pos=[0, place, 0], gravcomp=1)
        finger.add_joint(
            name=f"finger_{side}", type=slide, axis=[0, 1, 0], range=limits, limited=True,
            armature=100, damping=[1000, 0, 0],
        )  # fmt: skip
        finger.add_geom(
            type=box, size=[0.015, 0.006, 0.045], mass=0.1, condim=4, friction=[2, 0.1, 0.002],
            rgba=[0.6, 0.6, 0.65, 1],
        )  # fmt: skip
        motor = spec.add_actuator(
            name=f"finger_{side}", target=f"finger_{side}", trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_position(kp=400)
    spec.add_exclude(bodyname1="finger_right", bodyname2="finger_left")
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="target", name2="hand",
        solref=[0.02, 1],
    )  # fmt: skip


def as_rigid_body(
    file: "ObjectFile | RigidBody | str | Path", hulls: "Sequence[trimesh.Trimesh] | None" = None
) -> RigidBody:
    """Return what an environment is given as a rigid body; without hulls, the user's cache has them."""
    if isinstance(file, RigidBody):
        return file
    file = file if isinstance(file, ObjectFile) else ObjectFile.load(file)
    if hulls is None:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        hulls = cached_hulls(file, cache / "objectfolder" / "hulls")
    return rigid_body(file, hulls)


def lowest_point(body: RigidBody) -> float:
    """Lowest coordinate of the hulls, which stand on the table; object frame, m."""
    return float(min(hull.bounds[0, 2] for hull in body.hulls))


def check_size(body: RigidBody) -> None:
    """Raise ObjectFolderError if an object does not stand under the gripper, or might cover a goal."""
    points = np.concatenate([hull.vertices for hull in body.hulls])
    height, radius = np.ptp(points[:, 2]), np.linalg.norm(points[:, :2], axis=1).max()
    if height > TALLEST or radius > WIDEST:
        raise ObjectFolderError(
            f"{body.key} is {height:.3g} m tall and reaches {radius:.3g} m from its vertical axis; the scene "
            f"takes {TALLEST:g} m and {WIDEST:g} m: build the object with a smaller scale"
        )
