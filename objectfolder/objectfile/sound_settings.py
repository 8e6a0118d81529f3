"""Settings of a query for sounds."""

from dataclasses import dataclass

import numpy as np

from objectfolder import materials
from objectfolder.audio.contact import Striker, load_striker
from objectfolder.audio.synthesis import RESPONSES, checked_contact_time, count_samples
from objectfolder.checks import finite_number, one_of, require_memory
from objectfolder.errors import ObjectFolderError, quoted
from objectfolder.materials import Material

_BYTES_PER_SAMPLE = 8  # of an answer, while it is made


@dataclass(frozen=True)
class SoundSettings:
    """How strikes are played and sampled, and the material and size of the struck object."""

    sample_rate: float  #: Hz
    duration: float  #: seconds
    response: str  #: displacement, velocity or acceleration
    contact_time: float | None  #: seconds; 0 is an ideal impulse, None the striker's
    material: str | Material | None  #: None for the object's own
    scale: float | None  #: longest side, metres; None for the object's own
    striker: Striker | None = None  #: None for steel, or an ideal impulse where contact times are not known
    heard: bool = False  #: whether a listener hears the strikes

    @classmethod
    def checked(
        cls,
        sample_rate: float,
        duration: float,
        response: str,
        contact_time: float | None,
        material: str | Material | None,
        scale: float | None,
        striker: str | Striker | None,
        strikes: int,
        heard: bool = False,
    ) -> "SoundSettings":
        """Check the arguments of a query for the sounds of so many strikes.

        Raises
        ------
        ObjectFolderError
            If one is not of its type, a striker and a contact time are both given, the material is undamped,
            or the sounds do not fit into memory.
        """
        stuff, size = struck_object(material, scale)
        if isinstance(stuff, Material):
            stuff.require_damping()
        if striker is not None and contact_time is not None:
            raise ObjectFolderError(
                f"striker is {quoted(striker)}, but contact_time says how long it touches; leave one of them "
                "out"
            )
        response = one_of("response", response, RESPONSES)
        if heard and response != "displacement":
            raise ObjectFolderError(
                f"response is {response!r}, but a listener hears pressure; leave response out"
            )
        samples = count_samples(sample_rate, duration)
        rate, seconds = float(sample_rate), float(duration)
        require_memory(
            f"{strikes} sounds of {samples:,} samples ({seconds:g} s at {rate:g} Hz)",
            _BYTES_PER_SAMPLE * strikes * samples,
            "ask for a shorter duration, a lower rate or fewer strikes",
        )
        return cls(
            rate,
            seconds,
            response,
            None if contact_time is None else checked_contact_time(contact_time),
            stuff,
            size,
            None if striker is None else load_striker(striker),
            heard,
        )


def struck_object(
    material: str | Material | None, scale: float | None
) -> tuple[str | Material | None, float | None]:
    """Return material and longest side (m) of a struck object, checked; None is the object's own.

    Raises
    ------
    ObjectFolderError
        If the material is not known, or the size is not a number.
    """
    if not isinstance(material, Material | None):
        materials.material(material)
    return material, None if scale is None else finite_number("scale", scale)


def finite_sounds(sounds: np.ndarray, impulses: np.ndarray) -> np.ndarray:
    """Return sounds, or raise ObjectFolderError if impulses are too large for single precision."""
    if not np.isfinite(sounds).all():
        raise ObjectFolderError(
            f"impulses of up to {np.abs(impulses).max():g} N s give sounds beyond single precision; "
            "the sound is linear in them: scale them down"
        )
    return sounds
