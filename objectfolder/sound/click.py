"""The click of a strike: sound of the body's recoil as a whole, or acceleration noise.

A body that a strike accelerates pushes air ahead of it and draws air behind it: an oscillating dipole. Small
stiff bodies, whose modes lie above hearing, sound of nothing else. The recoil of a sphere is exact (Koss and
Alfredson, Journal of Sound and Vibration 27, 1973; Chadwick, Zheng and James, Precomputed Acceleration Noise,
SIGGRAPH 2012, for other shapes). Here a body recoils along each of its axes as the sphere of the same dipole
moment, that of the ellipsoid of its convex hull. Its rotation is left out: a sphere's makes no sound.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from objectfolder.sound.synthesis import response_at

AIR_DENSITY = 1.204  #: kg/m^3, at 20 degrees Celsius
SOUND_SPEED = 343.2  #: m/s, at 20 degrees Celsius
_DECAY_EXPONENT = 30.0  # exponent of the decay after which a click is silence


@dataclass(frozen=True)
class Recoil:
    """What the air feels of a rigid body that moves without turning; object frame, metres."""

    mass: float  #: kg
    centre: np.ndarray  #: of the convex hull; (3,)
    axes: np.ndarray  #: principal axes of the hull, in rows; (3, 3)
    radii: np.ndarray  #: of the spheres with the body's dipole moment along each axis; (3,)

    @classmethod
    def of(cls, vertices: np.ndarray, mass: float) -> "Recoil":
        """Return the recoil of a body of some mass, given by points (V, 3) whose convex hull it fills."""
        import trimesh  # queries do without

        hull = trimesh.convex.convex_hull(vertices)
        volume, inertia = hull.volume, hull.moment_inertia
        spread, axes = np.linalg.eigh(np.eye(3) * np.trace(inertia) / 2 - inertia)  # second moments
        half = np.sqrt(5 * spread / volume)
        half *= np.cbrt(volume / (4 / 3 * np.pi * half.prod()))
        moments = volume * (1 + added_mass(half))
        return cls(mass, np.asarray(hull.center_mass), axes.T, np.cbrt(moments / (2 * np.pi)))


def added_mass(half: np.ndarray) -> np.ndarray:
    """Return the mass of fluid that moves with an ellipsoid along each axis, over that which it displaces.

    Of its semi-axes (3,): Lamb, Hydrodynamics, section 114; 1/2 for a sphere.
    """
    from scipy.special import elliprd  # loading it takes a fifth of a second, which queries need not wait

    a, b, c = half**2
    share = half.prod() * 2 / 3 * elliprd([b, c, a], [c, a, b], [a, b, c])
    return share / (2 - share)


def recoil_pressure(
    body: Recoil,
    impulses: np.ndarray,
    listeners: np.ndarray,
    sample_rate: float,
    samples: int,
    contact_time: float,
    delay: bool = False,
) -> np.ndarray:
    """Compute the sound pressure of the recoils of impulses, in pascals; (N, samples) float32.

    A sphere of radius a that accelerates by A(t) gives, at distance r and angle theta to the motion,

        p = rho a^3 / r^2 cos(theta) (c / a)^2 (y + r / c y'),    y'' + 2 (c / a) y' + 2 (c / a)^2 y = A

    from the time at which sound leaves the nearest point of its surface: the recoil is one more damped mode.
    Impulses (N, 3), N s, are half sines of force over the contact time, seconds; listeners (N, 3), object
    frame, metres, are outside the body. With ``delay``, sounds start when they reach the listener, rather
    than with the contact.
    """
    away = np.asarray(listeners, np.float64) - body.centre
    distance = np.linalg.norm(away, axis=1)
    along = (away / distance[:, None]) @ body.axes.T * (np.asarray(impulses, np.float64) @ body.axes.T)
    rate = SOUND_SPEED / body.radii
    strength = AIR_DENSITY * body.radii**3 * rate**2 / body.mass * along / distance[:, None] ** 2
    lag = np.maximum(distance[:, None] - body.radii, 0) / SOUND_SPEED * delay  # (N, 3)
    heard = math.ceil((lag.max(initial=0) + contact_time + _DECAY_EXPONENT / rate.min()) * sample_rate)
    time = torch.arange(min(heard, samples), dtype=torch.float64) / sample_rate
    s = torch.from_numpy(rate * (-1 + 1j))[:, None]
    sounds = np.zeros((len(along), samples), np.float32)
    for sound, gains, late, reach in zip(sounds, torch.from_numpy(strength), lag, distance / SOUND_SPEED):
        since = time - torch.from_numpy(late)[:, None]
        moved = response_at(s, since, contact_time, weight=1 + reach * s)
        sound[: len(time)] = (gains @ moved).numpy()
    return sounds
