"""Sound of a running MuJoCo simulation: contacts in, pascals at a listener or vibration at pickups out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from objectfolder.base.checks import finite_number, real_array, require_memory, whole_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import Material, material
from objectfolder.objectfile.voice import Voice
from objectfolder.sim.impacts import ContactReader, Impact, Loads
from objectfolder.sim.pickups import Pad, PadTouch, Pickups, loudest
from objectfolder.sim.sounding import Objects, Sounding, check_body, find_bodies, site_number
from objectfolder.sim.state import DYNAMICS, SHAPES, STRUCTURE, StateCheck, divergences, require_compiled
from objectfolder.sound.contact import effective_modulus, hertz_time
from objectfolder.sound.scrape import Scrapes, scrape_force
from objectfolder.sound.stream import ModalStream, Pulse, pulse_gain
from objectfolder.sound.synthesis import checked_sample_rate

MAX_TIME_STEP = 0.01  #: of a simulation that can be heard, s; bounces are missed beyond
ROUNDING = 0.05  #: radius of an object's surface where it touches, of its longest side; assumed
#: Turn, and relative change of the distance, of the listener that change what it hears.
LISTENER_ANGLE, LISTENER_DISTANCE = math.radians(3), 0.03
LISTEN_INTERVAL = 0.004  #: time between two computations, at least, s
MIN_SLIP = 1e-3  #: m/s; slower contacts make no noise
_CLOCK_TOLERANCE = 1e-9  # s, that the clock of a long simulation rounds off


@dataclass(frozen=True)
class Strike:
    """An impact on an object, as it was heard; object frame, metres."""

    body: str
    start: int  #: sample at which its sound begins
    point: np.ndarray  #: (3,)
    impulse: np.ndarray  #: (3,) N s
    contact_time: float  #: s
    speed: float  #: of approach, m/s
    energy: float  #: that its modes took, J
    lost: float  #: energy that the impact took from the motion of both bodies, J


@dataclass(frozen=True)
class _Body:
    """A sounding body."""

    name: str
    number: int  #: in the model
    row: int  #: in the stream
    voice: Voice
    thing: Sounding  #: that it is


class Hearing:
    """What a listener, or contact microphones, hear of the objects in a MuJoCo simulation.

    Call `hear` after each ``mj_step``. The sound lags one step behind the simulation, so that impacts start
    at the sample at which bodies met. See docs/senses.md for what is modelled.

    Parameters
    ----------
    model : mujoco.MjModel
        Any scene with bodies that `objectfolder.sim.body.add_body` or ``objectfolder export mjcf`` made.
    objects : mapping from str to ObjectFile or Sounding, or iterable of ObjectFile
        Objects by the names of their bodies; without names, these are their keys.
    listener : str or (3,) array, optional
        Name of a site, or a place, world frame, m: sound is pressure there, Pa. Give either this or
        ``pickup``.
    sample_rate : float
        Hz.
    surroundings : str or Material
        Material of everything else that collides, which makes no sound.
    seed : int
        Of the noise of contacts that slide or roll.
    pickup : str or sequence of str, optional
        Sites of contact microphones: sound is acceleration there, m/s^2, without the motion of objects as a
        whole. A site of an object's body is on its surface, and measures along the outward normal; a site of
        a gripper's pad hears the object that the pad touches, along the site's x axis.
    pads : mapping from str to Pad, optional
        Soft pads by their sites: they damp what their bodies touch. Pads with a microphone are
        `objectfolder.sim.pickups.Pad` with its defaults, unless given here.

    Attributes
    ----------
    sample_rate : float
    strikes : tuple of Strike
        Of the last step.

    Raises
    ------
    ObjectFolderError
        If the scene lacks an object, or has it in another size or material, or one body for two; if the model
        is not compiled; if there is neither one listener nor a pickup, or there are both; if a pickup is off
        the surface; if the time step is longer than the contacts or `MAX_TIME_STEP`; if a body's modes are
        all above half the sample rate. `hear` raises it if the simulation was reset or jumped, anything that
        it reads of it is not finite, the data are of another model, or the model was changed so that an
        object is not as its file says.

    Examples
    --------
    >>> hearing = Hearing(model, [ObjectFile.sample("bell")], listener=[0.5, 0, 0.3])
    >>> sound = hearing.simulate(data, 500)
    """

    def __init__(
        self, model: mujoco.MjModel, objects: Objects,
        listener: "str | Sequence[float] | np.ndarray | None" = None,
        sample_rate: float = 48000, surroundings: str | Material = "wood", seed: int = 0,
        pickup: str | Sequence[str] | None = None, pads: Mapping[str, Pad] | None = None,
    ):  # fmt: skip
        require_compiled(model)
        self.sample_rate = checked_sample_rate(sample_rate)
        self._model, self._seed = model, whole_number("seed", seed)
        self._step = float(model.opt.timestep)
        _check_step(model)
        if (listener is None) == (pickup is None):
            raise ObjectFolderError("give either listener or pickup: a Hearing is of one of both")
        self._listener = None if listener is None else _listener(model, listener)
        names = [pickup] if isinstance(pickup, str) else [] if pickup is None else _names(pickup)
        self._alone = isinstance(pickup, str)
        stuff = surroundings if isinstance(surroundings, Material) else material(surroundings)
        self._surroundings = stuff
        placed = find_bodies(model, objects)
        fixed, adaptable = (*STRUCTURE, "opt.timestep", "opt.cone"), (*SHAPES, *DYNAMICS)
        self._state = StateCheck(model, "Hearing", [number for number, _, _ in placed], fixed, adaptable)
        self._bodies = {
            number: _Body(name, number, row, one.file.voice(self.sample_rate, one.material, one.scale), one)
            for row, (number, name, one) in enumerate(placed)
        }
        self._check_model()
        self._numbers = np.array([*self._bodies])
        self._sounds = np.isin(np.arange(model.nbody), self._numbers)
        self._surfaces: dict[tuple[int, int], tuple[float, float, float]] = {}  # of pairs that slide
        things = {number: (body.thing, body.voice) for number, body in self._bodies.items()}
        self._pickups = Pickups(model, names, pads or {}, things) if names or pads else None
        voices = [body.voice for body in self._bodies.values()]
        longest = math.ceil(self.sample_rate * self._step) + 1
        needed = 16 * len(voices) * max(len(voice.poles) for voice in voices) * longest
        require_memory("Hearing", needed, f"lower the sample rate, {self.sample_rate:g} Hz")
        poles, accelerated = [voice.poles for voice in voices], [voice.accelerated for voice in voices]
        if names:
            accelerated = [voice.modes for voice in voices]
            most = [loudest(thing.file, voice) for thing, voice in things.values()]
            self._stream = ModalStream(poles, self.sample_rate, longest, accelerated, len(names), most)
        else:
            self._stream = ModalStream(poles, self.sample_rate, longest, accelerated)
        self._reader = ContactReader(model, [*self._bodies])
        self.reset()

    def reset(self, data: mujoco.MjData | None = None) -> None:
        """Begin anew, at the time of a simulation or at 0: silence, and no contact."""
        data = None if data is None else self._state.require_same(data)
        start = finite_number("time of the data", 0.0 if data is None else data.time)
        self._scrapes = Scrapes(np.random.default_rng(self._seed))
        self._reader.reset()
        self._stream.reset()
        for body in self._bodies.values():
            self._stream.retune(body.row, body.voice.poles)
        self._touched: dict[int, list[PadTouch]] = {}  # by body, for which poles and weights hold
        self._time = start
        self._diverged = 0 if data is None else divergences(data)
        self._steps = 0
        self.strikes: tuple[Strike, ...] = ()
        self._places = np.zeros((len(self._bodies), 3))  # of the listener, for which the weights hold
        #: sample at which they were computed, and at which what touches was
        self._since, self._held = np.full((2, len(self._bodies)), -np.inf)

    @property
    def time(self) -> float:
        """Time of the simulation up to which it was heard, s."""
        return self._time

    def simulate(self, data: mujoco.MjData, steps: int = 1) -> np.ndarray:
        """Make steps and return what is heard meanwhile, Pa: one call of many steps as many calls of one."""
        data, heard = self._state.require_same(data), []
        for _ in range(whole_number("steps", steps)):
            mujoco.mj_step(self._model, data)
            heard.append(self.hear(data))
        return np.concatenate(heard or [self._play(0)], -1)

    def hear(self, data: mujoco.MjData) -> np.ndarray:
        """Return what is heard of the step that ``mj_step`` has just made; (samples,) float32.

        It is in Pa at a listener, in m/s^2 at a pickup; (P, samples) of a sequence of P pickups. The number
        of samples is that of the step, rounded so that none is lost in the long run. Steps shorter than a
        sample have none at times; what strikes in one is heard from the next sample on.
        """
        self._check(data)
        samples = round(self.sample_rate * self._step * (self._steps + 1)) - self._stream.clock
        impacts, loads = self._reader.read(data)
        self.strikes = tuple(self._apply_impacts(data, impacts, samples)) if impacts else ()
        self._apply_friction(data, loads, samples)
        if self._pickups is not None:
            self._touch(data, loads)
        if self._listener is not None:
            self._listen(data, self._listener)
        self._steps += 1
        self._time = float(data.time)
        return self._play(samples)

    def _play(self, samples: int) -> np.ndarray:
        heard = self._stream.play(samples).astype(np.float32)
        return heard[0] if self._alone else heard

    def energy(self) -> dict[str, float]:
        """Return the energy of each object's vibrations, J, without pulses that still go on."""
        energy = self._stream.energy
        return {b.name: float(energy[b.row, : b.voice.modes].sum()) for b in self._bodies.values()}

    def _check_model(self) -> None:
        """Raise ObjectFolderError if the objects of the model are not as their files say."""
        _check_step(self._model)
        for body in self._bodies.values():
            check_body(self._model, body.name, body.thing, body.voice)

    def _check(self, data: mujoco.MjData) -> None:
        data = self._state.require(data, self._check_model)
        if divergences(data) > self._diverged:  # MuJoCo has set it back to its start
            raise ObjectFolderError(
                f"the simulation diverged after {self._time:g} s: take smaller time steps or forces, and "
                "reset(data)"
            )
        expected = self._time + self._step
        if abs(data.time - expected) > _CLOCK_TOLERANCE + 1e-3 * self._step:
            raise ObjectFolderError(
                f"the simulation is at {data.time:g} s, expected {expected:g} s, one step after what was "
                "heard last: call hear() after every mj_step, and reset(data) when the simulation is reset"
            )

    def _apply_impacts(self, data: mujoco.MjData, impacts: list[Impact], samples: int) -> list[Strike]:
        """Apply the impacts of a step to the objects that they hit."""
        blows: dict[int, list[tuple[int, np.ndarray, np.ndarray]]] = {}  # by body: impact, point and impulse
        for k, impact in enumerate(impacts):
            for sign, number in zip((-1, 1), impact.bodies):
                if number in self._bodies:
                    turn = data.xmat[number].reshape(3, 3)
                    point = (impact.point - data.xpos[number]) @ turn
                    blows.setdefault(number, []).append((k, point, sign * impact.impulse @ turn))
        contacts = [self._contact([self._bodies.get(number) for number in one.bodies]) for one in impacts]
        durations = [hertz_time(*of, one.mass, one.speed) for of, one in zip(contacts, impacts)]
        hits, taken = [], np.zeros(len(impacts))
        for number, found in blows.items():
            body = self._bodies[number]
            gains = body.voice.gains(*(np.stack([one[part] for one in found]) for part in (1, 2)))
            for (k, point, impulse), gain in zip(found, gains):
                left = abs(gain * pulse_gain(body.voice.poles, durations[k]))[: body.voice.modes]
                energy = float(left @ left) / 2
                taken[k] += energy
                hits.append((k, body, point, impulse, gain, energy))
        out = []
        for k, body, point, impulse, gain, energy in hits:
            impact, duration = impacts[k], durations[k]
            # Hertz's law has no vibrations. Where they would take more energy than the impact lost, as of
            # thin shells, the blow is as much weaker.
            share = math.sqrt(min(impact.lost / taken[k], 1.0)) if taken[k] > 0 else 1.0
            start = self._stream.clock + round((1 - impact.late / self._step) * max(samples - 1, 0))
            self._stream.strike(body.row, Pulse(start, duration * self.sample_rate, share * gain))
            energies = share**2 * energy, impact.lost
            out.append(Strike(body.name, start, point, share * impulse, duration, impact.speed, *energies))
        return out

    def _contact(self, both: "list[_Body | None]") -> tuple[float, float]:
        """Return the modulus of a contact, Pa, and its radius, m."""
        stuff = [self._material(body) for body in both]
        modulus = effective_modulus(*((m.youngs_modulus, m.poisson_ratio) for m in stuff))
        return modulus, 1 / sum(1 / (ROUNDING * body.voice.scale) for body in both if body is not None)

    def _material(self, body: "_Body | None") -> Material:
        return self._surroundings if body is None else body.voice.material

    def _apply_friction(self, data: mujoco.MjData, loads: Loads | None, samples: int) -> None:
        """Shake the objects of contacts that slide or roll by the roughness of their surfaces."""
        if loads is None:
            self._scrapes.play(samples, {})
            return
        arms = _length(loads.point[:, None] - data.xipos[loads.bodies])
        slid = _length(loads.slip)
        rolled = np.where(self._sounds[loads.bodies], arms, 0).max(1) * _length(loads.rolling)
        moving = np.flatnonzero(np.maximum(slid, rolled) >= MIN_SLIP)
        if not len(moving):
            self._scrapes.play(samples, {})
            return
        bodies, slip, slid = loads.bodies[moving], loads.slip[moving], slid[moving]
        pairs = [(first, second) for first, second in bodies.tolist()]
        modulus, radius, rough = np.array([self._rub(pair) for pair in pairs]).T
        size, cutoff = scrape_force(loads.force[moving], slid, rolled[moving], rough, radius, modulus)
        along = loads.normal[moving] - (loads.friction[moving] / slid.clip(MIN_SLIP))[:, None] * slip
        noise = self._scrapes.play(samples, dict(zip(pairs, (cutoff / self.sample_rate).tolist())))
        contact, side = np.nonzero(self._sounds[bodies])
        numbers = bodies[contact, side]
        turns = data.xmat[numbers].reshape(-1, 3, 3)
        places = np.einsum("kd,kde->ke", loads.point[moving[contact]] - data.xpos[numbers], turns)
        pushes = np.einsum("kd,kde->ke", ((2 * side - 1) * size[contact])[:, None] * along[contact], turns)
        shaken = [self._bodies[number] for number in numbers.tolist()]
        gains = np.zeros((len(shaken), self._stream.modes))
        for out, body, place, push in zip(gains, shaken, places, pushes):
            out[: len(body.voice.poles)] = body.voice.rough_gains(place, push)
        self._stream.shake(np.array([body.row for body in shaken]), noise[contact], gains)

    def _rub(self, pair: tuple[int, int]) -> tuple[float, float, float]:
        """Return the modulus of a contact, Pa, its radius, m, and its combined roughness, m."""
        if pair not in self._surfaces:
            both = [self._bodies.get(number) for number in pair]
            rough = math.hypot(*(self._material(body).roughness for body in both))
            self._surfaces[pair] = (*self._contact(both), rough)
        return self._surfaces[pair]

    def _touch(self, data: mujoco.MjData, loads: Loads | None) -> None:
        """Damp the bodies that pads touch, and compute anew how pickups hear them, if that has changed."""
        assert self._pickups is not None
        found, clock = self._pickups.touches(data, loads), self._stream.clock
        for number, body in self._bodies.items():
            touches, before = found.get(number, []), self._touched.get(number)
            if before is not None:
                alike = all(one.is_like(was, body.voice.scale) for one, was in zip(touches, before))
                if alike and len(touches) == len(before):
                    continue
                if clock - self._held[body.row] < LISTEN_INTERVAL * self.sample_rate:
                    continue
            poles = self._pickups.poles(body.voice, touches)
            self._stream.retune(body.row, poles)
            if self._pickups.channels:
                self._stream.listen(body.row, self._pickups.weights(number, body.voice, poles, touches))
            self._touched[number], self._held[body.row] = touches, clock

    def _listen(self, data: mujoco.MjData, listener: "int | np.ndarray") -> None:
        """Compute anew how the bodies that sound are heard, if they or the listener have moved."""
        ear = listener if isinstance(listener, np.ndarray) else data.site_xpos[listener]
        turns = data.xmat[self._numbers].reshape(-1, 3, 3)
        places, clock = np.einsum("bd,bde->be", ear - data.xpos[self._numbers], turns), self._stream.clock
        far, was = _length(places), _length(self._places)
        turned = (places * self._places).sum(1) < math.cos(LISTENER_ANGLE) * far * was
        moved = turned | (abs(far - was) >= LISTENER_DISTANCE * was)
        due = self._stream.sounds & moved & (clock - self._since >= LISTEN_INTERVAL * self.sample_rate)
        for body in (body for body in self._bodies.values() if due[body.row]):
            self._stream.listen(body.row, body.voice.weights(places[body.row]))
            self._places[body.row], self._since[body.row] = places[body.row], clock


def _length(vectors: np.ndarray) -> np.ndarray:
    """Return lengths of vectors (..., 3)."""
    out: np.ndarray = np.sqrt(np.square(vectors).sum(-1))
    return out


def _listener(model: mujoco.MjModel, listener: object) -> "int | np.ndarray":
    """Return the number of a site, or a place (3,)."""
    advice = "give the name of one site, or one place; two ears need a Hearing each"
    if isinstance(listener, str):
        return site_number(model, listener, "listener")
    if isinstance(listener, list | tuple) and any(isinstance(one, str) for one in listener):
        raise ObjectFolderError(f"listener is {quoted(listener)}, expected one; {advice}")
    place = real_array("listener", listener)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ObjectFolderError(
            f"listener is {quoted(listener)}, expected one position of three finite numbers, m; {advice}"
        )
    return place


def _names(pickup: object) -> list[str]:
    """Return names of sites, one or more."""
    if not isinstance(pickup, Sequence) or not pickup or not all(isinstance(one, str) for one in pickup):
        raise ObjectFolderError(f"pickup is {quoted(pickup)}, expected the name of a site, or several")
    return [*pickup]


def _check_step(model: mujoco.MjModel) -> None:
    """Raise ObjectFolderError if a step is longer than contacts last."""
    step = float(model.opt.timestep)
    if not 0 < step <= MAX_TIME_STEP:
        raise ObjectFolderError(
            f"the time step of the scene is {step:g} s, expected at most {MAX_TIME_STEP:g} s, and above 0: "
            "bounces within a longer one would not be heard"
        )
    collides = np.flatnonzero((model.geom_contype > 0) | (model.geom_conaffinity > 0))
    constants = np.concatenate([model.geom_solref[collides, 0], model.pair_solref[:, 0]])
    times = np.where(constants > 0, constants, 1 / np.sqrt(np.maximum(-constants, 1e-12)))
    short = np.flatnonzero(times < 2 * step)
    if len(short):
        first = short[0]
        if first < len(collides):
            kind, number, one = "geom", collides[first], model.geom
        else:
            kind, number, one = "pair", first - len(collides), model.pair
        raise ObjectFolderError(
            f"{kind} {one(number).name or int(number)!r}: its contacts have a time constant of "
            f"{times[first]:g} s, expected at least two time steps, {2 * step:g} s: MuJoCo would "
            "soften them silently; use a shorter time step or a longer solref"
        )
