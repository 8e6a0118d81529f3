"""Solid textures: colours and patterns as functions of the point on the surface.

Charts evaluate the same function at the same points along their seams, so that seams do not show.
"""

import numpy as np
from scipy.ndimage import map_coordinates

LATTICE = 32  #: period of the noise, cells


def rgb(code: str) -> np.ndarray:
    """Convert a hexadecimal sRGB code such as ``e8dcc4`` to a colour (3,) in [0, 1]."""
    return np.frombuffer(bytes.fromhex(code), np.uint8) / 255


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """Rise smoothly from 0 at ``low`` to 1 at ``high``, or fall if ``low`` > ``high``."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def over(base: np.ndarray, colour: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Blend ``colour`` (3,) or (N, 3) over ``base`` (N, 3) with opacity ``cover`` (N,) in [0, 1]."""
    return base + cover[:, None] * (colour - base)


def stroke(distance: np.ndarray, half_width: float, soft: float) -> np.ndarray:
    """Return the opacity (N,) of a band of ``half_width`` about ``distance`` 0 with soft edges."""
    return smoothstep(half_width + soft / 2, half_width - soft / 2, np.abs(distance))


def lattice(seed: int) -> np.ndarray:
    """Draw random values (LATTICE, LATTICE, LATTICE) of unit variance for `noise`."""
    return np.random.default_rng(seed).standard_normal((LATTICE,) * 3)


def noise(points: np.ndarray, values: np.ndarray, octaves: int = 1) -> np.ndarray:
    """Evaluate fractal value noise (N,) of zero mean and about unit variance.

    Points (N, 3) are in cells of the coarsest octave, ``values`` from `lattice`. Each octave has twice the
    frequency and half the amplitude of the one before.
    """
    total = np.zeros(len(points))
    for k in range(octaves):
        at = points * 2**k + 7.31 * k  # offset between the octaves' lattice planes
        cell = np.floor(at)
        t = at - cell
        total += map_coordinates(values, (cell + t * t * (3 - 2 * t)).T, order=1, mode="grid-wrap") / 2**k
    return total * 1.7 / np.sqrt(sum(0.25**k for k in range(octaves)))


def wood(
    points: np.ndarray, scale: float, seed: int, light: np.ndarray | None = None,
    dark: np.ndarray | None = None, axis: np.ndarray | None = None, detail: float = 1.0,
) -> np.ndarray:  # fmt: skip
    """Return the colour (N, 3) of a block of wood with growth rings, fibres and pores.

    About nine rings cross the ``scale``, m, of the block that the seed selects. ``light`` and ``dark`` (3,)
    are the colours of early and late wood, ``axis`` (3,) is the unit vector along the grain, ``detail`` a
    factor on the frequency of rings, fibres and pores.
    """
    values = lattice(seed)
    if axis is None:
        axis = np.array([0.93, 0.30, 0.21])
        axis /= np.linalg.norm(axis)
    # Any perpendicular direction; the reference changes for an upright axis.
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis], 1)
    trunk = points / scale @ frame  # across, across, along the grain
    warp = noise(trunk * [1.6, 1.6, 0.7], values, 2)
    radius = np.hypot(trunk[:, 0] + 0.62, trunk[:, 1] - 0.50) + 0.022 * warp
    ring = 9.0 * detail * radius + 0.12 * noise(trunk * [3.0, 3.0, 1.0] + 11, values)
    year, phase = np.floor(ring), ring % 1.0
    # Late wood darkens slowly through the season and ends abruptly at the next ring.
    late = smoothstep(0.15, 0.92, phase) * smoothstep(1.0, 0.95, phase)
    vigour = noise(np.stack([year * 0.77, year * 0.31, year * 0.13], 1), values)
    fibre = noise(trunk * detail * [70.0, 70.0, 3.0], values, 2)
    pore = smoothstep(1.5, 2.4, noise(trunk * detail * [110.0, 110.0, 5.0] + 3, values))
    deep = rgb("5f3517") if dark is None else 0.55 * dark
    light = rgb("e2b97f") if light is None else light
    dark = rgb("a8683a") if dark is None else dark
    colour = over(np.broadcast_to(light, points.shape), dark, np.clip(late * (0.72 + 0.13 * vigour), 0, 1))
    colour = colour * (1 + 0.045 * fibre + 0.03 * warp)[:, None]
    return over(colour, deep, 0.35 * pore)
