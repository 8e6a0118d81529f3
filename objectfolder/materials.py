"""Materials: those of the supplementary material, Table 1, with two laws of damping, and objects' own."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from typing import Any

from objectfolder.checks import finite_number
from objectfolder.errors import ObjectFolderError, quoted

LAWS = ("rayleigh", "loss_factor")


@dataclass(frozen=True)
class Material:
    """A homogeneous, isotropic, linear elastic material with Rayleigh damping or a loss factor.

    Give ``loss_factor``, or ``alpha`` and ``beta``. Without any of them the material is undamped: its modes
    can be solved, but `ObjectFile.impact` and others that make sounds refuse it, since it would
    ring for ever.

    Raises
    ------
    ObjectFolderError
        If a value is not physical: density or modulus not positive, Poisson's ratio outside (-1, 0.5),
        negative damping, frequencies of loss factors that do not ascend.

    Examples
    --------
    Brass, whose loss factor is 0.0005 at 1 kHz and below, and 0.001 at 10 kHz and above:

    >>> brass = Material("brass", 8500.0, 1.0e11, 0.34, loss_factor=((1000.0, 5e-4), (10000.0, 1e-3)))
    >>> sounds = mug.impact(points, impulses, material=brass)
    """

    name: str
    density: float  #: kg/m^3
    youngs_modulus: float  #: Pa
    poisson_ratio: float
    alpha: float = 0.0  #: mass-proportional Rayleigh damping, 1/s
    beta: float = 0.0  #: stiffness-proportional Rayleigh damping, s
    #: (Hz, loss factor) by ascending frequency, linear between and constant beyond; replaces alpha and beta
    loss_factor: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in ("density", "youngs_modulus", "poisson_ratio", "alpha", "beta"):
            number = finite_number(f"material {self.name!r}: {name}", getattr(self, name))
            object.__setattr__(self, name, number)  # hashable, whatever was given
        object.__setattr__(self, "loss_factor", _knots(self.name, self.loss_factor))
        physical = {
            "density": (0 < self.density < math.inf, "a positive number of kg/m^3"),
            "youngs_modulus": (0 < self.youngs_modulus < math.inf, "a positive number of Pa"),
            "poisson_ratio": (-1 < self.poisson_ratio < 0.5, "a number between -1 and 0.5"),
            "alpha": (0 <= self.alpha < math.inf, "a non-negative number of 1/s"),
            "beta": (0 <= self.beta < math.inf, "a non-negative number of s"),
        }
        for name, (holds, expected) in physical.items():
            if not holds:
                raise ObjectFolderError(
                    f"material {self.name!r}: {name} is {getattr(self, name)!r}, expected {expected}"
                )

    def properties(self) -> dict[str, Any]:
        """Return everything but the name, as Object Files store it."""
        found = {name: value for name, value in asdict(self).items() if name != "name"}
        found["loss_factor"] = [list(knot) for knot in self.loss_factor]
        return found if self.loss_factor else {k: v for k, v in found.items() if k != "loss_factor"}

    @property
    def law(self) -> str:
        """Damping model, one of ``LAWS``."""
        return "loss_factor" if self.loss_factor else "rayleigh"

    def require_damping(self) -> None:
        """Raise ObjectFolderError if nothing damps the material."""
        if not (self.loss_factor or self.alpha or self.beta):
            raise ObjectFolderError(
                f"material {self.name!r}: an undamped object rings for ever; give alpha, beta or loss_factor"
            )

    def damping(self, eigenvalues: Any) -> Any:
        """Return decay rates, 1/s, of modes with eigenvalues in rad^2/s^2; arrays or tensors.

        With Rayleigh damping, c = (alpha + beta w^2) / 2; with a loss factor eta, c = eta w / 2, so that the
        quality factor of a mode is 1 / eta.
        """
        if not self.loss_factor:
            return (self.alpha + self.beta * eigenvalues) / 2
        angular = eigenvalues**0.5
        hertz = angular / (2 * math.pi)
        loss = 0 * hertz + self.loss_factor[0][1]
        for (low, start), (high, end) in pairwise(self.loss_factor):
            loss = loss + (end - start) / (high - low) * (hertz.clip(low, high) - low)
        return loss * angular / 2


def _knots(name: str, given: Any) -> tuple[tuple[float, float], ...]:
    """Check loss factors over frequency."""
    expected = "pairs of a frequency in Hz, ascending, and a loss factor between 0 and 1"
    try:
        knots = tuple((float(hertz), float(loss)) for hertz, loss in given)
    except (TypeError, ValueError):
        raise ObjectFolderError(
            f"material {name!r}: loss_factor is {quoted(given)}, expected {expected}"
        ) from None
    ascending = all(a < b for (a, _), (b, _) in pairwise(knots))
    if not ascending or not all(0 <= hertz < math.inf and 0 < loss < 1 for hertz, loss in knots):
        raise ObjectFolderError(f"material {name!r}: loss_factor is {quoted(given)}, expected {expected}")
    return knots


MATERIALS: dict[str, Material] = {
    m.name: m
    for m in (
        Material("ceramic", 2700.0, 7.2e10, 0.19, 6.0, 1e-7),
        Material("glass", 2600.0, 6.2e10, 0.20, 1.0, 1e-7),
        Material("wood", 750.0, 1.1e10, 0.25, 60.0, 2e-6),
        Material("plastic", 1070.0, 1.4e9, 0.35, 30.0, 1e-6),
        Material("iron", 8000.0, 2.1e11, 0.28, 5.0, 1e-7),
        Material("polycarbonate", 1190.0, 2.4e9, 0.37, 0.5, 4e-7),
        Material("steel", 7850.0, 2.0e11, 0.29, 5.0, 3e-8),
    )
}


#: (Hz, loss factor) of the same materials. Ceramic: taps on a bowl (docs/sound.md). Metals, glass, wood:
#: ranges of Cremer and Heckl, Structure-Borne Sound, 1988. Plastics: handbook values at room temperature.
LOSS_FACTORS: dict[str, tuple[tuple[float, float], ...]] = {
    "ceramic": ((1500.0, 6.5e-4), (8000.0, 1.2e-3)),
    "glass": ((1000.0, 1e-3),),
    "wood": ((500.0, 0.01), (5000.0, 0.02)),
    "plastic": ((1000.0, 0.03),),
    "iron": ((1000.0, 5e-4),),
    "polycarbonate": ((1000.0, 0.012),),
    "steel": ((1000.0, 3e-4),),
}


def material(name: str, law: str = "rayleigh") -> Material:
    """Look up a material by name, case-insensitively.

    Parameters
    ----------
    name : str
    law : {"rayleigh", "loss_factor"}
        Of damping: that of the table in the supplementary material, or that of `LOSS_FACTORS`.

    Raises
    ------
    ObjectFolderError
        If the name is not in the table.
    """
    found = MATERIALS.get(name.lower()) if isinstance(name, str) else None
    if found is None:
        raise ObjectFolderError(
            f"unknown material {quoted(name)}: expected one of {', '.join(MATERIALS)} (docs/conventions.md)"
        )
    return replace(found, loss_factor=LOSS_FACTORS[found.name]) if law == "loss_factor" else found


def own_material(described: str | Mapping[str, Any], law: str = "rayleigh") -> Material:
    """Return the material of an object's entry in ``params.yaml``.

    Parameters
    ----------
    described : str or mapping
        A name, or ``{base: NAME, ...}`` with properties that differ from those of the named material.
    law : {"rayleigh", "loss_factor"}
        Of damping, where the entry gives none.

    Raises
    ------
    ObjectFolderError
        If the name or a property is unknown, a value is not physical, or nothing damps the object.
    """
    if not isinstance(described, Mapping):
        return material(described, law)
    properties = {name: value for name, value in described.items() if name != "base"}
    known = [field.name for field in fields(Material) if field.name != "name"]
    for name in properties:
        if name not in known:
            raise ObjectFolderError(
                f"unknown property {quoted(name)}: expected base or one of {', '.join(known)}"
            )
    if {"alpha", "beta"} & properties.keys():
        law = "rayleigh"
    found = replace(material(described.get("base", ""), law), **properties)
    found.require_damping()
    return found
