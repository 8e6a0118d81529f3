"""Contact microphones in a simulation, and the damping of soft pads that touch what they listen to."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
import torch

from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.voice import Voice
from objectfolder.sim.impacts import Loads
from objectfolder.sim.sounding import Sounding, site_number
from objectfolder.stored.surface import TOLERANCE

#: Motion of a touched point, of the object's longest side, and turn of a pad that change what is heard there.
MOVED, TURNED = 0.02, math.radians(3)
SHEAR = 1 / 3  #: stiffness of a pad along its face, over that along its normal: of a material of fixed volume
MAX_DAMPING = 0.5  #: decay rate that pads may add to a mode, of its angular frequency
_PLACES = 256  # of a surface, whose motion says how loud a mode can become


@dataclass(frozen=True)
class Pad:
    """A soft pad of a gripper: a block of elastomer on a stiff back.

    The defaults are 1 cm^2 of silicone, 4 mm thick, of 1.1 MPa and 1100 kg/m^3. How much silicone loses
    differs from one to the next; 0.2 is assumed.
    """

    stiffness: float = 2.8e4  #: along its normal, N/m
    mass: float = 4.4e-4  #: kg
    loss: float = 0.2  #: loss factor

    def __post_init__(self) -> None:
        for name, least in (("stiffness", 0.0), ("mass", 0.0), ("loss", 0.0)):
            if finite_number(f"{name} of a pad", getattr(self, name)) < least:
                raise ObjectFolderError(f"{name} of a pad is {getattr(self, name)}, expected 0 or more")

    def dynamic_stiffness(self, angular: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Return force over displacement at angular frequencies (M,), rad/s; complex, N/m.

        Waves run through the block to its back and return: K x cot x with K = k (1 + i loss) and
        x = w sqrt(m / K) (Cremer and Heckl, Structure-Borne Sound, 1988: a rod with a fixed end). At low
        frequencies, or without mass, that is K. ``share`` is a factor of the stiffness k.
        """
        spring = self.stiffness * share * (1 + 1j * self.loss)
        if not spring:
            return np.zeros(len(angular), np.complex128)
        x = angular * np.sqrt(self.mass / spring)
        out: np.ndarray = spring * np.divide(x, np.tan(x), out=np.ones_like(x), where=x != 0)
        return out

    def damping(self, angular: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the decay rates that the pad adds to modes where it touches, 1/s; (M,).

        First order in the stiffness: a mode of angular frequency w, rad/s, that moves the touched point by
        phi, kg^-1/2, gets Im K(w) phi^2 / (2 w). That is half of w times the loss factor of the pad, by its
        share in the energy of the mode (Johnson and Kienholz, AIAA Journal 20, 1982). ``along`` (M,) are the
        motions along the pad's normal, ``across`` those along its face.
        """
        lost = self.dynamic_stiffness(angular).imag * along**2
        lost += self.dynamic_stiffness(angular, SHEAR).imag * across**2
        return np.minimum(lost / (2 * angular), MAX_DAMPING * angular)


@dataclass(frozen=True)
class PadTouch:
    """A pad on an object; object frame, m."""

    pad: int  #: number in `Pickups`
    point: np.ndarray  #: (3,)
    axis: np.ndarray  #: (3,) unit vector out of the pad

    def is_like(self, other: "PadTouch", scale: float) -> bool:
        """Whether the same pad touches at about the same place."""
        near = float(np.linalg.norm(self.point - other.point)) < MOVED * scale
        return self.pad == other.pad and near and float(self.axis @ other.axis) > math.cos(TURNED)


@dataclass
class _Place:
    """A pad: its site, its body, and the channels that hear it."""

    site: int
    body: int
    pad: Pad
    channels: list[int] = field(default_factory=list)


class Pickups:
    """Contact microphones, and pads that touch objects.

    Microphones are sites: those of an object's body are glued to its surface and measure along the outward
    normal; those of other bodies are on a pad, and measure along the x axis of the site, out of the pad.

    Parameters
    ----------
    model : mujoco.MjModel
    names : sequence of str
        Sites of the microphones, one channel each.
    pads : mapping from str to Pad
        Pads by their sites. Microphones on bodies that are no objects are pads, too.
    objects : mapping from int to (Sounding, Voice)
        By the numbers of their bodies.

    Raises
    ------
    ObjectFolderError
        If there is no such site, a microphone is off the surface of its object, a pad is on an object or
        none, or two pads are on one body.
    """

    def __init__(
        self, model: mujoco.MjModel, names: Sequence[str], pads: Mapping[str, Pad],
        objects: Mapping[int, tuple[Sounding, Voice]],
    ):  # fmt: skip
        self.channels = len(names)
        self._glued: dict[int, list[tuple[int, np.ndarray]]] = {}  # by body: channel and motion (M,)
        self._pads: list[_Place] = []
        for name, pad in pads.items():
            if not isinstance(pad, Pad):
                raise ObjectFolderError(
                    f"pads: {quoted(name)} is of type {type(pad).__name__}, expected a Pad"
                )
            self._add_pad(model, site_number(model, name, "pads"), pad, objects)
        for channel, name in enumerate(names):
            site = site_number(model, name, "pickup")
            body = int(model.site_bodyid[site])
            if body in objects:
                motion = _glued_motion(name, *objects[body], model.site_pos[site])
                self._glued.setdefault(body, []).append((channel, motion))
                continue
            known = [place for place in self._pads if place.site == site]
            place = known[0] if known else self._add_pad(model, site, Pad(), objects)
            place.channels.append(channel)

    def _add_pad(
        self, model: mujoco.MjModel, site: int, pad: Pad, objects: Mapping[int, tuple[Sounding, Voice]]
    ) -> _Place:
        name, body = model.site(site).name, int(model.site_bodyid[site])
        if body in objects:
            raise ObjectFolderError(
                f"pads: site {name!r} is on the object {model.body(body).name!r}, expected one of a gripper"
            )
        for other in self._pads:
            if other.body == body:
                raise ObjectFolderError(
                    f"pads: sites {model.site(other.site).name!r} and {name!r} are both on body "
                    f"{model.body(body).name!r}, so which one touches is not known; give each pad a body"
                )
        self._pads.append(_Place(site, body, pad))
        return self._pads[-1]

    def touches(self, data: mujoco.MjData, loads: Loads | None) -> dict[int, list[PadTouch]]:
        """Return what the pads touch, by the numbers of the objects' bodies."""
        found: dict[int, list[PadTouch]] = {}
        if loads is None:
            return found
        for pair, point in zip(loads.bodies.tolist(), loads.point):
            for number, place in enumerate(self._pads):
                if place.body in pair:
                    body = pair[1 - pair.index(place.body)]
                    turn = data.xmat[body].reshape(3, 3)
                    out = data.site_xmat[place.site].reshape(3, 3)[:, 0]
                    touch = PadTouch(number, (point - data.xpos[body]) @ turn, out @ turn)
                    found.setdefault(body, []).append(touch)
        return found

    def poles(self, voice: Voice, touches: Sequence[PadTouch]) -> np.ndarray:
        """Return the poles of an object (M + 3,), 1/s, that pads touch."""
        poles = voice.poles.copy()
        angular = poles.imag[: voice.modes]
        for touch in touches:
            motion = _motion(voice, touch.point)
            along = touch.axis @ motion
            across = np.sqrt((np.square(motion).sum(0) - along**2).clip(min=0))
            poles[: voice.modes] -= self._pads[touch.pad].pad.damping(angular, along, across)
        return poles

    def weights(self, body: int, voice: Voice, poles: np.ndarray, touches: Sequence[PadTouch]) -> np.ndarray:
        """Return how microphones hear phasors of an object with these poles: m/s^2; (C, M + 3) complex."""
        moved = np.zeros((self.channels, len(poles)))
        for channel, motion in self._glued.get(body, []):
            moved[channel, : voice.modes] = motion
        for touch in touches:
            moved[self._pads[touch.pad].channels, : voice.modes] = touch.axis @ _motion(voice, touch.point)
        return moved * poles**2 / poles.imag


def loudest(file: ObjectFile, voice: Voice) -> np.ndarray:
    """Return the greatest weights that a microphone on an object can have; (M + 3,)."""
    places = file.sample_surface(_PLACES) * (voice.scale / file.scale)
    out = np.zeros(len(voice.poles))
    for axis in np.eye(3):
        np.maximum(out, abs(voice.gains(places, axis[None])).max(0), out=out)
    out[voice.modes :] = 0
    most: np.ndarray = out * abs(voice.poles**2 / voice.poles.imag)
    return most


def _motion(voice: Voice, point: np.ndarray) -> np.ndarray:
    """Return how modes move the surface nearest to a point (3,), m; (3, M) kg^-1/2."""
    return voice.gains(np.tile(point, (3, 1)), np.eye(3))[:, : voice.modes]


def _glued_motion(name: str, thing: Sounding, voice: Voice, point: np.ndarray) -> np.ndarray:
    """Return how modes move the surface at a point (3,), m, along its outward normal; (M,) kg^-1/2."""
    file, ratio = thing.file, voice.scale / thing.file.scale
    (spot,), (distance,) = file.nearest(point[None] / ratio)
    if distance > TOLERANCE * file.scale:
        raise ObjectFolderError(
            f"pickup: site {name!r} is {distance * ratio:.3g} m off the surface of {file.key}, expected at "
            f"most {TOLERANCE * voice.scale:.3g} m; put it on ObjectFile.nearest of its place"
        )
    normal = np.asarray(file.surface.grid.normals(torch.from_numpy(spot[None] / file.scale)))[0]
    return voice.gains(spot[None] * ratio, normal[None])[0, : voice.modes]
