"""Motor targets of one whole grasp over time: reach, close, lift, hold, put back, release."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from objectfolder.envs.gripper import OPEN, SHUT

LIFT = 0.1  #: height to which objects are lifted, m
LIFTING = 0.5  #: duration of the lift, and of the hold after it, s
SQUEEZE = 0.1  #: time in which closed jaws build up their force, s


@dataclass(frozen=True)
class PhaseTargets:
    """Targets at T time steps."""

    phases: list[str]  #: (T,) name of the phase
    heights: np.ndarray  #: (T,) of the hand above the grasp, m
    jaws: np.ndarray  #: (T,) of each jaw, m


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """Return positions from 0 to 1 of the smoothest motion, at shares of its duration in [0, 1]."""
    return 10 * share**3 - 15 * share**4 + 6 * share**5


def phase_targets(timestep: float, speed: float) -> PhaseTargets:
    """Return the targets of a grasp that starts `LIFT` above it, with jaws that close at ``speed`` (m/s)."""
    travel = OPEN / speed
    closing = travel + SQUEEZE

    def keep(position: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda share: np.full(len(share), position)

    def close(share: np.ndarray) -> np.ndarray:
        return np.where(share < travel / closing, OPEN - speed * closing * share, SHUT)

    def release(share: np.ndarray) -> np.ndarray:
        return OPEN * np.minimum(2 * share, 1)

    # Name, seconds, height at the end, jaws over the phase.
    phases = (
        ("reach", 0.6, 0.0, keep(OPEN)),
        ("close", closing, 0.0, close),
        ("lift", LIFTING, LIFT, keep(SHUT)),
        ("hold", LIFTING, LIFT, keep(SHUT)),
        ("put back", LIFTING, 0.0, keep(SHUT)),
        ("release", 0.5, 0.0, release),
    )
    start, names, heights, jaws = LIFT, [], [], []
    for name, seconds, end, targets in phases:
        share = np.linspace(0, 1, round(seconds / timestep) + 1)[1:]
        names += [name] * len(share)
        heights.append(start + (end - start) * minimum_jerk(share))
        jaws.append(targets(share))
        start = end
    return PhaseTargets(names, np.concatenate(heights), np.concatenate(jaws))
