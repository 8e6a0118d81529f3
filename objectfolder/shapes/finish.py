"""Finishes shared by the generators: solid textures with roughness and metallic.

Every finish is a function of the point in space, so that charts agree along their seams.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from objectfolder.base.errors import ObjectFolderError
from objectfolder.shapes.atlas import Paint
from objectfolder.shapes.texture import lattice, noise, over, rgb, smoothstep, wood

BOARD = 0.2  #: object size, m, above which the width of wood rings no longer grows with the object
#: Rotates the noise lattice off the axes of the object, to hide its rows and period.
TILT = Rotation.from_euler("zyx", [0.71, 0.43, 1.13]).as_matrix()
#: Below 1, because pure metal is black in a scene with one point light and nothing to reflect.
METALLIC = 0.4
PATTERNS = ("stripes", "dots", "waves")  #: patterns of ``print``, chosen by the seed


@dataclass(frozen=True)
class Finish:
    """Colours, roughness and metallic of a surface."""

    paint: Paint
    roughness: float
    metallic: float


@dataclass(frozen=True)
class _Look:
    """Arguments of a finish: lengths in m, colours (3,) in [0, 1]."""

    size: float
    color: np.ndarray
    accent: np.ndarray
    seed: int
    axis: np.ndarray | None  #: unit vector of the grain
    values: np.ndarray  #: `lattice` of the seed


@dataclass(frozen=True)
class _Recipe:
    paint: Callable[[np.ndarray, _Look], np.ndarray]
    color: str
    accent: str | None  #: None: same as the colour
    roughness: float
    metallic: float


def finish(
    name: str, size: float, color: str | None = None, accent: str | None = None, seed: int = 0,
    axis: Sequence[float] | None = None,
) -> Finish:  # fmt: skip
    """Look up a finish and fit it to an object; equal arguments give equal colours.

    Parameters
    ----------
    name : str
        A key of `FINISHES`.
    size : float
        Longest side of the object, m; sets the scale of the pattern.
    color, accent : str, optional
        Hexadecimal sRGB such as ``e8dcc4``; default: the finish's own. The accent is the colour of the glaze
        pooled towards z = 0, late wood, the patina of metal, the specks of plastic, the ink of a print and
        the streaks of glass.
    seed : int
        Selects the piece; for ``print`` also the pattern: stripes, dots, waves, in turn.
    axis : sequence of 3 floats, optional
        Direction of the grain of wood and of the strokes on metal. Default: wood roughly along x, metal
        turned about z.

    Raises
    ------
    ObjectFolderError
        If the finish is unknown, a colour is not six hexadecimal digits, the size is not positive, the seed
        is not a whole number from 0, or the axis has no direction.
    """
    recipe = FINISHES.get(name) if isinstance(name, str) else None
    if recipe is None:
        raise ObjectFolderError(f"unknown finish {name!r}: expected one of {', '.join(FINISHES)}")
    if not isinstance(size, int | float) or not math.isfinite(size) or size <= 0:
        raise ObjectFolderError(f"finish {name}: size={size!r}: expected a positive, finite number of metres")
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ObjectFolderError(f"finish {name}: seed={seed!r}: expected a whole number from 0")
    base = _colour(name, "color", recipe.color if color is None else color)
    second = recipe.accent if accent is None else accent
    ink = base if second is None else _colour(name, "accent", second)
    grain = None if axis is None else _direction(name, axis)
    look = _Look(float(size), base, ink, seed, grain, lattice(seed))
    return Finish(lambda points: np.clip(recipe.paint(points, look), 0, 1), recipe.roughness, recipe.metallic)


def _colour(name: str, parameter: str, code: str) -> np.ndarray:
    if not isinstance(code, str) or re.fullmatch("[0-9a-fA-F]{6}", code) is None:
        raise ObjectFolderError(
            f"finish {name}: {parameter}={code!r}: expected six hexadecimal digits in quotes, like 'e8dcc4'"
        )
    return rgb(code)


def _direction(name: str, axis: Sequence[float]) -> np.ndarray:
    vector = np.asarray(axis, np.float64)
    length = np.linalg.norm(vector) if vector.shape == (3,) else 0.0
    if not np.isfinite(length) or length == 0:
        raise ObjectFolderError(f"finish {name}: axis={axis!r}: expected three numbers, not all zero")
    return vector / length


def _glaze(points: np.ndarray, look: _Look) -> np.ndarray:
    """Stoneware glaze: soft clouds, iron specks, and the accent pooled towards the foot."""
    at = points @ TILT / (look.size / 0.1)
    clouds = noise(at / 0.012, look.values, 3)
    colour = np.broadcast_to(look.color, points.shape)
    if look.accent is not look.color:
        veil = noise(at / 0.030 + 17, look.values, 3)
        pooled = smoothstep(0.42, 0.08, points[:, 2] / look.size + 0.05 * veil)
        colour = over(colour, look.accent, 0.92 * pooled)
    specks = smoothstep(2.2, 2.7, noise(at / 0.0012 + 5, look.values))
    return over(colour * (1 + 0.022 * clouds)[:, None], 0.30 * colour, 0.6 * specks)


def _wood(points: np.ndarray, look: _Look) -> np.ndarray:
    """Planed timber, whose rings are as narrow on furniture as on a board."""
    detail = max(1.7, look.size / BOARD)
    return wood(points, look.size, look.seed, look.color, look.accent, look.axis, detail)


def _brushed(points: np.ndarray, look: _Look) -> np.ndarray:
    """Metal with fine strokes along the axis, or turned about z, under a cloudy patina."""
    at = points / look.size
    if look.axis is not None:
        along = at @ look.axis
        strokes = 190 * (at - along[:, None] * look.axis) + 2.5 * along[:, None] * look.axis
    else:
        r = np.hypot(at[:, 0], at[:, 1])
        turn = at[:, :2] / np.maximum(r, 1e-9)[:, None]
        # The slant keeps rings on flats as fine as bands on upright walls.
        around = 1.5 * turn * np.sqrt(np.minimum(r, 1))[:, None]
        strokes = np.column_stack([around, 170 * at[:, 2] + 130 * r])
    marks = noise(strokes, look.values, 3)
    cloud = noise(at * 3.1, look.values, 4)
    colour = look.color * (1 + 0.055 * marks + 0.02 * cloud)[:, None]
    return over(colour, look.accent, 0.22 * smoothstep(0.3, 2.4, cloud))


def _cast(points: np.ndarray, look: _Look) -> np.ndarray:
    """Sand-cast or hammered metal: an embossed grain, worn lighter here and there."""
    at = points @ TILT / min(look.size / 90, 0.004)
    toward = np.array([0.32, 0.21, 0.45])  # light direction of the embossing, in grains
    relief = noise(at, look.values, 2) - noise(at + toward, look.values, 2)
    cloud = noise(points / look.size * 3.7 + 3, look.values, 4)
    pits = smoothstep(1.6, 2.6, noise(at * 0.8 + 9, look.values))
    plain = np.broadcast_to(look.color, points.shape)
    colour = over(plain, look.accent, 0.30 * smoothstep(0.2, 2.2, cloud))
    return over(colour * (1 + 0.16 * relief + 0.05 * cloud)[:, None], 0.45 * colour, 0.5 * pits)


def _plastic(points: np.ndarray, look: _Look) -> np.ndarray:
    """Moulded plastic: one colour with a faint, soft speckle."""
    at = points @ TILT / look.size
    mottle = noise(at * 160, look.values, 2)
    drift = noise(at * 2.3 + 5, look.values, 2)
    fleck = smoothstep(1.9, 2.4, noise(at * 110 + 11, look.values))
    return over(look.color * (1 + 0.012 * mottle + 0.015 * drift)[:, None], look.accent, 0.5 * fleck)


def _print(points: np.ndarray, look: _Look) -> np.ndarray:
    """Ink in stripes, dots or waves on a plain ground."""
    at = points / look.size
    pattern = PATTERNS[look.seed % len(PATTERNS)]
    if pattern == "stripes":
        # Tilted towards x, so that level flats have stripes too.
        phase = np.abs((at @ [0.35, 0.0, 0.95]) * 9.0 % 1.0 - 0.5)
        ink = smoothstep(0.26, 0.24, phase) - smoothstep(0.10, 0.08, phase)
    elif pattern == "dots":
        places = 0.5 + 0.3 * np.tanh(np.stack([lattice(look.seed + k) for k in range(3)], -1))
        ink = smoothstep(1.0, 0.93, _nearest_dot(at @ TILT * 11.0, places) / 0.33)
    else:
        swell = at[:, 2] * 7.0 + 0.42 * noise(at * 2.6, look.values, 2)
        ink = smoothstep(0.22, 0.20, np.abs(swell % 1.0 - 0.5))
    colour = over(np.broadcast_to(look.color, points.shape), look.accent, ink)
    return colour * (1 + 0.014 * noise(at @ TILT * 90, look.values, 2))[:, None]


def _nearest_dot(at: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Compute the distance (N,) to the nearest dot; `places` are the dots' positions in their cells."""
    cell = np.floor(at)
    near = np.where(at - cell < 0.5, -1, 1)  # only neighbours on this side come close
    nearest = np.full(len(at), np.inf)
    for step in np.ndindex(2, 2, 2):
        other = cell + near * step
        index = (other % places.shape[:3]).astype(int)
        nearest = np.minimum(nearest, np.sum((other + places[tuple(index.T)] - at) ** 2, axis=1))
    return np.sqrt(nearest)


def _glass(points: np.ndarray, look: _Look) -> np.ndarray:
    """Tinted glass with faint streaks and small bubbles."""
    at = points / look.size
    streak = noise(at * [4.0, 4.0, 1.2] + 0.35 * noise(at * 3, look.values)[:, None], look.values, 3)
    bubble = smoothstep(2.6, 2.9, noise(at @ TILT * 70 + 3, look.values))
    plain = np.broadcast_to(look.color, points.shape)
    colour = over(plain, look.accent, 0.45 * smoothstep(-0.8, 2.2, streak))
    return over(colour, np.ones(3), 0.3 * bubble)


#: Finishes by name.
FINISHES: dict[str, _Recipe] = {
    "glaze": _Recipe(_glaze, "ece4d3", None, 0.25, 0.0),
    "wood": _Recipe(_wood, "e2b97f", "a8683a", 0.55, 0.0),
    "brushed": _Recipe(_brushed, "aab0b6", "7d7566", 0.35, METALLIC),
    "cast": _Recipe(_cast, "45464a", "6b6259", 0.60, METALLIC / 2),
    "plastic": _Recipe(_plastic, "3f86b8", None, 0.40, 0.0),
    "print": _Recipe(_print, "f2ede2", "c2452f", 0.40, 0.0),
    "glass": _Recipe(_glass, "cfe6e0", "9cc9bf", 0.08, 0.0),
}
