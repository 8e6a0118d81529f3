"""Reach: a gripper moves to a goal past an object (Meta-World's reach-v3 on any Object File).

Observation, action, reward, ranges of goals and objects, control step and the hand's lag are those of
Meta-World 3.1.1 (Yu et al. 2020, CoRL). There is no Sawyer arm: the hand floats.
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from gymnasium.spaces import Box

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim import calls
from objectfolder.sim.body import Hulls, RigidBody, add_body, as_rigid_body
from objectfolder.sim.drawing import draw_model, view_frame, view_rays
from objectfolder.sim.game import Game

SUBSTEPS = 5  #: simulation steps per control step
ACTION_SCALE = 0.01  #: motion of the hand's target in a control step by an action of 1, m
#: Offset from the hand to the midpoint of the fingertips, which has to reach the goal, m.
TIP = np.array([0.0, 0.0, -0.045])
HAND_START = np.array([0.0, 0.6, 0.2])  #: m
HAND_LOW, HAND_HIGH = np.array([-0.5, 0.4, 0.05]), np.array([0.5, 1.0, 0.5])  #: range of its target, m
OPENING = 0.1  #: opening of the fingers that is observed as 1, m
SIGMOID = np.sqrt(1 / 0.1 - 1)  #: makes the reward's long tail 0.1 at the margin
#: Camera of `ReachEnv.render`: position and target, m; vertical field of view, degrees.
EYE, TARGET, FOV = np.array([1.1, 0.05, 0.6]), np.array([0.0, 0.74, 0.12]), 26.0
_REACH_HIGH = np.array([0.525, 1.025, 0.7])
_REACH_LOW = np.array([-0.525, 0.348, -0.0525])
_STATE_LOW = np.concatenate([_REACH_LOW, [-1], np.full(3, -2.0), np.full(11, -1.0)])
_STATE_HIGH = np.concatenate([_REACH_HIGH, [1], np.full(3, 2.0), np.full(11, 1.0)])
TIME_STEP = 0.0025  #: s
OBJECT_LOW, OBJECT_HIGH = np.array([-0.1, 0.6]), np.array([0.1, 0.7])  #: range of the object's origin, m
GOAL_LOW, GOAL_HIGH = np.array([-0.1, 0.8, 0.05]), np.array([0.1, 0.9, 0.3])  #: range of goals, m
MIN_DISTANCE = 0.15  #: least horizontal distance of goal and object, m
SUCCESS_RADIUS = 0.05  #: distance from the goal that counts as reached, m
MAX_HEIGHT = 0.15  #: height of an object that fits under the open gripper at its start, m
#: Radius of an object about its vertical axis that leaves goals free, m.
MAX_RADIUS = MIN_DISTANCE - SUCCESS_RADIUS


class ReachEnv(Game):
    """Meta-World's reach-v3 with any object, registered as ``ObjectFolder/Reach-v0``.

    **Observation**, 39 numbers: the current state (18), the previous state (18), the goal (3). A state is the
    position of the hand (m; fingertips are at `TIP` from it), the opening of the gripper (1 = 0.1 m), the
    position of the object's origin (m), its quaternion (x, y, z, w), and seven zeros.
    **Action**, 4 numbers in [-1, 1]: motion of the hand's target (times 1 cm), and closing of the gripper.
    **Reward** of a step: 10 within 5 cm of the goal, else 10 / (1 + 9 d^2), where d is the distance of the
    fingertips from that sphere, relative to the distance of the hand's start from the goal.
    Episodes end by truncation only. ``info`` holds ``success`` (0 or 1: now within 5 cm) and ``distance``
    (m).

    Parameters
    ----------
    file : ObjectFile, path or RigidBody
        Object that stands on the table.
    hulls : path or sequence of trimesh.Trimesh, optional
        Folder in which convex hulls are cached, or the hulls, object frame, m; default: a folder of the
        user's.
    horizon : int
        Control steps (12.5 ms) of an episode.
    render_mode : {"rgb_array"}, optional
        Frames are rendered by ray casting, without OpenGL.
    resolution : (int, int)
        Height and width of frames, pixels.

    Raises
    ------
    ObjectFolderError
        If the object is too large for the scene; otherwise as `objectfolder.sim.game.Game`.

    Examples
    --------
    >>> import gymnasium
    >>> env = gymnasium.make(
    ...     "objectfolder.sim:ObjectFolder/Reach-v0", file="build/mug/ObjectFile.safetensors"
    ... )
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 80}  # noqa: RUF012 - as the base class has it
    _changing = ("data", "goal", "_margin", "_steps", "_previous")
    mj_step = staticmethod(mujoco.mj_step)  #: makes the steps, so that `objectfolder.sim.senses` can listen

    def __init__(
        self, file: "ObjectFile | RigidBody | str | Path", hulls: Hulls = None, horizon: int = 500,
        render_mode: str | None = None, resolution: tuple[int, int] = (180, 240),
    ):  # fmt: skip
        self.horizon = whole_number("horizon", horizon, 1)
        self.render_mode = calls.check_render_mode(render_mode)
        self.resolution = calls.check_resolution(resolution)
        body = as_rigid_body(file, hulls)
        self._arguments = (file, hulls, horizon, render_mode, resolution)
        self.model = reach_scene(body)
        self.data = mujoco.MjData(self.model)
        self._height = -lowest_point(body)  # of the origin of the object on the table
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
        self._margin, self._steps, self._previous = 0.0, 0, np.zeros(18)  # no margin: not reset

    def _begin(self, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
        mujoco.mj_resetData(self.model, self.data)
        place, self.goal = draw_placement(rng)
        qpos = self.data.qpos
        qpos[self._hand] = self.data.mocap_pos[self._target] = HAND_START
        qpos[self._object : self._object + 3] = *place, self._height
        self.data.mocap_pos[self._mark] = self.goal
        mujoco.mj_forward(self.model, self.data)
        self._margin = float(np.linalg.norm(HAND_START - self.goal))
        self._steps, self._previous = 0, self._state()
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate one control step, 12.5 ms."""
        calls.require_reset(self._margin > 0)
        action = np.clip(calls.check_actions(action, (4,)), -1, 1)
        target = self.data.mocap_pos[self._target] + ACTION_SCALE * action[:3]
        self.data.mocap_pos[self._target] = np.clip(target, HAND_LOW, HAND_HIGH)
        self.data.ctrl[:] = action[3], -action[3]
        self.mj_step(self.model, self.data, SUBSTEPS)
        self._steps += 1
        distance = float(np.linalg.norm(self.data.qpos[self._hand] + TIP - self.goal))
        info = {"success": float(distance <= SUCCESS_RADIUS), "distance": distance}
        return self._observation(), reward(distance, self._margin), False, self._steps >= self.horizon, info

    def render(self) -> np.ndarray | None:
        """Return a picture of the scene, (height, width, 3) uint8; None without ``render_mode``."""
        if self.render_mode is None:
            return None
        calls.require_reset(self._margin > 0)
        mujoco.mj_kinematics(self.model, self.data)  # a step leaves the previous step's positions
        rays = view_rays(view_frame(EYE, TARGET), FOV, *self.resolution)
        return draw_model(self.model, self.data, EYE, rays, *self.resolution)

    def _state(self) -> np.ndarray:
        qpos = self.data.qpos
        right, left = qpos[self._fingers]
        opening = min(max((OPENING - right + left) / OPENING, 0.0), 1.0)
        x, y, z, qw, qx, qy, qz = qpos[self._object : self._object + 7]
        return np.array([*qpos[self._hand], opening, x, y, z, qx, qy, qz, qw, *np.zeros(7)])

    def _observation(self) -> np.ndarray:
        state = self._state()
        stacked = np.concatenate([state, self._previous, self.goal])
        self._previous = state
        return np.clip(stacked, self.observation_space.low, self.observation_space.high)  # type: ignore[attr-defined]


def reward(distance: float, margin: float) -> float:
    """Return the reward of a step; ``margin`` is the distance of the hand's start from the goal, m."""
    beyond = max(distance - SUCCESS_RADIUS, 0.0) / margin
    return float(10 / (1 + (SIGMOID * beyond) ** 2))


def reach_scene(body: RigidBody) -> mujoco.MjModel:
    """Build the MuJoCo model of table, floating gripper, object and goal.

    Raises ObjectFolderError if the object is too large, or MuJoCo is too old.
    """
    check_size(body)
    if int(mujoco.__version__.partition(".")[0]) < 4:
        raise ObjectFolderError(
            f"MuJoCo {mujoco.__version__} is installed, expected 4 or newer (metaworld pins an older one, "
            "for an environment of its own); install the extra rl, as `objectfolder doctor` says"
        )
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world, shapes = spec.worldbody, mujoco.mjtGeom
    place = {"pos": [0, 0.6, 0], "rgba": [0.75, 0.6, 0.45, 1]}
    world.add_geom(name="table", type=shapes.mjGEOM_PLANE, size=[2, 2, 0.1], **place)
    add_body(spec, body, "object")
    _add_hand(spec)
    goal = world.add_body(name="goal", mocap=True)
    seen = {"contype": 0, "conaffinity": 0, "rgba": [0.85, 0.1, 0.1, 1]}
    goal.add_geom(type=shapes.mjGEOM_SPHERE, size=[0.02, 0, 0], **seen)
    return spec.compile()


def _add_hand(spec: mujoco.MjSpec) -> None:
    """Add a gripper that follows the body ``target`` with Meta-World's compliance and lag.

    Its fingers, joints and motors are Meta-World's as well.
    """
    box, slide = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_SLIDE
    spec.worldbody.add_body(name="target", mocap=True)
    hand = spec.worldbody.add_body(name="hand", gravcomp=1)
    for axis, direction in zip("xyz", np.eye(3)):
        hand.add_joint(name=f"hand_{axis}", type=slide, axis=direction)
    hand.add_geom(type=box, size=[0.03, 0.055, 0.02], pos=[0, 0, 0.07], mass=0.5, rgba=[0.3, 0.3, 0.35, 1])
    for side, place, limits in (("right", -0.05, [0, 0.04]), ("left", 0.05, [-0.03, 0])):
        name = f"finger_{side}"
        finger = hand.add_body(name=name, pos=[0, place, 0], gravcomp=1)
        finger.add_joint(
            name=name, type=slide, axis=[0, 1, 0], range=limits, limited=True,
            armature=100, damping=[1000, 0, 0],
        )  # fmt: skip
        finger.add_geom(
            type=box, size=[0.015, 0.006, 0.045], mass=0.1, condim=4, friction=[2, 0.1, 0.002],
            rgba=[0.6, 0.6, 0.65, 1],
        )  # fmt: skip
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=400)
    spec.add_exclude(bodyname1="finger_right", bodyname2="finger_left")
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="target", name2="hand",
        solref=[0.02, 1],
    )  # fmt: skip


def draw_placement(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a place of the object (2,) and a goal (3,), m: uniform, at least `MIN_DISTANCE` apart."""
    while True:
        place, goal = rng.uniform(OBJECT_LOW, OBJECT_HIGH), rng.uniform(GOAL_LOW, GOAL_HIGH)
        if np.linalg.norm(place - goal[:2]) >= MIN_DISTANCE:
            return place, goal


def lowest_point(body: RigidBody) -> float:
    """Return the lowest z of the hulls; object frame, m."""
    return float(min(hull.bounds[0, 2] for hull in body.hulls))


def check_size(body: RigidBody) -> None:
    """Raise ObjectFolderError if an object does not fit under the gripper, or might cover a goal."""
    points = body.points
    height, radius = np.ptp(points[:, 2]), np.linalg.norm(points[:, :2], axis=1).max()
    if height > MAX_HEIGHT or radius > MAX_RADIUS:
        raise ObjectFolderError(
            f"{body.key} is {height:.3g} m tall and reaches {radius:.3g} m from its vertical axis; the scene "
            f"takes {MAX_HEIGHT:g} m and {MAX_RADIUS:g} m: build the object with a smaller scale"
        )
