"""Parallel-jaw gripper modelled on Schunk's WSG 50 with DIGIT pads, made of boxes.

Gripper frame: origin midway between the pads' centres, x along the closing direction, z up along the
approach. Sizes in metres: 110 mm of stroke, pads of 20 mm x 30 mm (supplementary I.4).
"""

from dataclasses import dataclass

import mujoco
import numpy as np

STROKE = 0.11  #: greatest opening of the jaws
OPEN, SHUT = STROKE / 2, -STROKE  #: targets of a jaw; the latter is out of reach, so it takes all the force
PAD = np.array([0.002, 0.010, 0.015])  #: half sides of a pad: thickness, width, height
FINGER = np.array([0.009, 0.012, 0.030])  #: half sides of the finger that carries a pad
FINGER_AT = np.array([0.014, 0.0, 0.012])  #: centre of the finger, from the pad's face
PALM = np.array([0.073, 0.025, 0.0367])  #: half sides of the hand above the fingers
PALM_AT = np.array([0.0, 0.0, 0.0823])  #: centre of the palm
TIP = FINGER[2] - FINGER_AT[2]  #: extent of a finger below the pads' centre
SIDES = ("left", "right")  #: jaws; the left one closes towards -x
AXES = ("x", "y", "z", "yaw")  #: joints of the hand, and their actuators
SPEED = 0.14  #: of each closing jaw, m/s
STIFFNESS, DAMPING = 3000.0, 60.0  #: of the jaws' position control, N/m and N s/m
JOINT_DAMPING = 20.0  #: of a jaw's guide, N s/m
#: Distance of a jaw that closes at `SPEED` behind its target.
LAG = SPEED * (DAMPING + JOINT_DAMPING) / STIFFNESS
_PAD_SOFTNESS = 0.008  # time constant of contacts with a pad, s: an elastomer


@dataclass(frozen=True)
class Box:
    """A box that moves with the hand or with a jaw."""

    size: np.ndarray  #: (3,) half sides
    center: np.ndarray  #: (3,) in the gripper's frame, with the jaws closed
    jaw: float  #: derivative of the box's x by its jaw's opening: 1 left, -1 right, 0 palm
    color: tuple[float, float, float]  #: linear RGB


def boxes() -> list[Box]:
    """Return all boxes of the gripper, for drawing."""
    metal, gel = (0.12, 0.12, 0.13), (0.55, 0.2, 0.12)
    made = [Box(PALM, PALM_AT, 0.0, metal)]
    for sign in (1.0, -1.0):
        mirror = np.array([sign, 1.0, 1.0])
        made.append(Box(FINGER, FINGER_AT * mirror, sign, metal))
        made.append(Box(PAD, np.array([PAD[0], 0.0, 0.0]) * mirror, sign, gel))
    return made


def add_gripper(spec: mujoco.MjSpec, friction: float, reach: float = 0.0) -> None:
    """Add the gripper, its actuators and its contact sensors to a scene.

    Joints and position actuators ``x``, ``y``, ``z``, ``yaw`` move the hand, which is weightless; ``left``
    and ``right`` the jaws, 0 closed, `OPEN` open. ``friction`` is the sliding friction of pads and object.
    Fingers and palm are extended upward by ``reach``, metres: they then fill the volume that they sweep on
    the way down.
    """
    box, slide = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_SLIDE
    up = np.array([0.0, 0.0, reach / 2])
    hand = spec.worldbody.add_body(name="hand", gravcomp=1)
    for name, axis in zip(AXES, (*np.eye(3), np.eye(3)[2])):
        turns = name == "yaw"
        kind = mujoco.mjtJoint.mjJNT_HINGE if turns else slide
        hand.add_joint(name=name, type=kind, axis=axis, armature=0.02 if turns else 1.0)
        _position(spec, name, 400.0 if turns else 20000.0)
    hand.add_geom(name="palm", type=box, size=PALM + up, pos=PALM_AT + up, mass=1.2)
    for side, turn in zip(SIDES, ([1, 0, 0, 0], [0, 0, 0, 1])):
        jaw = hand.add_body(name=side, quat=turn, gravcomp=1)
        jaw.add_joint(
            name=side, type=slide, axis=[1, 0, 0], range=[0, OPEN], limited=True,
            damping=np.array([JOINT_DAMPING, 0, 0]), armature=0.2,
        )  # fmt: skip
        jaw.add_geom(name=f"{side}_finger", type=box, size=FINGER + up, pos=FINGER_AT + up, mass=0.1)
        jaw.add_geom(
            name=f"{side}_pad", type=box, size=PAD + up, pos=np.array([PAD[0], 0, 0]) + up, mass=0.02,
            condim=4, friction=[friction, 0.005, 0.0001], solref=[_PAD_SOFTNESS, 1], priority=1,
        )  # fmt: skip
        _position(spec, side, STIFFNESS, DAMPING)
        _contact_sensor(spec, side)
    spec.add_exclude(bodyname1="left", bodyname2="right")
    spec.add_equality(  # the default polynomial: both jaws are equally open
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1="left",
        name2="right",
        solref=[0.004, 1],
    )


def _position(spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float | None = None) -> None:
    """Add a position actuator; critically damped by default."""
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    if damping is None:
        actuator.set_to_position(kp=stiffness, dampratio=1.0)
    else:
        actuator.set_to_position(kp=stiffness, kv=damping)
        actuator.forcelimited, actuator.forcerange = True, [-80.0, 80.0]


def _contact_sensor(spec: mujoco.MjSpec, side: str) -> None:
    """Add a pad's contact sensor: number of contacts with the object, net force, its point; world frame."""
    data = mujoco.mjtConDataField
    fields = (data.mjCONDATA_FOUND, data.mjCONDATA_FORCE, data.mjCONDATA_POS)
    net_force = 3
    spec.add_sensor(
        name=side, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=f"{side}_pad", reftype=mujoco.mjtObj.mjOBJ_BODY, refname="object",
        intprm=[sum(1 << int(field) for field in fields), net_force, 1],
    )  # fmt: skip


def hand_axes(hands: np.ndarray) -> np.ndarray:
    """Return the axes of the gripper at (N, 4) poses, as columns: closing, lateral, up; (N, 3, 3)."""
    yaw = np.asarray(hands)[:, 3]
    cos, sin, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    return np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], 1).reshape(-1, 3, 3)


def relative_hands(hands: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """Return hands (N, 4) in the frames of objects (N, 3) x, y, yaw; (N, 4)."""
    cos, sin = np.cos(objects[:, 2]), np.sin(objects[:, 2])
    x, y = (hands[:, :2] - objects[:, :2]).T
    return np.stack([cos * x + sin * y, cos * y - sin * x, hands[:, 2], hands[:, 3] - objects[:, 2]], 1)


class StateLayout:
    """Indices of the free body ``object``, hand and jaws in full physics states and in controls of a model.

    A full physics state is the time, then positions (``qpos``), then velocities (``qvel``).
    """

    def __init__(self, model: mujoco.MjModel):
        thing, positions, velocities = model.joint("object"), 1, 1 + model.nq
        self.size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.object_pose = positions + thing.qposadr[0] + np.arange(7)  #: position and quaternion
        self.object_speed = velocities + thing.dofadr[0] + np.arange(6)
        self.hand = np.array([positions + model.joint(name).qposadr[0] for name in AXES])
        self.jaws = np.array([positions + model.joint(name).qposadr[0] for name in SIDES])
        self.jaw_speeds = np.array([velocities + model.joint(name).dofadr[0] for name in SIDES])
        self.controls = model.nu
        self.hand_motors = [model.actuator(name).id for name in AXES]
        self.jaw_motors = [model.actuator(name).id for name in SIDES]
        self.height_motor = model.actuator("z").id

    def states(self, objects: np.ndarray, hands: np.ndarray, jaws: np.ndarray) -> np.ndarray:
        """Return states at rest, (N, size), of objects (N, 7), hands (N, 4) and jaw positions (N,)."""
        states = np.zeros((len(objects), self.size))
        states[:, self.object_pose] = objects
        states[:, self.hand] = hands
        states[:, self.jaws] = jaws[:, None]
        return states

    def constant_controls(self, hands: np.ndarray, jaws: np.ndarray, steps: int) -> np.ndarray:
        """Return targets that do not move, (N, steps, controls), of hands (N, 4) and jaws (N,)."""
        targets = np.zeros((len(hands), self.controls))
        targets[:, self.hand_motors] = hands
        targets[:, self.jaw_motors] = jaws[:, None]
        return np.repeat(targets[:, None], steps, 1)
