"""Grasps of one object on a table, simulated in batches.

The phases are those of supplementary I.4: the hand reaches down, the jaws close, the hand lifts, holds, puts
back, and the jaws release. Reaching is checked, not simulated: the volume swept by the open gripper must be
free. Each row is independent of the batch and of the number of threads.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from objectfolder.base.errors import ObjectFolderError
from objectfolder.sim.body import RigidBody, add_body, rotation
from objectfolder.sim.gripper import LAG, OPEN, SHUT, SPEED, STROKE, TIP, StateLayout, add_gripper, hand_axes

HOLD_SHARE = 0.8  #: a held object rises by more than this share of the hand's way
CLOSING_INTERVAL = 0.1  #: interval at which closing jaws are checked, s
MAX_INTERVALS = 7  #: upper bound: a jaw crosses its stroke and comes to rest
CLOSED_SPEED = 0.005  #: below it a jaw has closed, m/s
CLEARANCE = 0.002  #: between the object and jaws that start to close, m
PENETRATION = 1e-4  #: depth from which two bodies collide, m
SETTLING_DURATION = 4.0  #: time that a dropped object gets to come to rest, s
SETTLING_INTERVAL = 0.5  #: interval at which dropped objects are checked, s
REST_SPEED = 0.01  #: below it an object is at rest, m/s and rad/s
DROPS = 64  #: random orientations that resting poses come from
LIFT = 0.1  #: height to which objects are lifted, m
LIFT_DURATION = 0.5  #: duration of the lift, and of the hold after it, s
SQUEEZE_DURATION = 0.1  #: time in which closed jaws build up their force, s


@dataclass(frozen=True)
class Physics:
    """Contact settings; docs/protocols.md derives them from a convergence study."""

    timestep: float = 0.002  #: s
    cone: str = "elliptic"  #: friction cone: elliptic or pyramidal
    impratio: float = 10.0  #: stiffness of friction relative to that of normal forces
    speed: float = SPEED  #: of each closing jaw, m/s

    def scene(self) -> mujoco.MjSpec:
        """Return a scene with these settings and a table at z = 0."""
        spec = mujoco.MjSpec()
        spec.option.timestep = self.timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        spec.option.impratio = self.impratio
        spec.worldbody.add_geom(
            name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], condim=4,
            friction=[0.5, 0.005, 0.0001],
        )  # fmt: skip
        return spec


@dataclass(frozen=True)
class Outcomes:
    """Results of N grasps; world frame, metres."""

    objects: np.ndarray  #: (N, 7) position and quaternion (w, x, y, z) of the object between closed jaws
    hands: np.ndarray  #: (N, 4) x, y, z, yaw of the gripper
    width: np.ndarray  #: (N,) opening of the closed jaws
    touched: np.ndarray  #: (N, 2) bool, contact of the left and the right pad
    contacts: np.ndarray  #: (N, 2, 3) point of application of each pad's force; 0 without contact
    forces: np.ndarray  #: (N, 2) normal forces, N
    rise: np.ndarray  #: (N,) of the object from closing to the end of holding
    slip: np.ndarray  #: (N,) displacement of the object's origin in the gripper's frame meanwhile
    success: np.ndarray  #: (N,) bool, the object followed the hand between both pads


@dataclass(frozen=True)
class GraspFrame:
    """A moment of a grasp; world frame."""

    phase: str
    place: np.ndarray  #: (7,) pose of the object
    hand: np.ndarray  #: (4,)
    width: float  #: opening of the jaws, m


@dataclass(frozen=True)
class ClosedGrasps:
    """N objects between closed jaws."""

    layout: StateLayout
    models: list[mujoco.MjModel]
    hands: np.ndarray  #: (N, 4)
    states: np.ndarray  #: (N, S) full physics states
    sensors: np.ndarray  #: (N, 2, 7) by pad: number of contacts, force, point of application

    def take(self, rows: np.ndarray) -> "ClosedGrasps":
        """Select rows."""
        models = [self.models[row] for row in rows]
        return ClosedGrasps(self.layout, models, self.hands[rows], self.states[rows], self.sensors[rows])

    @property
    def objects(self) -> np.ndarray:
        """Position and quaternion of the objects; (N, 7)."""
        return self.states[:, self.layout.object_pose]

    @property
    def width(self) -> np.ndarray:
        """Opening of the jaws, metres; (N,)."""
        return self.states[:, self.layout.jaws].sum(1)

    @property
    def touched(self) -> np.ndarray:
        """Whether each pad touches the object; (N, 2) bool."""
        return self.sensors[:, :, 0] > 0

    @property
    def forces(self) -> np.ndarray:
        """Normal force on each pad, N; (N, 2)."""
        closing = hand_axes(self.hands)[:, :, 0]
        return np.abs(np.einsum("nki,ni->nk", self.sensors[:, :, 1:4], closing))

    @property
    def contacts(self) -> np.ndarray:
        """Points of application of the forces on the pads, world frame; (N, 2, 3)."""
        return self.sensors[:, :, 4:7]


class GraspScene:
    """An object on a table under a gripper.

    ``threads`` rows are simulated at a time; results do not depend on it. Raises ObjectFolderError if the
    object is wider than the gripper opens, however it is grasped.
    """

    def __init__(self, body: RigidBody, physics: Physics | None = None, threads: int = 1):
        check_width(body.key, body.points)
        self.body, self.physics = body, physics or Physics()
        self.model = self._compile()
        self.layout = StateLayout(self.model)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._points = body.points
        self._swept = self._compile(reach=2 * STROKE + float(np.ptp(body.bounds, axis=0).max()))
        self._swept_data = mujoco.MjData(self._swept)
        of_object = self._swept.geom_bodyid == self._swept.body("object").id
        self._of_gripper = ~of_object & (np.arange(self._swept.ngeom) != self._swept.geom("table").id)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.body, self.physics, len(self._data))  # threads cannot be copied

    def rests(self, rng: np.random.Generator, count: int = DROPS) -> np.ndarray:
        """Drop the object in random orientations and return the poses in which it comes to rest; (R, 7).

        These are position above the origin and quaternion, one per drop that came to rest. Raises
        ObjectFolderError if none did.
        """
        orientations = rng.normal(size=(count, 4))
        orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
        low = np.array([(self._points @ rotation(turn).T)[:, 2].min() for turn in orientations])
        places = np.c_[np.zeros((count, 2)), 0.002 - low, orientations]
        away = np.tile([0.0, 0.0, 1.0, 0.0], (count, 1))
        states = self.layout.states(places, away, np.full(count, OPEN))
        controls = self.layout.constant_controls(away[:1], np.full(1, OPEN), self._steps(SETTLING_INTERVAL))
        moving, speeds = np.arange(count), np.full(count, np.inf)
        for _ in range(round(SETTLING_DURATION / SETTLING_INTERVAL)):
            states[moving], _ = self._advance([self.model] * len(moving), states[moving], controls)
            speeds[moving] = np.abs(states[moving][:, self.layout.object_speed]).max(1)
            moving = np.flatnonzero(speeds > REST_SPEED)
        still = np.flatnonzero(speeds < REST_SPEED)
        if not len(still):
            raise ObjectFolderError(
                f"{self.body.key}: none of {count} drops came to rest within {SETTLING_DURATION:g} s, the "
                f"slowest moves at {speeds.min():.2g}; it rolls or rocks: give it a flatter side"
            )
        found = states[still][:, self.layout.object_pose]
        found[:, :2] = 0
        return found

    def free(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Return whether the open gripper can come down to (N, 4) poses past (N, 7) objects; (N,) bool."""
        model, data = self._swept, self._swept_data
        states = self.layout.states(objects, hands, np.full(len(objects), OPEN))
        clear = np.zeros(len(states), bool)
        for row, state in enumerate(states):
            mujoco.mj_resetData(model, data)
            data.qpos[:] = state[1 : 1 + model.nq]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            colliding = data.contact.geom[data.contact.dist < -PENETRATION]
            clear[row] = not self._of_gripper[colliding].any()
        return clear

    def close(self, objects: np.ndarray, hands: np.ndarray, forces: np.ndarray) -> ClosedGrasps:
        """Close the jaws on objects (N, 7) at rest, with at most the forces (N,), N, of each jaw.

        Hands (N, 4) are x, y, z of the pads' centres and yaw. All poses are in the world frame.
        """
        objects, hands = np.asarray(objects, np.float64), np.asarray(hands, np.float64)
        models = [self._with_force(force) for force in np.asarray(forces, np.float64)]
        states = self._close_until_still(models, objects, hands)
        # Squeeze with the greatest force, until what the jaws pushed has come to rest as well.
        shut = np.full(len(hands), SHUT)
        controls = self.layout.constant_controls(hands, shut, self._steps(SQUEEZE_DURATION))
        states, sensors = self._advance(models, states, controls)
        return ClosedGrasps(self.layout, models, hands, states, sensors)

    def lift(self, closed: ClosedGrasps) -> Outcomes:
        """Lift and hold objects between closed jaws; see `grasp`."""
        states, held = self._lift_and_hold(closed)
        success = np.zeros(len(states), bool)
        success[held] = True
        slip = self._place_in_hand(states) - self._place_in_hand(closed.states)
        same = ("objects", "hands", "width", "touched", "contacts", "forces")
        moved = {"rise": self._rise(states, closed), "slip": np.linalg.norm(slip, axis=1)}
        return Outcomes(**{name: getattr(closed, name) for name in same}, **moved, success=success)

    def grasp(self, objects: np.ndarray, hands: np.ndarray, forces: np.ndarray) -> Outcomes:
        """Close the jaws on objects, lift and hold them; parameters as of `close`.

        A grasp succeeds if the object follows the hand: half-way up, at the top, and after half a second
        there, both pads touch it and its origin has risen by more than `HOLD_SHARE` of the hand's way. An
        object that tilts instead of rising has failed, even if it hangs between the jaws at the end. Failed
        rows are not simulated any further.
        """
        return self.lift(self.close(objects, hands, forces))

    def watch(self, place: np.ndarray, hand: np.ndarray, force: float, every: float) -> list[GraspFrame]:
        """Simulate one grasp through all its phases; a frame each ``every`` seconds.

        Takes the pose (7,) of the object at rest, that of the hand (4,), and the force, N.
        """
        layout = self.layout
        phases, heights, jaws = phase_targets(self.physics.timestep, self.physics.speed)
        controls = layout.constant_controls(hand[None], np.full(1, OPEN), len(phases))
        controls[0, :, layout.height_motor] += heights
        controls[0][:, layout.jaw_motors] = jaws[:, None]
        start = layout.states(place[None], hand[None] + [0, 0, LIFT, 0], np.full(1, OPEN))
        (states,), _ = self._pool.rollout([self._with_force(force)], self._data, start, control=controls)
        return [
            GraspFrame(
                phases[k], states[k, layout.object_pose], states[k, layout.hand],
                float(states[k, layout.jaws].sum()),
            )
            for k in range(0, len(phases), max(self._steps(every), 1))
        ]  # fmt: skip

    def _compile(self, reach: float = 0.0) -> mujoco.MjModel:
        spec = self.physics.scene()
        add_body(spec, self.body, "object")
        add_gripper(spec, self.body.friction, reach)
        return spec.compile()

    def _with_force(self, force: float) -> mujoco.MjModel:
        model = copy.copy(self.model)
        model.actuator_forcerange[self.layout.jaw_motors] = [-force, force]
        return model

    def _steps(self, seconds: float) -> int:
        return round(seconds / self.physics.timestep)

    def _close_until_still(
        self, models: list[mujoco.MjModel], objects: np.ndarray, hands: np.ndarray
    ) -> np.ndarray:
        """Close jaws at constant speed until they have stopped; states (N, S)."""
        layout, timestep, speed = self.layout, self.physics.timestep, self.physics.speed
        # Nothing is beyond the object's outermost point, so jaws start just outside of it.
        jaws = np.array([self._half_width(*pair) for pair in zip(objects, hands)])
        jaws = np.minimum(jaws + CLEARANCE, OPEN)
        states = layout.states(objects, hands, jaws)
        states[:, layout.jaw_speeds] = -speed
        lead = LAG * speed / SPEED  # of the target before the jaw
        steps, closing = self._steps(CLOSING_INTERVAL), np.arange(len(states))
        for tick in range(MAX_INTERVALS):
            if not len(closing):
                break
            times = (tick * steps + np.arange(1, steps + 1)) * timestep
            controls = layout.constant_controls(hands[closing], 0 * closing, steps)
            controls[:, :, layout.jaw_motors] = (jaws[closing, None] - lead - speed * times)[:, :, None]
            states[closing], _ = self._advance([models[row] for row in closing], states[closing], controls)
            speeds = np.abs(states[closing][:, layout.jaw_speeds]).max(1)
            closing = closing[speeds > CLOSED_SPEED]
        return states

    def _lift_and_hold(self, closed: ClosedGrasps) -> tuple[np.ndarray, np.ndarray]:
        """Lift until an object is lost; states (N, S) at the end, and the rows that are still held."""
        states, held = closed.states.copy(), np.flatnonzero(closed.touched.all(1))
        steps = self._steps(LIFT_DURATION)
        heights = LIFT * minimum_jerk(np.arange(1, steps + 1) / steps)
        for part in (heights[: steps // 2], heights[steps // 2 :], np.full(steps, LIFT)):  # lift, hold
            controls = self.layout.constant_controls(closed.hands[held], np.full(len(held), SHUT), len(part))
            controls[:, :, self.layout.height_motor] += part
            models = [closed.models[row] for row in held]
            states[held], sensors = self._advance(models, states[held], controls)
            risen = self._rise(states, closed)[held] > HOLD_SHARE * part[-1]
            held = held[risen & (sensors[:, :, 0] > 0).all(1)]
        return states, held

    def _rise(self, states: np.ndarray, closed: ClosedGrasps) -> np.ndarray:
        return states[:, self.layout.object_pose[2]] - closed.states[:, self.layout.object_pose[2]]

    def _place_in_hand(self, states: np.ndarray) -> np.ndarray:
        """Return origins of the objects in the gripper's frame; (N, 3)."""
        hands = states[:, self.layout.hand]
        offsets = states[:, self.layout.object_pose[:3]] - hands[:, :3]
        return np.einsum("nij,ni->nj", hand_axes(hands), offsets)

    def _half_width(self, place: np.ndarray, hand: np.ndarray) -> float:
        """Return how far the object extends from the hand along the closing axis, m."""
        points = self._points @ rotation(place[3:]).T + place[:3]
        across = (points - hand[:3]) @ np.array([np.cos(hand[3]), np.sin(hand[3]), 0.0])
        return float(np.abs(across).max())

    def _advance(
        self, models: Sequence[mujoco.MjModel], states: np.ndarray, controls: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulate; return states (N, S) and pad sensors (N, 2, 7) after the last step of the controls."""
        if not len(states):
            return states, np.zeros((0, 2, 7))
        ended, sensors = self._pool.rollout(list(models), self._data, states, control=controls)
        return ended[:, -1].copy(), sensors[:, -1].reshape(-1, 2, 7).copy()


def check_width(key: str, points: np.ndarray) -> None:
    """Raise ObjectFolderError if an object is wider than the gripper opens, however it is grasped.

    ``points`` (P, 3) are corners of the object, m.
    """
    k = np.arange(400) + 0.5
    height, azimuth = k / len(k), k * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height], 1)
    width = min(float(np.ptp(points @ along)) for along in (*directions, *np.eye(3)))
    if width > STROKE:
        raise ObjectFolderError(
            f"{key} is too large for the gripper: at its narrowest {1000 * width:.0f} mm across, and the "
            f"jaws open {1000 * STROKE:.0f} mm; take another object, or build it smaller"
        )


def lowest_hand() -> float:
    """Return the least height of the pads' centres above the table: fingertips just clear it."""
    return float(TIP) + 0.001


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """Return positions from 0 to 1 of the smoothest motion, at shares of its duration in [0, 1]."""
    return 10 * share**3 - 15 * share**4 + 6 * share**5


def phase_targets(timestep: float, speed: float) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the targets at T time steps of a grasp that starts `LIFT` above it.

    These are the phase's name, the height of the hand above the grasp, m, and the place of each jaw, m, of
    which both close at ``speed``, m/s.
    """
    travel = OPEN / speed
    closing = travel + SQUEEZE_DURATION
    Jaws = Callable[[np.ndarray], np.ndarray]  # over the share of a phase
    opened, shut = (lambda share: np.full(len(share), OPEN)), (lambda share: np.full(len(share), SHUT))
    phases: tuple[tuple[str, float, float, Jaws], ...] = (  # name, seconds, height at the end, jaws
        ("reach", 0.6, 0.0, opened),
        ("close", closing, 0.0, lambda t: np.where(t < travel / closing, OPEN - speed * closing * t, SHUT)),
        ("lift", LIFT_DURATION, LIFT, shut),
        ("hold", LIFT_DURATION, LIFT, shut),
        ("put back", LIFT_DURATION, 0.0, shut),
        ("release", 0.5, 0.0, lambda t: OPEN * np.minimum(2 * t, 1)),
    )
    start, names, heights, jaws = LIFT, [], [], []
    for name, seconds, end, targets in phases:
        share = np.linspace(0, 1, round(seconds / timestep) + 1)[1:]
        names += [name] * len(share)
        heights.append(start + (end - start) * minimum_jerk(share))
        jaws.append(targets(share))
        start = end
    return names, np.concatenate(heights), np.concatenate(jaws)
