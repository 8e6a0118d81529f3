"""Lights of a view: points, distant lights, the studio, and pictures of surroundings.

Radiance is linear in the lights, so a view under several is the sum of views under each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from objectfolder.base.checks import finite_number, real_array
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.vision.cameras import MAX_COORDINATE

MAX_COLOR = 1e12  #: of a colour: its light near a surface still fits into single precision
#: Distance from which a point light counts as parallel: nets learnt from near and parallel ones
PARALLEL_DISTANCE = 30.0
KEY_DISTANCE = 2.4  #: of the lights of the studio, unit frame

#: Three numbers, such as a position or a linear colour.
Triple = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class PointLight:
    """A point light.

    Raises ObjectFolderError if a number is not finite, the position too far away, or the colour negative or
    beyond `MAX_COLOR`.
    """

    position: Triple  #: three numbers, unit frame
    #: Three numbers, linear: the radiance of a white Lambertian surface that faces the light at distance 1
    color: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _triple("position of a light", self.position))
        if np.abs(self.position).max() > MAX_COORDINATE:
            raise ObjectFolderError(
                f"position of a light is {quoted(self.position)}, expected coordinates of at most "
                f"{MAX_COORDINATE:g}, in the unit frame (longest side 1); give a DistantLight instead"
            )
        object.__setattr__(self, "color", _color(self.color))

    @property
    def place(self) -> np.ndarray:
        """Position, (3,), as shaders take it."""
        return np.array(self.position)


@dataclass(frozen=True)
class DistantLight:
    """Parallel light, as of the sun.

    Raises ObjectFolderError if a number is not finite, the direction has no length, or the colour is negative
    or beyond `MAX_COLOR`.
    """

    direction: Triple  #: three numbers towards the light; any length but 0
    #: Three numbers, linear: the radiance of a white Lambertian surface that faces it, its irradiance over pi
    color: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        way = np.array(_triple("direction of a light", self.direction))
        length = math.hypot(*way)
        if not 0 < length < math.inf:
            raise ObjectFolderError(
                f"direction of a light is {quoted(self.direction)}, of length {length:g}; expected a finite "
                "length above 0"
            )
        object.__setattr__(self, "direction", tuple((way / length).tolist()))
        object.__setattr__(self, "color", _color(self.color))

    @property
    def place(self) -> np.ndarray:
        """Unit vector towards the light and a zero, (4,), as shaders take it: homogeneous coordinates."""
        return np.append(self.direction, 0.0)


#: A light of a view.
Lamp = PointLight | DistantLight


def toward(light: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Return vectors from points (S, 3) to a light; (S, 3), of unit length if the light is distant.

    A light is the position (3,) of a point light, or a unit vector and 0 (4,): a distant light.
    """
    return light - points if len(light) == 3 else light[:3] + torch.zeros_like(points)


def studio(azimuth: float = 35.0, elevation: float = 50.0) -> list[PointLight]:
    """Return the three lights of a studio: a main one, a weaker one from the other side, one from behind.

    Parameters
    ----------
    azimuth, elevation : float
        Of the main light, degrees: from the x axis towards the y axis, and above the horizon.
    """
    azimuth, elevation = finite_number("azimuth", azimuth), finite_number("elevation", elevation)

    def light(turn: float, height: float, strength: float, tint: tuple[float, float, float]) -> PointLight:
        around, above = math.radians(azimuth + turn), math.radians(height)
        flat = math.cos(above)
        way = np.array([math.cos(around) * flat, math.sin(around) * flat, math.sin(above)])
        return PointLight(KEY_DISTANCE * way, strength * KEY_DISTANCE**2 * np.array(tint))

    return [
        light(0, elevation, 0.82, (1, 0.985, 0.96)),
        light(-100, 20, 0.34, (0.94, 0.97, 1)),
        light(150, 45, 0.5, (1, 1, 1)),
    ]


def choose_lamps(lights: str | Sequence[Any] | None) -> list[Lamp]:
    """Return the lights that a query names, "studio" or lights; far point lights as distant ones.

    Raises ObjectFolderError if it is anything else.
    """
    if lights is None:
        return []
    if isinstance(lights, str):
        if lights == "studio":
            return list(studio())
        raise ObjectFolderError(f"lights is {quoted(lights)}, expected 'studio' or a list of lights")
    found: list[Any] = list(lights) if isinstance(lights, list | tuple) else [lights]
    for lamp in found:
        if not isinstance(lamp, PointLight | DistantLight):
            raise ObjectFolderError(
                f"lights holds {quoted(lamp)}, expected PointLight or DistantLight of "
                "objectfolder.vision.lighting; or give positions as `light`"
            )
    return [_parallel(lamp) if isinstance(lamp, PointLight) else lamp for lamp in found]


def _parallel(lamp: PointLight) -> Lamp:
    squared = float(np.square(lamp.place).sum())
    if squared <= PARALLEL_DISTANCE**2:
        return lamp
    return DistantLight(lamp.position, np.array(lamp.color) / squared)


def _triple(name: str, values: Triple) -> tuple[float, ...]:
    array = real_array(name, values)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ObjectFolderError(f"{name} is {quoted(array.tolist())}, expected three finite numbers")
    return tuple(array.tolist())


def _color(values: Triple) -> tuple[float, ...]:
    color = _triple("colour of a light", values)
    if min(color) < 0:
        raise ObjectFolderError(f"colour of a light is {quoted(color)}, expected no negative number")
    if max(color) > MAX_COLOR:
        raise ObjectFolderError(f"colour of a light is {quoted(color)}, expected at most {MAX_COLOR:g}")
    return color
