"""Contact time of a strike: Hertz's elastic collision of a rounded tip with the object."""

import math
import sys
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

from objectfolder.base.checks import finite_number, one_of
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import Material
from objectfolder.base.yamlfile import is_yaml_name, read_yaml

_STRIKERS = Path(__file__).with_name("strikers")

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


def striker_names() -> list[str]:
    """Return the names of the strikers in the package, a YAML file each in ``strikers/``."""
    return sorted(path.stem for path in _STRIKERS.glob("*.yaml"))


def load_striker(described: object) -> Striker:
    """Return a striker.

    Parameters
    ----------
    described : Striker, str or Path
        A striker, one of `striker_names`, or the path of a ``.yaml`` file with the fields of `Striker`.

    Raises
    ------
    ObjectFolderError
        If there is none of this name, or the file is not there or not valid.
    """
    if isinstance(described, Striker):
        return described
    if isinstance(described, str | Path) and is_yaml_name(described):
        return _read_striker(Path(described))
    return _of_package(one_of("striker", described, striker_names()))


@cache
def _of_package(name: str) -> Striker:
    return _read_striker(_STRIKERS / f"{name}.yaml")


def _read_striker(path: Path) -> Striker:
    if not path.is_file():
        raise ObjectFolderError(
            f"striker {path} does not exist; expected a YAML file like those in {_STRIKERS}"
        )
    values, known = read_yaml(path), [field.name for field in fields(Striker)]
    if not isinstance(values, dict) or not set(known) - {"speed"} <= values.keys() <= set(known):
        raise ObjectFolderError(f"{path} holds {quoted(values)}, expected {', '.join(known)} by name")
    try:
        return Striker(**values)
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{path}: {error}") from error


def contact_time(striker: Striker, material: Material, mass: float) -> float:
    """Return how long a striker and an object of some mass, kg, which may be infinite, touch; seconds.

    The object counts as flat where it is struck, and moves as a whole. Both matter little: the time goes with
    the fifth root of the radius, and the lighter of two bodies dominates their reduced mass.
    """
    shared = striker.mass if mass == math.inf else striker.mass * mass / (striker.mass + mass)
    own, other = ((each.youngs_modulus, each.poisson_ratio) for each in (striker, material))
    return hertz_time(effective_modulus(own, other), striker.radius, shared, striker.speed)


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
