"""Layout of the MuJoCo state and control vectors of a scene with an object and the gripper."""

import mujoco
import numpy as np

from objectfolder.envs.gripper import AXES, SIDES


class StateLayout:
    """Indices of object, hand and jaws in full physics states and in controls.

    A full physics state is the time, then positions (``qpos``), then velocities (``qvel``).

    Parameters
    ----------
    model : mujoco.MjModel
        Contains the gripper and a free body ``object``.
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
