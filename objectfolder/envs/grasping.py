"""Grasps of one object on a table, simulated in batches.

The phases are those of supplementary I.4: the hand reaches down, the jaws close, the hand lifts, holds, puts
back, and the jaws release. Reaching is not simulated but checked: it is free if nothing is where the open
gripper passes. Each row depends on itself only, whatever the batch and the number of threads.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from objectfolder.envs.body import RigidBody, add_body
from objectfolder.envs.gripper import AXES, LAG, SIDES, SPEED, STROKE, TIP, add_gripper
from objectfolder.envs.poses import hand_axes, rotation
from objectfolder.errors import ObjectFolderError

LIFT = 0.1  #: height to which objects are lifted, m
HELD = 0.8  #: an object follows the hand if it rises by more than this share of its way
TICK = 0.1  #: seconds between looks at jaws that close
CLOSING = 7  #: ticks in which a jaw crosses its stroke and comes to rest, at most
AT_REST = 0.005  #: speed of a jaw that has closed, m/s
CLEARANCE = 0.002  #: between the object and jaws that start to close, m
PENETRATION = 1e-4  #: what counts as two bodies in one place, m
SETTLING = 4.0  #: seconds that a dropped object gets to come to rest
LOOK = 0.5  #: seconds between looks whether it did
STILL = 0.01  #: speed of one that did, m/s and rad/s
DROPS = 64  #: random orientations from which resting poses come


@dataclass(frozen=True)
class Physics:
    """How contacts are simulated: the settings that docs/benchmarks.md chooses by a study of convergence."""

    timestep: float = 0.002  #: s
    cone: str = "elliptic"  #: of friction: elliptic or pyramidal
    impratio: float = 10.0  #: stiffness of friction relative to that of normal forces
    speed: float = SPEED  #: of each closing jaw, m/s

    def scene(self) -> mujoco.MjSpec:
        """Return a scene with a table, z = 0, and these settings."""
        spec = mujoco.MjSpec()
        spec.option.timestep = self.timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        spec.option.impratio = self.impratio
        spec.worldbody.add_geom(
            name="table",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[1, 1, 0.1],
            condim=4,
            friction=[0.5, 0.005, 0.0001],
        )
        return spec


@dataclass(frozen=True)
class Outcomes:
    """What N grasps were and did; world frame, metres."""

    objects: np.ndarray  #: (N, 7) position and quaternion (w, x, y, z) of the object between closed jaws
    hands: np.ndarray  #: (N, 4) x, y, z, yaw of the gripper
    width: np.ndarray  #: (N,) opening of the jaws when closed
    touched: np.ndarray  #: (N, 2) bool, by the left and the right pad
    contacts: np.ndarray  #: (N, 2, 3) where a pad's force acts; 0 where it touches nothing
    forces: np.ndarray  #: (N, 2) normal forces, N
    rise: np.ndarray  #: (N,) of the object from closing to the end of holding
    slip: np.ndarray  #: (N,) how far its origin moved meanwhile in the gripper's frame
    success: np.ndarray  #: (N,) bool, it followed the hand between both pads


@dataclass(frozen=True)
class GraspFrame:
    """A moment of a grasp; world frame."""

    phase: str
    place: np.ndarray  #: (7,) of the object
    hand: np.ndarray  #: (4,)
    width: float  #: opening of the jaws, m


class GraspScene:
    """An object on a table under a gripper.

    Parameters
    ----------
    body : RigidBody
    physics : Physics
    threads : int
        Rows are simulated so many at a time; they are the same for any number.

    Raises
    ------
    ObjectFolderError
        If the object is wider than the gripper opens, whichever way it is grasped.
    """

    def __init__(self, body: RigidBody, physics: Physics | None = None, threads: int = 1):
        self.body, self.physics = body, physics or Physics()
        self._threads = threads
        self.model = self._compile()
        self._reach = self._compile(reach=2 * STROKE + float(np.ptp(body.bounds, axis=0).max()))
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self._reach_data = mujoco.MjData(self._reach)
        self._pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
        joint = self.model.joint
        self._object = joint("object").qposadr[0]
        self._hand = [joint(name).qposadr[0] for name in AXES]
        self._jaws = [joint(name).qposadr[0] for name in SIDES]
        self._jaw_speeds = [joint(name).dofadr[0] for name in SIDES]
        self._motors = [self.model.actuator(name).id for name in SIDES]
        self._size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._points = np.concatenate([hull.vertices for hull in body.hulls])
        geoms = np.arange(self._reach.ngeom)
        self._of_object = self._reach.geom_bodyid[geoms] == self._reach.body("object").id
        self._of_gripper = ~self._of_object & (geoms != self._reach.geom("table").id)
        width = self._narrowest()
        if width > STROKE:
            raise ObjectFolderError(
                f"{body.key} is too large for the gripper: at its narrowest {1000 * width:.0f} mm across, "
                f"and the jaws open {1000 * STROKE:.0f} mm; take another object, or build it smaller"
            )

    def rests(self, rng: np.random.Generator, count: int = DROPS) -> np.ndarray:
        """Drop the object in random orientations and see how it comes to rest, over the origin.

        Returns
        -------
        (R, 7) position and quaternion of each drop that came to rest.

        Raises
        ------
        ObjectFolderError
            If none did.
        """
        turns = rng.normal(size=(count, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        low = np.array([(self._points @ rotation(turn).T)[:, 2].min() for turn in turns])
        places = np.c_[np.zeros((count, 2)), 0.002 - low, turns]
        away = np.tile([0.0, 0.0, 1.0, 0.0], (count, 1))
        states = self._states(places, away, np.full(count, STROKE / 2))
        controls = self._controls(away[:1], np.full(1, STROKE / 2), round(LOOK / self.physics.timestep))
        moving, speeds = np.arange(count), np.full(count, np.inf)
        for _ in range(round(SETTLING / LOOK)):
            states[moving], _ = self._advance([self.model] * len(moving), states[moving], controls)
            speeds[moving] = np.abs(self._velocity(states[moving])).max(1)
            moving = np.flatnonzero(speeds > STILL)
        still = np.flatnonzero(speeds < STILL)
        if not len(still):
            raise ObjectFolderError(
                f"{self.body.key}: none of {count} drops came to rest within {SETTLING:g} s, the slowest "
                f"moves at {speeds.min():.2g}; it rolls or rocks: give it a flatter side"
            )
        found = self._pose(states)[still]
        found[:, :2] = 0
        return found

    def free(self, objects: np.ndarray, hands: np.ndarray) -> np.ndarray:
        """Whether the open gripper comes down to (N, 4) poses past (N, 7) objects; (N,) bool."""
        model, data, clear = self._reach, self._reach_data, []
        for place, hand in zip(objects, hands):
            mujoco.mj_resetData(model, data)
            data.qpos[self._object : self._object + 7] = place
            data.qpos[self._hand] = hand
            data.qpos[self._jaws] = STROKE / 2
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            deep = data.contact.geom[data.contact.dist < -PENETRATION]
            clear.append(not self._of_gripper[deep].any())
        return np.array(clear, bool)

    def close(self, objects: np.ndarray, hands: np.ndarray, forces: np.ndarray) -> "Closed":
        """Close the jaws on objects.

        Parameters
        ----------
        objects : (N, 7) array
            Position and quaternion at rest, world frame.
        hands : (N, 4) array
            x, y, z of the pads' centres and yaw, world frame.
        forces : (N,) array
            Greatest force of each jaw, N.
        """
        objects, hands = np.asarray(objects, np.float64), np.asarray(hands, np.float64)
        models = [self._with_force(force) for force in np.asarray(forces, np.float64)]
        # What lies beyond every point of the object is air: jaws start just outside of it.
        jaws = np.array([self._half_width(*pair) for pair in zip(objects, hands)])
        jaws = np.minimum(jaws + CLEARANCE, STROKE / 2)
        states = self._states(objects, hands, jaws)
        speed, lag = self.physics.speed, LAG * self.physics.speed / SPEED
        states[:, [1 + self.model.nq + i for i in self._jaw_speeds]] = -speed
        steps = round(TICK / self.physics.timestep)
        felt = np.zeros((len(states), self.model.nsensordata))
        closing = np.arange(len(states))
        for tick in range(CLOSING):
            if not len(closing):
                break
            times = (tick * steps + np.arange(1, steps + 1)) * self.physics.timestep
            controls = self._controls(hands[closing], 0 * closing, steps)
            controls[:, :, self._motors] = (jaws[closing, None] - lag - speed * times)[:, :, None]
            states[closing], felt[closing] = self._advance(
                [models[i] for i in closing], states[closing], controls
            )
            speeds = np.abs(states[closing][:, [1 + self.model.nq + i for i in self._jaw_speeds]]).max(1)
            closing = closing[speeds > AT_REST]
        # Then with all the force there is, and until what the jaws moved has come to rest.
        controls = self._controls(hands, np.full(len(hands), -STROKE), steps)
        states, felt = self._advance(models, states, controls)
        return Closed(self, models, hands, states, felt.reshape(-1, 2, 7))

    def lift(self, closed: "Closed") -> Outcomes:
        """Lift and hold what the jaws have closed on; see `grasp`."""
        states, before = closed.states.copy(), closed.states
        touched = closed.touched
        held = np.flatnonzero(touched.all(1))
        seconds = 0.5
        steps = round(seconds / self.physics.timestep)
        u = np.arange(1, steps + 1) / steps
        rising = LIFT * (10 * u**3 - 15 * u**4 + 6 * u**5)
        for height in (rising[: steps // 2], rising[steps // 2 :], np.full(steps, LIFT)):  # lift, hold
            controls = self._controls(closed.hands[held], np.full(len(held), -STROKE), len(height))
            controls[:, :, self.model.actuator("z").id] += height
            states[held], felt = self._advance([closed.models[i] for i in held], states[held], controls)
            risen = (self._pose(states) - self._pose(before))[held, 2]
            on = (felt.reshape(-1, 2, 7)[:, :, 0] > 0).all(1)
            held = held[(risen > HELD * height[-1]) & on]
        success = np.zeros(len(states), bool)
        success[held] = True
        relative = [
            np.einsum("nij,ni->nj", hand_axes(at[:, self._state(self._hand)]), offset)
            for at in (before, states)
            for offset in [self._pose(at)[:, :3] - at[:, self._state(self._hand[:3])]]
        ]
        return Outcomes(
            objects=closed.objects,
            hands=closed.hands,
            width=closed.width,
            touched=touched,
            contacts=closed.contacts,
            forces=closed.forces,
            rise=(self._pose(states) - self._pose(before))[:, 2],
            slip=np.linalg.norm(relative[1] - relative[0], axis=1),
            success=success,
        )

    def grasp(self, objects: np.ndarray, hands: np.ndarray, forces: np.ndarray) -> Outcomes:
        """Close the jaws on objects, lift and hold them; parameters as of `close`.

        A grasp succeeds if the object follows the hand: half-way up, at the top, and after half a second
        there both pads touch it, and its origin has risen by more than `HELD` of the hand's way. So one that
        tilts instead of rising has failed, even if it hangs between the jaws at the end. Rows that have
        failed are not simulated any further.
        """
        return self.lift(self.close(objects, hands, forces))

    def watch(self, place: np.ndarray, hand: np.ndarray, force: float, every: float) -> list[GraspFrame]:
        """One grasp through all its phases: reach, close, lift, hold, put back, release.

        Parameters
        ----------
        place : (7,) array
            Of the object at rest.
        hand : (4,) array
        force : float
            N.
        every : float
            Seconds between frames.
        """
        open_, shut = STROKE / 2, -STROKE
        travel = STROKE / 2 / self.physics.speed
        #: by phase: seconds, height over the grasp at its end, jaws at its end
        phases = (
            ("reach", 0.6, 0.0, open_),
            ("close", travel + TICK, 0.0, shut),
            ("lift", 0.5, LIFT, shut),
            ("hold", 0.5, LIFT, shut),
            ("put back", 0.5, 0.0, shut),
            ("release", 0.5, 0.0, open_),
        )
        above, jaws, controls, names = LIFT, open_, [], []
        for name, seconds, height, aim in phases:
            u = np.linspace(0, 1, round(seconds / self.physics.timestep) + 1)[1:]
            part = self._controls(hand[None], np.array([jaws]), len(u))[0]
            part[:, self.model.actuator("z").id] += above + (height - above) * (
                10 * u**3 - 15 * u**4 + 6 * u**5
            )
            if name == "close":
                closing = open_ - self.physics.speed * seconds * u
                part[:, self._motors] = np.where(u < travel / seconds, closing, shut)[:, None]
            elif name == "release":
                part[:, self._motors] = (STROKE / 2 * np.minimum(2 * u, 1))[:, None]
            controls.append(part)
            names += [name] * len(u)
            above, jaws = height, aim
        start = self._states(place[None], hand[None] + [0, 0, LIFT, 0], np.array([STROKE / 2]))
        states, _ = self._pool.rollout(
            [self._with_force(force)], self._data, start, control=np.concatenate(controls)[None]
        )
        rows = range(0, len(names), max(round(every / self.physics.timestep), 1))
        poses, hands = self._pose(states[0]), states[0][:, self._state(self._hand)]
        widths = states[0][:, self._state(self._jaws)].sum(1)
        return [GraspFrame(names[row], poses[row], hands[row], float(widths[row])) for row in rows]

    def _compile(self, reach: float = 0.0) -> mujoco.MjModel:
        spec = self.physics.scene()
        add_body(spec, self.body, "object")
        add_gripper(spec, self.body.friction, reach)
        return spec.compile()

    def _with_force(self, force: float) -> mujoco.MjModel:
        model = copy.copy(self.model)
        model.actuator_forcerange[self._motors] = [-force, force]
        return model

    def _narrowest(self) -> float:
        """Least distance of two parallel planes that the object fits between, over many directions."""
        k = np.arange(400) + 0.5
        height, azimuth = k / len(k), k * np.pi * (3 - np.sqrt(5))
        ring = np.sqrt(1 - height**2)
        directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height])
        return float(np.ptp(self._points @ np.c_[directions, np.eye(3)], axis=0).min())

    def _half_width(self, place: np.ndarray, hand: np.ndarray) -> float:
        points = self._points @ rotation(place[3:]).T + place[:3]
        across = (points - hand[:3]) @ np.array([np.cos(hand[3]), np.sin(hand[3]), 0.0])
        return float(np.abs(across).max())

    def _states(self, objects: np.ndarray, hands: np.ndarray, jaws: np.ndarray) -> np.ndarray:
        """Full physical states, at rest; (N, S): time, positions, velocities."""
        states = np.zeros((len(objects), self._size))
        states[:, self._state(range(self._object, self._object + 7))] = objects
        states[:, self._state(self._hand)] = hands
        states[:, self._state(self._jaws)] = np.asarray(jaws)[:, None]
        return states

    def _controls(self, hands: np.ndarray, jaws: np.ndarray, steps: int) -> np.ndarray:
        """Targets that stand still; (N, steps, 6)."""
        targets = np.zeros((len(hands), self.model.nu))
        targets[:, [self.model.actuator(name).id for name in AXES]] = hands
        targets[:, self._motors] = np.asarray(jaws)[:, None]
        return np.repeat(targets[:, None], steps, 1)

    def _advance(
        self, models: Sequence[mujoco.MjModel], states: np.ndarray, controls: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """States and sensors after the last step of controls."""
        if not len(states):
            return states, np.zeros((0, self.model.nsensordata))
        ended, felt = self._pool.rollout(list(models), self._data, states, control=controls)
        return ended[:, -1].copy(), felt[:, -1].copy()

    def _state(self, addresses: Sequence[int]) -> list[int]:
        return [1 + address for address in addresses]  # the time comes first

    def _pose(self, states: np.ndarray) -> np.ndarray:
        return states[:, self._state(range(self._object, self._object + 7))]

    def _velocity(self, states: np.ndarray) -> np.ndarray:
        start = 1 + self.model.nq + self.model.joint("object").dofadr[0]
        return states[:, start : start + 6]


@dataclass(frozen=True)
class Closed:
    """N objects between closed jaws, as `GraspScene.close` leaves them."""

    scene: GraspScene
    models: list[mujoco.MjModel]
    hands: np.ndarray  #: (N, 4)
    states: np.ndarray
    felt: np.ndarray  #: (N, 2, 7) by pad: number of contacts, force, place

    def take(self, rows: np.ndarray) -> "Closed":
        """Some of them."""
        models = [self.models[row] for row in rows]
        return Closed(self.scene, models, self.hands[rows], self.states[rows], self.felt[rows])

    @property
    def objects(self) -> np.ndarray:
        """Position and quaternion of the objects; (N, 7)."""
        return self.scene._pose(self.states)

    @property
    def width(self) -> np.ndarray:
        """Opening of the jaws, metres; (N,)."""
        return self.states[:, self.scene._state(self.scene._jaws)].sum(1)

    @property
    def touched(self) -> np.ndarray:
        """Whether each pad touches the object; (N, 2) bool."""
        return self.felt[:, :, 0] > 0

    @property
    def forces(self) -> np.ndarray:
        """Normal force on each pad, N; (N, 2)."""
        closing = hand_axes(self.hands)[:, :, 0]
        return np.abs(np.einsum("nki,ni->nk", self.felt[:, :, 1:4], closing))

    @property
    def contacts(self) -> np.ndarray:
        """Where forces act on the pads, world frame; (N, 2, 3)."""
        return self.felt[:, :, 4:7]


def lowest_hand() -> float:
    """Least height of the pads' centres over the table: the tips of the fingers just clear it."""
    return float(TIP) + 0.001
