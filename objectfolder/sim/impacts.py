"""Impacts and sliding of bodies in a MuJoCo simulation, read from its contacts after each step.

Contacts of MuJoCo are soft: an impact lasts several steps, many times as long as that of the real bodies. So
an impact is not the course of the simulated force. When bodies come to touch at a place where they did not
touch before, the impulses that stop their approach are computed from the bodies' inertia (as for rigid
bodies, all contacts together, with Coulomb friction), with the restitution that the contact's spring and
damper have.

The simulation applies such an impulse little by little. Until it has, what is left of it is pending: whether
the bodies still approach at another place, where their soft contact has moved to, is asked of the velocity
that they will have when it has acted. So one landing is one impact, however long and at however many points
the simulation makes it last, and a second edge that hits is another one.
"""

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.optimize import nnls

_COMPLIANCE = 1e-3  # softness, of each contact's own: shares an impulse that more contacts could bear
_CONTACT_SPACING = 0.02  # m; contacts further apart are different ones, but for their motion in three steps
_IMPACT_DURATION = 3.0  # time constants of a contact, after which an impact has acted
_MIN_SPEED_RATIO = 0.05  # approach that goes unheard while an impact acts, of that impact's
_MAX_ITERATIONS = 5  # at most, in which friction finds the direction of the sliding that it leaves
_MAX_MOCAP_SPEED = 20.0  # m/s; mocap bodies that seem to be faster have been put elsewhere


@dataclass(frozen=True)
class Impact:
    """One contact in which two bodies met; world frame."""

    bodies: tuple[int, int]
    point: np.ndarray  #: (3,) m
    impulse: np.ndarray  #: that the second body received, and the first one the opposite of; (3,) N s
    normal: float  #: its part along the normal, N s
    speed: float  #: of approach along the normal, m/s
    mass: float  #: that the contact moves: normal impulse over the change of the speed, kg
    lost: float  #: energy that the normal motion lost, J
    late: float  #: time since the bodies touched, s; at most a step


@dataclass(frozen=True)
class Loads:
    """Contacts that last, one row for each pair of bodies; world frame."""

    bodies: np.ndarray  #: (K, 2) numbers
    point: np.ndarray  #: (K, 3) m, mean by force
    normal: np.ndarray  #: (K, 3) unit vectors from the first to the second body
    force: np.ndarray  #: (K,) N
    slip: np.ndarray  #: velocity of the second body's surface against the first one's, (K, 3) m/s
    rolling: np.ndarray  #: turn of the second body against the first one, about tangents, (K, 3) rad/s
    friction: np.ndarray  #: (K,)


class ContactReader:
    """Impacts and loads of some bodies, given by their numbers, step by step."""

    def __init__(self, model: mujoco.MjModel, bodies: "np.ndarray | list[int]"):
        self._model = model
        self._counts = np.zeros(model.nbody, bool)
        self._counts[bodies] = True
        self._mocap = model.body_mocapid[model.body_rootid]  # number of what carries each body, or -1
        self.reset()

    def reset(self) -> None:
        """Forget which bodies touch, and where mocap bodies were."""
        self._before: tuple[np.ndarray, np.ndarray] | None = None  # pairs of geoms, and points
        self._pending: dict[tuple[int, int], _Pending] = {}  # by bodies
        self._outside = np.zeros(self._model.nv)  # that all but pending impacts added to the velocity
        self._poses: tuple[np.ndarray, np.ndarray] | None = None  # places and turns of mocap bodies

    @property
    def min_speed(self) -> float:
        """Approach that gravity alone makes in a step: slower ones are not resolved, m/s."""
        return max(math.hypot(*self._model.opt.gravity.tolist()) * self._model.opt.timestep, 1e-3)

    def read(self, data: mujoco.MjData) -> tuple[list[Impact], Loads | None]:
        """Return the impacts of the step that ``mj_step`` made last, and the loads, if any."""
        contact, model = data.contact, self._model
        moving = self._read_mocap(data) if model.nmocap else None
        geoms = contact.geom
        bodies = model.geom_bodyid[geoms]
        rows = np.flatnonzero(
            self._counts[bodies].any(1) & (contact.efc_address >= 0) & (contact.dist < contact.includemargin)
            & (geoms >= 0).all(1)
        )  # fmt: skip
        before, self._before = self._before, None
        if not len(rows):
            self._pending = {}
            return [], None
        found = _Contacts.of(model, data, rows)
        if moving is not None:
            found = self._add_mocap(data, found, *moving)
        self._before = found.pairs, found.point
        new = np.ones(len(rows), bool)
        if before is not None:
            near = _CONTACT_SPACING + 3 * model.opt.timestep * np.sqrt(np.square(found.velocity).sum(1))
            away = np.square(found.point[:, None] - before[1]).sum(2)
            same = (found.pairs[:, None] == before[0]).all(2)
            new = ~(same & (away < near[:, None] ** 2)).any(1)
        live = new & (found.velocity[:, 0] < -self.min_speed)
        if self._pending:
            touching = set(found.bodies)
            self._pending = {k: one for k, one in self._pending.items() if one.steps > 0 and k in touching}
            live |= np.array([pair in self._pending for pair in found.bodies])
        impacts = self._impacts(data, found, np.flatnonzero(live), new) if live.any() else []
        return impacts, self._loads(data, found, np.flatnonzero(~new))

    def _impacts(
        self, data: mujoco.MjData, found: "_Contacts", live: np.ndarray, new: np.ndarray
    ) -> list[Impact]:
        """Solve for the impulses that stop what approach the pending ones leave."""
        model, count, step = self._model, len(live), self._model.opt.timestep
        pairs = [found.bodies[row] for row in live]
        motion = self._jacobians(data, found, live).reshape(3 * count, -1)
        momentum = sum((one.momentum for one in self._pending.values()), np.zeros(model.nv))
        moved = np.empty((3 * count + 1, model.nv))
        mujoco.mj_solveM(model, data, moved, np.concatenate([motion, momentum[None]]))
        after, moved = moved[-1], moved[:-1]
        velocity = found.velocity[live] + (motion @ after).reshape(-1, 3)
        # Weight and motors that press bodies together while they touch are borne, and make no impact.
        held = np.array([pair in self._pending for pair in pairs])
        pressed = np.where(held, -(motion[::3] @ self._outside), 0.0).clip(0)
        approach = -velocity[:, 0] - pressed
        speeds = [self._pending[pair].speed if pair in self._pending else 0.0 for pair in pairs]
        min_speed = np.maximum(self.min_speed, _MIN_SPEED_RATIO * np.array(speeds))
        met = new[live] & (approach > min_speed)
        impulses, out = np.zeros((count, 3)), []
        mobility = motion @ moved.T
        solved = _find_coupled(mobility, -velocity[:, 0] > min_speed)
        if solved.any():
            # MuJoCo's damper acts on the velocity that it knows, which is not that of mocap bodies.
            own = approach + found.carried[live].clip(max=0)
            bounce = np.array([restitution(*ref) for ref in found.solref[live].tolist()])
            rebound = np.where(met, bounce * own.clip(0), 0.0)
            some = np.repeat(solved, 3)
            impulses[solved] = _solve_impulses(
                mobility[np.ix_(some, some)], velocity[solved], rebound[solved], found.friction[live][solved]
            )
            then = velocity + (mobility @ impulses.ravel()).reshape(-1, 3)
            work = -impulses * (velocity + then) / 2
            lost = (work[:, 0] + work[:, 1:].sum(1).clip(max=0)).clip(0)
            hit = {pair for pair, one in zip(pairs, met) if one}
            alone = impulses[:, 0] * mobility.diagonal()[::3]  # change of the speed by each alone
            for k in np.flatnonzero(alone > min_speed).tolist():
                if pairs[k] not in hit:
                    continue
                row, normal = live[k], float(impulses[k, 0])
                speed = float(approach[k] if met[k] else alone[k] / (1 + bounce[k]))
                change = speed + float(rebound[k]) if met[k] else float(alone[k])
                late = min(max(-float(found.distance[row]), 0.0) / speed, step)
                impulse, gone = impulses[k] @ found.frame[row], float(lost[k])
                place = pairs[k], found.point[row]
                out.append(Impact(*place, impulse, normal, speed, normal / change, gone, late))
            for pair in hit - self._pending.keys():
                mine = np.array([one == pair for one in pairs])
                lasting = max(_time_constant(*ref) for ref in found.solref[live[mine]].tolist())
                steps, fastest = math.ceil(_IMPACT_DURATION * lasting / step), float(approach[mine].max())
                self._pending[pair] = _Pending(np.zeros(model.nv), steps, fastest)
        force = found.force[live]
        given = np.einsum("kd,kdv->kv", impulses - step * force, motion.reshape(count, 3, -1))
        for k, pair in enumerate(pairs):
            if pair in self._pending:
                self._pending[pair].momentum += given[k]
        for one in self._pending.values():
            one.steps -= 1
        acting = np.array([pair in self._pending for pair in pairs])
        applied = np.where(acting[:, None], force, 0).ravel() @ moved
        self._outside = step * (data.qacc - applied)
        return out

    def _read_mocap(self, data: mujoco.MjData) -> "tuple[np.ndarray, np.ndarray] | None":
        """Return velocities and turns of mocap bodies in the last step, (N, 3) each, if any has moved."""
        before, step = self._poses, self._model.opt.timestep
        self._poses = data.mocap_pos.copy(), data.mocap_quat.copy()
        for turned in self._poses[1]:
            mujoco.mju_normalize4(turned)  # as MuJoCo does where it reads them
        if before is None:
            return None
        velocity, turn = (data.mocap_pos - before[0]) / step, np.zeros((len(before[0]), 3))
        for out, now, was in zip(turn, self._poses[1], before[1]):
            if (now != was).any():
                mujoco.mju_subQuat(out, now, was)  # in the frame that the body had
                mujoco.mju_rotVecQuat(out, out.copy(), was)
        turn /= step
        jumped = np.square(velocity).sum(1) > _MAX_MOCAP_SPEED**2
        velocity[jumped] = turn[jumped] = 0
        return (velocity, turn) if velocity.any() or turn.any() else None

    def _add_mocap(
        self, data: mujoco.MjData, found: "_Contacts", velocity: np.ndarray, turn: np.ndarray
    ) -> "_Contacts":
        """Return contacts with the velocities that mocap bodies add, of which MuJoCo knows nothing."""
        added = np.zeros_like(found.velocity)
        for k, pair in enumerate(found.bodies):
            for sign, body in zip((-1, 1), pair):
                mocap = self._mocap[body]
                if mocap >= 0:
                    arm = found.point[k] - data.mocap_pos[mocap]
                    added[k] += sign * found.frame[k] @ (velocity[mocap] + np.cross(turn[mocap], arm))
        return replace(found, velocity=found.velocity + added, carried=added[:, 0])

    def _loads(self, data: mujoco.MjData, found: "_Contacts", lasting: np.ndarray) -> Loads | None:
        """Sum the contacts that last, by pairs of bodies."""
        pushing = [k for k in lasting.tolist() if found.force[k, 0] > 0]
        if not pushing:
            return None
        bodies = [found.bodies[k] for k in pushing]
        numbers = {pair: number for number, pair in enumerate(dict.fromkeys(bodies))}
        force = found.force[pushing, 0]
        share = np.zeros((len(numbers), len(pushing)))  # of each contact in the force of its pair
        share[[numbers[pair] for pair in bodies], np.arange(len(pushing))] = force
        total = share.sum(1)
        share /= total[:, None]
        point, friction = share @ found.point[pushing], share @ found.friction[pushing]
        slip = share @ np.einsum("kt,ktd->kd", found.velocity[pushing, 1:], found.frame[pushing, 1:])
        normal = share @ found.frame[pushing, 0]
        normal /= np.sqrt(np.square(normal).sum(1, keepdims=True)).clip(1e-9)
        pairs = np.array([*numbers])
        first, second = pairs.T
        turn = data.cvel[second, :3] - data.cvel[first, :3]
        turn -= normal * (normal * turn).sum(1, keepdims=True)
        return Loads(pairs, point, normal, total, slip, turn, friction)

    def _jacobians(self, data: mujoco.MjData, found: "_Contacts", rows: np.ndarray) -> np.ndarray:
        """Return how velocities of contacts, in their frames, follow from those of the joints; (K, 3, nv)."""
        sides = np.zeros((2, len(rows), 3, self._model.nv))
        for k, row in enumerate(rows.tolist()):
            for side, body in enumerate(found.bodies[row]):
                if body:
                    mujoco.mj_jac(self._model, data, sides[side, k], None, found.point[row], body)
        out: np.ndarray = found.frame[rows] @ (sides[1] - sides[0])
        return out


@dataclass(frozen=True)
class _Contacts:
    """Contacts of a step that count."""

    bodies: list[tuple[int, int]]
    pairs: np.ndarray  #: (K, 2) of geoms
    point: np.ndarray  #: (K, 3)
    frame: np.ndarray  #: (K, 3, 3), rows: normal and two tangents
    velocity: np.ndarray  #: (K, 3) in that frame, before the step
    carried: np.ndarray  #: (K,) part along the normal that mocap bodies have
    force: np.ndarray  #: (K, 3) in that frame
    friction: np.ndarray  #: (K,)
    solref: np.ndarray  #: (K, 2)
    distance: np.ndarray  #: (K,)

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, rows: np.ndarray) -> "_Contacts":
        contact = data.contact
        geoms, mu = contact.geom[rows], contact.friction[rows]
        velocity, force = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
        edged = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        address, dims = contact.efc_address[rows], contact.dim[rows]
        for dim in set(dims.tolist()):
            alike = np.flatnonzero(dims == dim)
            start = address[alike, None]
            if not edged or dim == 1:
                size = min(dim, 3)
                force[alike, :size] = data.efc_force[start + np.arange(size)]
                velocity[alike, :size] = data.efc_vel[start + np.arange(size)]
            else:  # edges n + mu t and n - mu t of each tangent
                f = data.efc_force[start + np.arange(2 * (dim - 1))]
                force[alike, 0] = f.sum(1)
                force[alike, 1:] = (f[:, :4:2] - f[:, 1:4:2]) * mu[alike, :2]
                v = data.efc_vel[start + np.arange(4)]
                velocity[alike, 0] = (v[:, 0] + v[:, 1]) / 2
                velocity[alike, 1:] = (v[:, ::2] - v[:, 1::2]) / (2 * mu[alike, :2])
        return cls(
            bodies=[tuple(pair) for pair in model.geom_bodyid[geoms].tolist()], pairs=geoms,
            point=contact.pos[rows], frame=contact.frame[rows].reshape(-1, 3, 3), velocity=velocity,
            carried=np.zeros(len(rows)), force=force, friction=mu[:, 0], solref=contact.solref[rows],
            distance=contact.dist[rows],
        )  # fmt: skip


@dataclass
class _Pending:
    """What is left of the impacts of two bodies that the simulation has not applied yet."""

    momentum: np.ndarray  #: (nv,) of the joints
    steps: int  #: until it has
    speed: float  #: of approach in the first one, m/s


def _find_coupled(mobility: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return whether each contact, (K,) bool, can move or be moved by a wanted one."""
    count = len(wanted)
    if not wanted.any() or count == 1:
        return wanted
    moved = np.any(mobility.reshape(count, 3, count, 3) != 0, axis=(1, 3))
    while True:
        wanted, before = np.any(moved[:, wanted], axis=1), wanted
        if (wanted == before).all():
            return wanted


def _solve_impulses(
    mobility: np.ndarray, velocity: np.ndarray, rebound: np.ndarray, friction: np.ndarray
) -> np.ndarray:
    """Return impulses after which contacts part at least as fast as asked, in their frames; (K, 3).

    They push, within pyramids of Coulomb friction, as MuJoCo's. One problem of least squares without negative
    unknowns finds those of a convex friction, which would lift what slides; the next ones ask for that much
    less. ``mobility`` (3 K, 3 K) is the change of all velocities by all impulses; ``velocity`` (K, 3) is the
    one before; ``rebound`` and ``friction`` are (K,).
    """
    count = len(velocity)
    cone = np.zeros((count, 4, count, 3))  # n + mu t and n - mu t of each tangent
    each = np.arange(count)
    cone[each, :, each, 0] = 1
    for edge, (tangent, sign) in enumerate(((1, 1), (1, -1), (2, 1), (2, -1))):
        cone[each, edge, each, tangent] = sign * friction
    edges = cone.reshape(4 * count, 3 * count)
    soft = edges @ (mobility + _COMPLIANCE * np.diag(mobility.diagonal())) @ edges.T
    soft += 1e-9 * np.trace(soft) / len(soft) * np.eye(len(soft))
    root = np.linalg.cholesky(soft)
    wanted, impulses = rebound, np.zeros((count, 3))
    for _ in range(_MAX_ITERATIONS):
        target = np.repeat(wanted, 4) - edges @ velocity.ravel()
        sizes, _ = nnls(root.T, np.linalg.solve(root, target), maxiter=100 * len(target))
        impulses = (sizes @ edges).reshape(-1, 3)
        slip = velocity[:, 1:] + (mobility @ impulses.ravel()).reshape(-1, 3)[:, 1:]
        before, wanted = wanted, rebound - friction * abs(slip).max(1)
        if abs(wanted - before).max() < 1e-3 * abs(velocity).max():
            break
    return impulses


def _time_constant(first: float, second: float) -> float:
    """Return the time in which a contact stops an approach, from its ``solref``, s."""
    return first if first > 0 else 1 / math.sqrt(max(-first, 1e-12))


def restitution(first: float, second: float) -> float:
    """Return the restitution of a contact of MuJoCo from its ``solref``.

    These are time constant and damping ratio; or, negative, stiffness and damping of unit mass. A spring and
    a damper stop a body, and cannot pull it back: the contact ends when the force does (Schwager and Pöschel,
    Granular Matter 9, 2007). Impedance and gravity are left out.
    """
    ratio = second if first > 0 else -second / (2 * math.sqrt(max(-first, 1e-12)))
    if ratio <= 0:
        return 1.0
    if ratio >= 1:
        root = math.sqrt(ratio**2 - 1)
        if root < 1e-6:
            return math.exp(-2)
        return math.exp(-ratio / root * math.log((ratio + root) / (ratio - root)))
    root = math.sqrt(1 - ratio**2)
    angle = math.atan2(2 * ratio * root, 2 * ratio**2 - 1)
    return math.exp(-ratio / root * angle)
