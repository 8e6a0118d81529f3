"""Contact time of a strike: Hertz's elastic collision of a rounded tip with the object."""

import math
import sys
from dataclasses import dataclass, fields

from objectfolder.checks import finite_number, one_of
from objectfolder.errors import ObjectFolderError
from objectfolder.materials import Material

#: Contact time over largest indentation times speed, of any Hertzian collision.
_DURATION = 4 * math.sqrt(math.pi) * math.gamma(0.4) / (5 * math.gamma(0.9))


@dataclass(frozen=True)
class Striker:
    """What strikes an object: a rounded tip, moved by the mass behind it.

    Raises
    ------
    ObjectFolderError
        If a value is not physical.
    """

    youngs_modulus: float  #: of the tip, Pa
    poisson_ratio: float
    radius: float  #: of the tip, m
    mass: float  #: that takes part, kg
    speed: float = 1.0  #: at contact, m/s; the contact time depends on its fifth root

    def __post_init__(self) -> None:
        for field in fields(self):
            value = finite_number(f"striker: {field.name}", getattr(self, field.name))
            object.__setattr__(self, field.name, value)  # hashable, whatever was given
            low, high = (-1.0, 0.5) if field.name == "poisson_ratio" else (0.0, math.inf)
            if not low < value < high:
                raise ObjectFolderError(
                    f"striker: {field.name} is {value!r}, expected a number between {low:g} and {high:g}"
                )


#: Strikers by name. Tips of steel and wood have the moduli of the table of materials; those of rubber (Shore
#: A 70) and of a finger's pad are typical values, of which the finger's varies most.
STRIKERS: dict[str, Striker] = {
    "steel": Striker(2.0e11, 0.29, radius=0.005, mass=0.01),
    "wood": Striker(1.1e10, 0.25, radius=0.01, mass=0.01),
    "rubber": Striker(5.5e6, 0.49, radius=0.01, mass=0.02),
    "finger": Striker(1.0e6, 0.49, radius=0.008, mass=0.01),
}


def as_striker(described: object) -> Striker:
    """Return a striker, or the one of a name in `STRIKERS`; raises ObjectFolderError if it is neither."""
    return (
        described if isinstance(described, Striker) else STRIKERS[one_of("striker", described, [*STRIKERS])]
    )


def contact_time(striker: Striker, material: Material, mass: float) -> float:
    """Return how long a striker and an object of some mass, kg, which may be infinite, touch; seconds.

    The object counts as flat where it is struck, and moves as a whole. Both matter little: the time goes with
    the fifth root of the radius, and the lighter of two bodies dominates their reduced mass.
    """
    shared = striker.mass if mass == math.inf else striker.mass * mass / (striker.mass + mass)
    modulus = effective_modulus(
        (striker.youngs_modulus, striker.poisson_ratio), (material.youngs_modulus, material.poisson_ratio)
    )
    return hertz_time(modulus, striker.radius, shared, striker.speed)


def effective_modulus(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return the modulus of a contact, Pa, of two materials given by Young's modulus and Poisson's ratio."""
    compliance = sum((1 - poisson**2) / youngs for youngs, poisson in (one, other))
    return max(1 / compliance, sys.float_info.min)  # the least modulus has no finite inverse


def hertz_time(modulus: float, radius: float, mass: float, speed: float) -> float:
    """Return the duration of an elastic collision of two spheres, seconds.

    K. L. Johnson, Contact Mechanics, 1985, section 11.4: from the modulus of the contact, Pa, see
    `effective_modulus`; the radius 1 / (1 / R1 + 1 / R2), m, where a flat body's own is infinite; the reduced
    mass m1 m2 / (m1 + m2), kg; and the speed of approach, m/s.
    """
    indentation = (15 * mass * speed**2 / (16 * math.sqrt(radius) * modulus)) ** 0.4
    return _DURATION * indentation / speed
