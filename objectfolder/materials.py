"""Material parameters for modal analysis (supplementary material, Table 1)."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from objectfolder.checks import finite_number
from objectfolder.errors import ObjectFolderError, quoted


@dataclass(frozen=True)
class Material:
    """A homogeneous, isotropic, linear elastic material with Rayleigh damping.

    Raises
    ------
    ObjectFolderError
        If a value is not physical: density or modulus not positive, Poisson's ratio outside (-1, 0.5),
        negative damping.
    """

    name: str
    density: float  #: kg/m^3
    youngs_modulus: float  #: Pa
    poisson_ratio: float
    alpha: float  #: mass-proportional Rayleigh damping, 1/s
    beta: float  #: stiffness-proportional Rayleigh damping, s

    def __post_init__(self) -> None:
        for name in self.properties():
            finite_number(f"material {self.name!r}: {name}", getattr(self, name))
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

    def properties(self) -> dict[str, float]:
        """Return everything but the name, as Object Files store it."""
        return {name: value for name, value in asdict(self).items() if name != "name"}

    def damping(self, eigenvalues: Any) -> Any:
        """Return decay rates, 1/s, of modes with eigenvalues in rad^2/s^2; arrays or tensors."""
        return (self.alpha + self.beta * eigenvalues) / 2


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


def material(name: str) -> Material:
    """Look up a material by name, case-insensitively.

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
    return found
