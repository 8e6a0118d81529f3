"""Scene of the reach environments: table, floating gripper, object and goal, after Meta-World 3.1.1."""

import mujoco
import numpy as np

from objectfolder.envs.body import RigidBody, add_body
from objectfolder.errors import ObjectFolderError

TIME_STEP = 0.0025  #: s
OBJECT_LOW, OBJECT_HIGH = np.array([-0.1, 0.6]), np.array([0.1, 0.7])  #: range of the object's origin, m
GOAL_LOW, GOAL_HIGH = np.array([-0.1, 0.8, 0.05]), np.array([0.1, 0.9, 0.3])  #: range of goals, m
APART = 0.15  #: least horizontal distance of goal and object, m
SUCCESS_RADIUS = 0.05  #: distance from the goal that counts as reached, m
TALLEST = 0.15  #: height of an object that fits under the open gripper at its start, m
WIDEST = APART - SUCCESS_RADIUS  #: radius of an object about its vertical axis that leaves goals free, m


def reach_scene(body: RigidBody) -> mujoco.MjModel:
    """Build the MuJoCo model of table, floating gripper, object and goal.

    Raises
    ------
    ObjectFolderError
        If the object is too large, or MuJoCo is too old.
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


def draw_placement(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a place of the object (2,) and a goal (3,), m: uniform, and at least `APART` from each other."""
    while True:
        place, goal = rng.uniform(OBJECT_LOW, OBJECT_HIGH), rng.uniform(GOAL_LOW, GOAL_HIGH)
        if np.linalg.norm(place - goal[:2]) >= APART:
            return place, goal


def lowest_point(body: RigidBody) -> float:
    """Return the lowest z of the hulls; object frame, m."""
    return float(min(hull.bounds[0, 2] for hull in body.hulls))


def check_size(body: RigidBody) -> None:
    """Raise ObjectFolderError if an object does not fit under the gripper, or might cover a goal."""
    points = body.points
    height, radius = np.ptp(points[:, 2]), np.linalg.norm(points[:, :2], axis=1).max()
    if height > TALLEST or radius > WIDEST:
        raise ObjectFolderError(
            f"{body.key} is {height:.3g} m tall and reaches {radius:.3g} m from its vertical axis; the scene "
            f"takes {TALLEST:g} m and {WIDEST:g} m: build the object with a smaller scale"
        )
