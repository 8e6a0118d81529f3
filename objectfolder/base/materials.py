"""Materials, a YAML file each: those of the package in ``materials/``, and a user's own.

The names are those of the supplementary material, Table 1.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.yamlfile import is_yaml_name, read_yaml

LAWS = ("rayleigh", "loss_factor")  #: of damping
_FOLDER = Path(__file__).with_suffix("")
_REQUIRED = ("density", "youngs_modulus", "poisson_ratio", "friction", "roughness")
_SOURCES = "sources"


@dataclass(frozen=True)
class Material:
    """A homogeneous, isotropic, linear elastic material with Rayleigh damping or a loss factor.

    Give ``loss_factor``, or ``alpha`` and ``beta``. Without any of them the material is undamped: its modes
    can be solved, but `ObjectFile.impact` and others that make sounds refuse it, since it would ring for
    ever. Raises ObjectFolderError if a value is not physical: density, modulus or roughness not positive,
    Poisson's ratio outside (-1, 0.5), negative damping or friction, frequencies that do not ascend.

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
    friction: float = 0.5  #: of dry sliding, against a table or an elastomer
    roughness: float = 1e-6  #: m, root mean square within a contact

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self) if field.type is float):
            number = finite_number(f"material {self.name!r}: {name}", getattr(self, name))
            object.__setattr__(self, name, number)  # hashable, whatever was given
        object.__setattr__(self, "loss_factor", _knots(self.name, self.loss_factor))
        physical = {
            "density": (0 < self.density < math.inf, "a positive number of kg/m^3"),
            "youngs_modulus": (0 < self.youngs_modulus < math.inf, "a positive number of Pa"),
            "poisson_ratio": (-1 < self.poisson_ratio < 0.5, "a number between -1 and 0.5"),
            "alpha": (0 <= self.alpha < math.inf, "a non-negative number of 1/s"),
            "beta": (0 <= self.beta < math.inf, "a non-negative number of s"),
            "friction": (0 <= self.friction <= 1000, "a number between 0 and 1000"),
            "roughness": (0 < self.roughness <= 0.01, "a positive number of metres, at most 0.01"),
        }
        for name, (holds, expected) in physical.items():
            if not holds:
                wrong = f"{name} is {getattr(self, name)!r}"
                raise ObjectFolderError(f"material {self.name!r}: {wrong}, expected {expected}")

    def properties(self) -> dict[str, Any]:
        """Return everything but the name, as Object Files store it."""
        found = asdict(self) | {"loss_factor": [list(knot) for knot in self.loss_factor]}
        left_out = ("name",) if self.loss_factor else ("name", "loss_factor")
        return {name: value for name, value in found.items() if name not in left_out}

    @property
    def law(self) -> str:
        """Damping model, one of ``LAWS``."""
        return "loss_factor" if self.loss_factor else "rayleigh"

    def require_damping(self) -> None:
        """Raise ObjectFolderError if nothing damps the material."""
        if not (self.loss_factor or self.alpha or self.beta):
            advice = "an undamped object rings for ever; give alpha, beta or loss_factor"
            raise ObjectFolderError(f"material {self.name!r}: {advice}")

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
    with suppress(TypeError, ValueError):
        knots = tuple((float(hertz), float(loss)) for hertz, loss in given)
        ascending = all(a < b for (a, _), (b, _) in pairwise(knots))
        if ascending and all(0 <= hertz < math.inf and 0 < loss < 1 for hertz, loss in knots):
            return knots
    expected = "pairs of a frequency in Hz, ascending, and a loss factor between 0 and 1"
    raise ObjectFolderError(f"material {name!r}: loss_factor is {quoted(given)}, expected {expected}")


_PROPERTIES = [field.name for field in fields(Material) if field.name != "name"]


def material_names() -> list[str]:
    """Return the names of the materials in the package."""
    return sorted(path.stem for path in _FOLDER.glob("*.yaml"))


def material(name: str | Path, law: str = "rayleigh") -> Material:
    """Return a material of the package by its name, in any case, or that of a ``.yaml`` file.

    ``law``: of damping, one of `LAWS`. Raises ObjectFolderError if there is none of this name, or the file is
    not there or not valid; see `read_material`.
    """
    if is_yaml_name(name):
        return read_material(Path(name), law)
    if not (isinstance(name, str) and name.lower() in material_names()):
        known = ", ".join(material_names())
        other = "or a file such as materials/NAME.yaml (docs/conventions.md)"
        raise ObjectFolderError(f"unknown material {quoted(name)}: expected one of {known}, {other}")
    return _of_package(name.lower(), law)


@cache
def _of_package(name: str, law: str) -> Material:
    return read_material(_FOLDER / f"{name}.yaml", law)


def read_material(path: Path, law: str = "loss_factor") -> Material:
    """Read a material from its YAML file, whose name it has.

    ``path``: holds density, youngs_modulus, poisson_ratio, friction, roughness, and loss_factor or alpha and
    beta; ``sources`` may say by name where a number is from; ``law``: of damping, if the file gives both.
    Raises ObjectFolderError if there is no such file, a property is missing, unknown or not physical, or
    nothing damps it.
    """
    properties = material_properties(path)
    if law == "rayleigh" and {"alpha", "beta"} & properties.keys():
        properties.pop("loss_factor", None)
    try:
        found = Material(path.stem, **properties)
        found.require_damping()
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{path}: {error}") from error
    return found


def material_properties(path: Path) -> dict[str, Any]:
    """Return the properties in a material's file, without their sources; see `read_material`.

    Raises ObjectFolderError if there is no such file, or a property is missing or unknown.
    """
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; expected a material's file (docs/conventions.md)")
    properties = read_yaml(path)
    if not isinstance(properties, dict):
        expected = ", ".join(_PROPERTIES)
        raise ObjectFolderError(f"{path} holds {quoted(properties)}, expected {expected} by name")
    sources = properties.pop(_SOURCES, {})
    for given in (properties, sources if isinstance(sources, dict) else [_SOURCES]):
        _check_known(given, f"{path}: unknown {{}}, expected")
    if lacking := [name for name in _REQUIRED if name not in properties]:
        raise ObjectFolderError(f"{path} lacks {', '.join(lacking)}; copy one of {_FOLDER}")
    return properties


def _check_known(given: Iterable[str], message: str) -> None:
    """Raise ObjectFolderError if a name is none of a property; its message has that in place of {}."""
    for name in given:
        if name not in _PROPERTIES:
            raise ObjectFolderError(f"{message.format(quoted(name))} {', '.join(_PROPERTIES)}")


def own_material(
    described: str | Mapping[str, Any], law: str = "rayleigh", root: str | Path = "."
) -> Material:
    """Return the material of an object's entry in ``params.yaml``.

    ``described``: a name, the path of a file, or ``{base: NAME or path, ...}`` with properties that differ
    from those of the named material; ``law``: of damping, where the entry leaves the choice; ``root``:
    workspace, from which paths count. Raises ObjectFolderError if the name or a property is unknown, a file
    has the name of a material of the package, a value is not physical, or nothing damps the object.
    """
    if isinstance(described, Mapping):
        properties = {name: value for name, value in described.items() if name != "base"}
        _check_known(properties, "unknown property {}: expected base or one of")
        if {"alpha", "beta"} & properties.keys():
            law = "rayleigh"
            properties.setdefault("loss_factor", ())
        found = replace(own_material(described.get("base", ""), law, root), **properties)
        found.require_damping()
        return found
    if not is_yaml_name(described):
        return material(described, law)
    path = Path(root, described)
    if path.stem.lower() in material_names():
        raise ObjectFolderError(f"{path} has the name of a material of the package; rename it")
    return material(path, law)


def stored_material(name: str, properties: Mapping[str, Any]) -> Material:
    """Return the material of an Object File; of files before format 1.5, the package knows the surface.

    ``properties``: ``material_properties`` of the header; fields of newer versions are ignored.
    """
    surface = {"friction": friction_of(name), "roughness": roughness_of(name)} | dict(properties)
    return Material(name, **{known: surface[known] for known in _PROPERTIES if known in surface})


def friction_of(name: str) -> float:
    """Return the coefficient of dry sliding friction of a material's name, in any case; 0.5 if unknown."""
    return material(name).friction if name.lower() in material_names() else Material.friction


def roughness_of(name: str) -> float:
    """Return the roughness of a material's name, in any case, m root mean square; 1e-6 if unknown."""
    return material(name).roughness if name.lower() in material_names() else Material.roughness
