"""Sound of an Object File: strikes in, sounds out."""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import torch

from objectfolder.base import materials
from objectfolder.base.checks import finite_number, one_of, real_array, require_memory
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import Material
from objectfolder.sound.contact import Striker, load_striker
from objectfolder.sound.far_field import Radiation
from objectfolder.sound.synthesis import RESPONSES, checked_contact_time, count_samples
from objectfolder.sound.tuning import Tuning
from objectfolder.stored.arguments import (
    Answer,
    Rows,
    broadcast_rows,
    finite_rows,
    like_first,
    true_or_false,
    usual_modes,
)
from objectfolder.stored.reading import StoredNet, StoredObject
from objectfolder.stored.surface import TOLERANCE

_BYTES_PER_SAMPLE = 8  # of an answer, while it is made
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Strikes:
    """Impulses on an object, one for each sound, and where they are heard."""

    points: np.ndarray  #: (N, 3) object frame, metres
    impulses: np.ndarray  #: (N, 3) N s, object frame
    tolerance: float  #: greatest distance of a point from the surface, fraction of the size
    listeners: np.ndarray | None = None  #: (N, 3) metres; None for sounds without a listener
    delay: bool = False  #: whether sounds start when they arrive, rather than with the strikes
    pickups: np.ndarray | None = None  #: (N, 3) metres, where contact microphones are; None without them
    axes: np.ndarray | None = None  #: (N, 3) unit vectors that these measure along; None: outward normals

    @classmethod
    def checked(
        cls,
        points: Rows,
        forces: Rows,
        listener: Rows | None,
        delay: bool,
        tolerance: float,
        pickup: Rows | None = None,
        axis: Rows | None = None,
    ) -> "Strikes":
        """Check the arguments of a query; a single row of one serves all rows of the others.

        Raises ObjectFolderError if shapes do not fit, values are not finite, an axis is zero, there is a
        delay without a listener, an axis without a pickup, or both a listener and a pickup.
        """
        places = finite_rows("points", points, 3)
        longer = "points" if len(places) > 1 else "forces"
        places, impulses = broadcast_rows("points", places, "forces", finite_rows("forces", forces, 3))
        late = true_or_false("delay", delay)
        if axis is not None and pickup is None:
            raise ObjectFolderError("axis is the direction of a pickup; give pickup, or leave axis out")
        if pickup is not None:
            if listener is not None:
                raise ObjectFolderError("listener and pickup are both given; a sound is heard at one of them")
            places, spots = broadcast_rows(longer, places, "pickup", finite_rows("pickup", pickup, 3))
            places, impulses = broadcast_rows("points", places, "forces", impulses)
            return cls(places, impulses, tolerance, pickups=spots, axes=_unit_rows(axis, len(places)))
        if listener is None:
            if late:
                raise ObjectFolderError("delay=True needs a listener; give listener, or leave delay out")
            return cls(places, impulses, tolerance)
        places, ears = broadcast_rows(longer, places, "listener", finite_rows("listener", listener, 3))
        places, impulses = broadcast_rows("points", places, "forces", impulses)
        return cls(places, impulses, tolerance, ears, late)


def _unit_rows(axis: Rows | None, count: int) -> np.ndarray | None:
    """Return directions as unit vectors, (count, 3)."""
    if axis is None:
        return None
    _, rows = broadcast_rows("points", np.zeros((count, 3)), "axis", finite_rows("axis", axis, 3))
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    if not length.all():
        raise ObjectFolderError("axis: a row is zero, expected a direction")
    return rows / length


@dataclass(frozen=True)
class SoundSettings:
    """How strikes are played and sampled, and the material and size of the struck object."""

    sample_rate: float  #: Hz
    duration: float  #: seconds
    response: str  #: displacement, velocity or acceleration
    contact_time: float | None  #: seconds; 0 is an ideal impulse, None the striker's
    material: str | Material | None  #: None for the object's own
    scale: float | None  #: longest side, metres; None for the object's own
    striker: Any = None  #: a `Striker`; None for steel, or an ideal impulse where contact times are not known
    heard: bool = False  #: whether a listener hears the strikes

    def checked(self, strikes: int) -> "SoundSettings":
        """Check the arguments of a query for the sounds of so many strikes; the striker may be named.

        Raises ObjectFolderError if one is not of its type, a striker and a contact time are both given, the
        material is undamped, or the sounds do not fit into memory.
        """
        stuff, size = struck_object(self.material, self.scale)
        striker, contact_time = self.striker, self.contact_time
        if isinstance(stuff, Material):
            stuff.require_damping()
        if striker is not None and contact_time is not None:
            raise ObjectFolderError(
                f"striker is {quoted(striker)}, but contact_time says how long it touches; leave one of them "
                "out"
            )
        response = one_of("response", self.response, RESPONSES)
        if self.heard and response != "displacement":
            raise ObjectFolderError(
                f"response is {response!r}, but a listener hears pressure; leave response out"
            )
        samples = count_samples(self.sample_rate, self.duration)
        rate, seconds = float(self.sample_rate), float(self.duration)
        require_memory(
            f"{strikes} sounds of {samples:,} samples ({seconds:g} s at {rate:g} Hz)",
            _BYTES_PER_SAMPLE * strikes * samples,
            "ask for a shorter duration, a lower rate or fewer strikes",
        )
        contact_time = None if contact_time is None else checked_contact_time(contact_time)
        striker = None if striker is None else load_striker(striker)
        return SoundSettings(rate, seconds, response, contact_time, stuff, size, striker, self.heard)


def struck_object(
    material: str | Material | None, scale: float | None
) -> tuple[str | Material | None, float | None]:
    """Return material and longest side (m) of a struck object, checked; None is the object's own.

    Raises ObjectFolderError if the material is not known, or the size is not a number.
    """
    if not isinstance(material, Material | None):
        materials.material(material)
    return material, None if scale is None else finite_number("scale", scale)


class SoundSense(ABC):
    """What an Object File asks an audio net of any kind. Points are in the object frame, metres."""

    has_modes = False  #: whether the net knows mode shapes

    def __init__(self, stored: StoredNet):
        self.net = stored.load()
        self._stored, self._key, self._surface = stored, stored.key, stored.surface
        self._said: set[str] = set()

    def warn_once(self, note: str) -> None:
        """Warn of something that holds for this object: once, not at every strike."""
        if note not in self._said:
            self._said.add(note)
            log.warning("%s: %s", self._key, note)

    def warn_if_uncertain(self) -> None:
        """Warn, once, if the sound is marked uncertain."""
        if note := uncertainty_note(self._stored.header["audio"]):
            self.warn_once(note)

    @property
    def damped_frequency(self) -> torch.Tensor:
        """Angular frequencies of the modes, rad/s; (M,), empty if they are not known."""
        found: torch.Tensor = self.net.damped_frequency
        return found.cpu()

    def tuning(self, material: str | Material | None, scale: float | None) -> Tuning:
        """Return the modes of this shape in another material or size."""
        raise no_modes(self._key)

    def contact_time(
        self, striker: Striker, material: str | Material | None, scale: float | None
    ) -> float | None:
        """Return how long a striker touches an object of this shape, seconds; None if it is not known."""
        return None

    def mode_shapes(self, points: np.ndarray, tolerance: float) -> np.ndarray:
        """Return mass-normalised mode shapes, kg^-1/2; (N, 3, M) float32."""
        raise no_modes(self._key)

    @abstractmethod
    def impact(
        self, strikes: Strikes, settings: SoundSettings, read_radiation: Callable[[], Radiation]
    ) -> np.ndarray:
        """Return sounds of strikes, or their pressures at listeners, Pa; (N, samples) float32.

        Raises ObjectFolderError if a setting is not valid, a point is off the surface, a sound exceeds single
        precision, a listener is inside the object's ball, or the struck object's sound has other wavelengths,
        relative to its size, than the stored one's.
        """


def uncertainty_note(audio: dict[str, Any]) -> str | None:
    """Return what is to be said of a sound that is marked uncertain, from its part of the header."""
    if not audio.get("uncertain"):
        return None
    error = audio.get("frequency_uncertainty")
    known = "how wrong its frequencies are is not known"
    return (
        "its sound is marked uncertain: "
        f"{known if error is None else f'its lowest frequencies may be {error:.0%} wrong'}, since walls or "
        "joints are thin for the grid that they were solved on; thicken them and build again, or raise "
        "modal.fine.max_degrees_of_freedom (docs/modal.md#accuracy)"
    )


def no_modes(key: str) -> ObjectFolderError:
    """Return the error of what needs modes, of a file that stores spectrograms."""
    return ObjectFolderError(
        f"{key}: its audio net stores spectrograms, no modes; build the object with train_audio.net: gains"
    )


class SoundQueries(StoredObject):
    """How an object sounds: part of `objectfolder.objectfile.file.ObjectFile`."""

    @property
    @usual_modes()
    def has_modes(self) -> bool:
        """Whether the audio net knows mode shapes, which `mode_shapes`, `tuning` and other sizes need."""
        return bool(self._parts.audio.has_modes)

    @property
    @usual_modes()
    def frequencies(self) -> np.ndarray:
        """Frequencies of the modes, Hz; (M,), empty if the file does not know them."""
        damped: torch.Tensor = self._parts.audio.damped_frequency
        return damped.numpy() / (2 * math.pi)

    @usual_modes()
    def tuning(self, material: str | Material | None = None, scale: float | None = None) -> Tuning:
        """Return the modes of this shape in another material or size; see `objectfolder.sound.tuning.retune`.

        Parameters
        ----------
        material : str or Material, optional
            Default: the object's own.
        scale : float, optional
            Longest side, metres. Default: the object's own.
        """
        sense: SoundSense = self._parts.audio
        return sense.tuning(material, scale)

    @usual_modes()
    def impact(
        self,
        points: Answer | Sequence[Any],
        forces: Rows,
        sample_rate: float = 16000,
        duration: float = 2.0,
        response: str = "displacement",
        tolerance: float = TOLERANCE,
        contact_time: float | None = None,
        material: str | Material | None = None,
        scale: float | None = None,
        striker: str | Striker | None = None,
        listener: Rows | None = None,
        delay: bool = False,
        pickup: Rows | None = None,
        axis: Rows | None = None,
    ) -> Answer:
        """Strike the object, or one of its shape, with impulses; see docs/sound.md.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres; snapped to the surface.
        forces : (N, 3) array
            Impulse vectors, N s, object frame; the sound is linear in them.
        sample_rate : float
            Hz. Modes at or above half of it are left out.
        duration : float
            Seconds.
        response : {"displacement", "velocity", "acceleration"}
            Of the modes, summed: m kg^1/2 and its time derivatives. At a pickup, of the surface: m, m/s or
            m/s^2.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.
        contact_time : float, optional
            Duration of the strike, seconds: half a sine of force whose integral is the impulse. 0 is an
            ideal impulse. Default: that of the striker, see `contact_time`. Give one of both.
        material : str or Material, optional
            Material of the struck object. Another Poisson ratio makes the answer approximate: a warning
            gives the error bounds.
        scale : float, optional
            Longest side of the struck object, metres; ``points`` are metres of that object. A warning names
            the band where modes are missing.
        striker : str or Striker, optional
            What strikes the object: a name of `objectfolder.sound.contact.striker_names`, or a file.
            Default: steel, or an ideal impulse where the contact time is not known.
        listener : (N, 3) array, optional
            Where the strikes are heard, object frame, metres; outside the ball about the origin that holds
            the object. The answer is then the sound pressure there, in pascals, of the modes and of the
            recoil of the object as a whole.
        delay : bool
            Whether sounds reach a listener after the time that they need, rather than with the strikes.
        pickup : (N, 3) array, optional
            Where contact microphones are on the struck object, object frame, metres; snapped to the surface.
            The answer is then the vibration of the surface there; a piezo measures its ``acceleration``. The
            motion of the object as a whole is left out.
        axis : (N, 3) array, optional
            Direction that a contact microphone measures along. Default: the outward normal.

        Returns
        -------
        (N, samples) float32, absolute amplitude

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite or too large, a point is off the surface, the sounds
            do not fit into memory, the file does not say how the struck object sounds at a listener, or it
            does not say how long a given striker touches. If the material is undamped, both a striker and a
            contact time or both a listener and a pickup are given, or a delay without a listener.
        """
        strikes = Strikes.checked(points, forces, listener, delay, tolerance, pickup, axis)
        played = sample_rate, duration, response, contact_time, material, scale, striker, listener is not None
        settings = SoundSettings(*played).checked(len(strikes.points))
        sense: SoundSense = self._parts.audio
        sense.warn_if_uncertain()
        return like_first(sense.impact(strikes, settings, lambda: self._parts.radiation), points)

    def listen(
        self,
        points: Rows,
        forces: Rows,
        sample_rate: float | None = None,
        duration: float = 2.0,
        response: str | None = None,
        **strike: Any,
    ) -> list[Any]:
        """Strike the object in a notebook, and return a player of each sound.

        Parameters
        ----------
        points, forces, sample_rate, duration, response
            As of `impact`. By default those of the viewer: acceleration at 44.1 kHz, or the pressure at a
            listener; of a file that stores spectrograms, what they hold: displacement at 16 kHz.
        **strike
            Others of `impact`.

        Returns
        -------
        list of IPython.display.Audio
            The loudest sound has 0.9 of full scale.
        """
        pressure = strike.get("listener") is not None
        rate = sample_rate if sample_rate is not None else 44100 if self.has_modes else 16000
        if response is None:
            response = "acceleration" if self.has_modes and not pressure else "displacement"
        sounds = self.impact(real_array("points", points), forces, rate, duration, response, **strike)
        # Not an import statement: no stage asks for players, so none depends on them.
        players: list[Any] = import_module("objectfolder.sound.notebook").players(sounds, rate)
        return players

    @usual_modes()
    def contact_time(
        self,
        striker: str | Striker = "steel",
        material: str | Material | None = None,
        scale: float | None = None,
    ) -> float:
        """Return how long a striker touches the object, or one of its shape, seconds.

        0, an ideal impulse, if the file does not say what its modes are of, as imported ones do not, or
        stores spectrograms.

        Parameters
        ----------
        striker : str or Striker
            One of `objectfolder.sound.contact.striker_names`, or a file with a striker.
        material, scale
            As in `impact`.
        """
        tip, struck = load_striker(striker), struck_object(material, scale)
        sense: SoundSense = self._parts.audio
        return sense.contact_time(tip, *struck) or 0.0

    @usual_modes()
    def mode_shapes(self, points: Rows, tolerance: float = TOLERANCE) -> np.ndarray:
        """Return mass-normalised mode shapes: the modal gains of unit impulses along x, y and z.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres; snapped to the surface.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.

        Returns
        -------
        (N, 3, M) float32, kg^-1/2
        """
        sense: SoundSense = self._parts.audio
        return sense.mode_shapes(finite_rows("points", points, 3), tolerance)
