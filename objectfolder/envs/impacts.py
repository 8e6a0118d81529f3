"""Impacts and sliding of bodies in a MuJoCo simulation, read from its contacts after each step.

Contacts of MuJoCo are soft: an impact lasts several steps, many times as long as that of the real bodies. So
an impact is not the course of the simulated force. When bodies come to touch at a place where they did not
touch before, the impulses that stop their approach are computed from the bodies' inertia (as for rigid
bodies, all new contacts together), with the restitution that the contact's spring and damper have.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import nnls

_SHARE = (
    0.01  # stiffness that shares an impulse among more contacts than it determines, of the contacts' mean
)
_APART = 0.02  # m; contacts further apart are different ones, but for their motion in three steps


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
class Load:
    """Contacts of two bodies that last; world frame."""

    bodies: tuple[int, int]
    point: np.ndarray  #: (3,) m, mean by force
    normal: np.ndarray  #: (3,) unit vector from the first to the second body
    force: float  #: N
    slip: np.ndarray  #: velocity of the second body's surface against the first one's, (3,) m/s
    rolling: np.ndarray  #: turn of the second body against the first one, about tangents, (3,) rad/s
    friction: float


class ContactReader:
    """Impacts and loads of some bodies, step by step.

    Parameters
    ----------
    model : mujoco.MjModel
    bodies : iterable of int
        Numbers of the bodies whose contacts count.
    """

    def __init__(self, model: mujoco.MjModel, bodies: "np.ndarray | list[int]"):
        self._model = model
        self._counts = np.zeros(model.nbody, bool)
        self._counts[bodies] = True
        #: approach that gravity alone makes in a step: slower ones are not resolved, m/s
        self.slowest = max(float(np.linalg.norm(model.opt.gravity)) * model.opt.timestep, 1e-3)
        self.reset()

    def reset(self) -> None:
        """Forget which bodies touch."""
        self._before: tuple[np.ndarray, np.ndarray] | None = None  # pairs of geoms, and points

    def read(self, data: mujoco.MjData) -> tuple[list[Impact], list[Load]]:
        """Return the impacts and loads of the step that ``mj_step`` made last."""
        contact, model = data.contact, self._model
        geoms = contact.geom
        bodies = model.geom_bodyid[geoms]
        rows = np.flatnonzero(
            self._counts[bodies].any(1) & (contact.efc_address >= 0) & (contact.dist < contact.includemargin)
            & (geoms >= 0).all(1)
        )  # fmt: skip
        before, self._before = self._before, None
        if not len(rows):
            return [], []
        found = _Rows.of(model, data, rows)
        self._before = found.pairs, found.point
        new = np.ones(len(rows), bool)
        if before is not None:
            near = _APART + 3 * model.opt.timestep * np.sqrt(np.square(found.velocity).sum(1))
            away = np.square(found.point[:, None] - before[1]).sum(2)
            same = (found.pairs[:, None] == before[0]).all(2)
            new = ~(same & (away < near[:, None] ** 2)).any(1)
        struck = np.flatnonzero(new & (found.velocity[:, 0] < -self.slowest))
        return self._impacts(data, found, struck), self._loads(data, found, np.flatnonzero(~new))

    def _impacts(self, data: mujoco.MjData, found: "_Rows", struck: np.ndarray) -> list[Impact]:
        """Solve for the impulses that stop the approach of new contacts."""
        if not len(struck):
            return []
        count, model = len(struck), self._model
        motion = np.concatenate([self._jacobian(data, found, k) for k in struck])  # (3 K, nv)
        moved = np.empty_like(motion)
        mujoco.mj_solveM(model, data, moved, motion)
        mobility = motion @ moved.T
        normal = mobility[::3, ::3]
        approach, bounce = (
            -found.velocity[struck, 0],
            np.array([restitution(*ref) for ref in found.solref[struck].tolist()]),
        )
        wanted = (1 + bounce) * approach
        extra = _SHARE * np.trace(normal) / count * np.eye(count)
        impulses, _ = nnls(np.concatenate([normal, extra]), np.concatenate([wanted, np.zeros(count)]))
        out = []
        for k, row in enumerate(struck):
            if impulses[k] <= 0:
                continue
            frame, sliding = found.frame[row], found.velocity[row, 1:]
            speed = float(np.linalg.norm(sliding))
            side = np.zeros(2)
            if speed > 0:
                yields = np.diag(mobility)[3 * k + 1 : 3 * k + 3].mean()
                side = -sliding / speed * min(found.friction[row] * impulses[k], speed / max(yields, 1e-12))
            depth = max(-float(found.distance[row]), 0.0)
            out.append(
                Impact(
                    bodies=found.bodies[row],
                    point=found.point[row],
                    impulse=np.array([impulses[k], *side]) @ frame,
                    normal=float(impulses[k]),
                    speed=float(approach[k]),
                    mass=float(impulses[k] / wanted[k]),
                    lost=float(impulses[k] * approach[k] * (1 - bounce[k]) / 2),
                    late=min(depth / float(approach[k]), model.opt.timestep),
                )
            )
        return out

    def _loads(self, data: mujoco.MjData, found: "_Rows", lasting: np.ndarray) -> list[Load]:
        """Sum the contacts that last, by pairs of bodies."""
        out = []
        pairs: dict[tuple[int, int], list[int]] = {}
        for k in lasting.tolist():
            pairs.setdefault(found.bodies[k], []).append(k)
        for pair, rows in pairs.items():
            force = found.force[rows]
            total = float(force.sum())
            if total <= 0:
                continue
            share = force / total
            velocity = found.velocity[rows] * [0, 1, 1]
            normal = share @ found.frame[rows, 0]
            normal /= max(math.sqrt(normal @ normal), 1e-9)
            slip = share @ (velocity[:, None] @ found.frame[rows])[:, 0]
            turn = data.cvel[pair[1], :3] - data.cvel[pair[0], :3]
            turn -= normal * (normal @ turn)
            friction = float(share @ found.friction[rows])
            out.append(Load(pair, share @ found.point[rows], normal, total, slip, turn, friction))
        return out

    def _jacobian(self, data: mujoco.MjData, found: "_Rows", row: int) -> np.ndarray:
        """Return how the velocity of a contact, in its frame, follows from that of the joints; (3, nv)."""
        sides = np.zeros((2, 3, self._model.nv))
        for side, body in zip(sides, found.bodies[row]):
            mujoco.mj_jac(self._model, data, side, None, found.point[row], body)
        return found.frame[row] @ (sides[1] - sides[0])


@dataclass(frozen=True)
class _Rows:
    """Contacts of a step that count."""

    bodies: list[tuple[int, int]]
    pairs: np.ndarray  #: (K, 2) of geoms
    point: np.ndarray  #: (K, 3)
    frame: np.ndarray  #: (K, 3, 3), rows: normal and two tangents
    velocity: np.ndarray  #: (K, 3) in that frame, before the step
    force: np.ndarray  #: (K,) along the normal
    friction: np.ndarray  #: (K,)
    solref: np.ndarray  #: (K, 2)
    distance: np.ndarray  #: (K,)

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, rows: np.ndarray) -> "_Rows":
        contact = data.contact
        geoms, mu = contact.geom[rows], contact.friction[rows]
        velocity, force = np.zeros((len(rows), 3)), np.zeros(len(rows))
        edged = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        address, dims = contact.efc_address[rows], contact.dim[rows]
        for dim in set(dims.tolist()):
            alike = np.flatnonzero(dims == dim)
            start = address[alike, None]
            if not edged or dim == 1:
                size = min(dim, 3)
                force[alike] = data.efc_force[start[:, 0]]
                velocity[alike, :size] = data.efc_vel[start + np.arange(size)]
            else:  # edges n + mu t and n - mu t of each tangent
                force[alike] = data.efc_force[start + np.arange(2 * (dim - 1))].sum(1)
                v = data.efc_vel[start + np.arange(4)]
                velocity[alike, 0] = (v[:, 0] + v[:, 1]) / 2
                velocity[alike, 1:] = (v[:, ::2] - v[:, 1::2]) / (2 * mu[alike, :2])
        return cls(
            bodies=[tuple(pair) for pair in model.geom_bodyid[geoms].tolist()],
            pairs=geoms,
            point=contact.pos[rows],
            frame=contact.frame[rows].reshape(-1, 3, 3),
            velocity=velocity,
            force=force,
            friction=mu[:, 0],
            solref=contact.solref[rows],
            distance=contact.dist[rows],
        )


def restitution(first: float, second: float) -> float:
    """Return the restitution of a contact of MuJoCo from its ``solref``.

    A spring and a damper stop a body, and cannot pull it back: the contact ends when the force does (Schwager
    and Pöschel, Granular Matter 9, 2007). Impedance and gravity are left out.

    Parameters
    ----------
    first, second : float
        Time constant and damping ratio; negative: stiffness and damping of unit mass.
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
