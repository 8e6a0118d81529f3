"""Profiles of vision-based tactile sensors."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from objectfolder.base.errors import ObjectFolderError, quoted, shortened
from objectfolder.base.yamlfile import is_yaml_name, read_yaml

_PROFILES = Path(__file__).with_suffix("")

GELS = ("rigid", "soft")

RESIDUAL_TERMS = 27  #: coefficients of one colour in `SensorProfile.residual`

#: Renderers of contacts: of the deformed gel, or, as TACTO does, of the object in front of a rigid gel.
RENDERERS = ("gel", "tacto")

Vector = tuple[float, float, float]
_T = TypeVar("_T")


@dataclass(frozen=True)
class Light:
    """A point light inside the sensor."""

    position: Vector  #: m, camera frame
    color: Vector  #: linear RGB, 0 to 1
    intensity: float  #: radiant intensity; the gel receives intensity / distance^2 (distance in m)


@dataclass(frozen=True)
class SensorProfile:
    """One vision-based tactile sensor.

    Camera frame: origin at the pinhole, +x along the optical axis towards the gel, +z up in the image,
    +y left in the image. Raises ObjectFolderError if a value is outside its range.
    """

    name: str
    source: str  #: source of the numbers
    height: int  #: image rows
    width: int  #: image columns
    vertical_fov_deg: float  #: full vertical field of view, degrees; pixels are square
    camera_to_gel: float  #: m, pinhole to the apex of the undeformed gel surface
    gel_curvature: float  #: 1/m, at the apex of the gel's dome; 0 is a flat gel
    gel_dome_radius: float  #: m, of the spheroid cap across the optical axis; see `camera.gel_depth`
    gel: str  #: "soft" is an elastic layer; "rigid" takes the exact imprint, without forces
    elastomer_thickness: float  #: m, of the layer, bonded to a rigid base
    young_modulus: float  #: Pa, of the layer
    poisson_ratio: float  #: of the layer, 0 to below 0.5
    max_indentation: float  #: m, less than the thickness; deeper penetration is clipped
    press_depth: tuple[float, float]  #: m, default range of press depths
    lights: tuple[Light, ...]
    ambient: float  #: radiance that reaches the camera from everywhere on the gel
    albedo: float  #: base colour of the gel's coating, grey, 0 to 1
    metallic: float  #: of the coating, 0 to 1
    roughness: float  #: of the coating, 0 to 1
    gamma: float  #: display value = radiance^(1/gamma)
    gain: float  #: factor on the difference to the undeformed gel
    #: m on the gel, Gaussian deviation, of the gel's slopes within the contact; 0 is none
    slope_smoothing: float
    image_smoothing: float  #: m on the gel, Gaussian deviation of the optical blur; 0 is none
    #: Photograph of the untouched sensor, relative to the file; empty is the synthetic one
    background_image: str
    background_sha256: str  #: of that file, hexadecimal; a changed picture thus changes the profile
    background_color: Vector  #: display RGB of the untouched gel away from the lights, 0 to 1
    background_glow: float  #: display value that each light adds where it is nearest, 0 to 1
    background_falloff: float  #: m on the gel, at which the glow has halved
    noise_std: float  #: grey levels (0 to 255) of Gaussian pixel noise; 0 is none
    residual: tuple[tuple[float, ...], ...] = ()  #: of a fitted light model; see `residual`; empty is none

    def __post_init__(self) -> None:
        """Check every range."""
        positive = (
            *("height", "width", "vertical_fov_deg", "camera_to_gel", "gel_dome_radius"),
            *("elastomer_thickness", "young_modulus", "max_indentation"),
            *("roughness", "gamma", "gain", "background_falloff"),
        )
        non_negative = (
            *("gel_curvature", "poisson_ratio", "ambient", "albedo", "metallic", "slope_smoothing"),
            *("image_smoothing", "press_depth", "background_color", "background_glow", "noise_std"),
        )
        at_most_one = ("albedo", "metallic", "roughness", "background_color", "background_glow")
        for name in positive + non_negative:
            for value in _flat(getattr(self, name)):
                self._require(math.isfinite(value), name, "finite")
                self._require(value > 0 or name in non_negative, name, "positive")
                self._require(value >= 0, name, "zero or positive")
                self._require(value <= 1 or name not in at_most_one, name, "at most 1")
        self._require(min(self.height, self.width) >= 2, "height and width", "at least 2")
        self._require(self.vertical_fov_deg < 180, "vertical_fov_deg", "less than 180")
        for less, more in (
            ("elastomer_thickness", "camera_to_gel"),
            ("max_indentation", "elastomer_thickness"),
        ):
            self._require(getattr(self, less) < getattr(self, more), less, f"less than {more}")
        self._require(self.gel in GELS, "gel", f"one of {', '.join(GELS)}")
        self._require(self.poisson_ratio < 0.5, "poisson_ratio", "less than 0.5")
        # The rim of the cap lies this far off the axis, and must lie outside the field of view.
        rim = self.camera_to_gel - self.gel_curvature * self.gel_dome_radius**2
        seen = math.hypot(*self.half_extent) * rim
        filling = f"more than {seen:.4g}, so that the dome fills the field of view"
        self._require(self.gel_dome_radius > seen, "gel_dome_radius", filling)
        # Gel and blur pad the image by these lengths: bound the memory.
        side = min(self.height, self.width) * self.pixel_pitch
        for name, part in (("elastomer_thickness", 2), ("slope_smoothing", 4), ("image_smoothing", 4)):
            most = side / part
            expected = f"at most {most:.4g}, 1/{part} of the picture's shorter side on the gel"
            self._require(getattr(self, name) <= most, name, expected)
        low, high = self.press_depth
        self._require(low <= high <= self.max_indentation, "press_depth", "[low, high] up to max_indentation")
        self._require(len(self.lights) > 0, "lights", "at least one light")
        for light in self.lights:
            self._require(all(map(math.isfinite, light.position)), "lights", "at finite positions")
            self._require(all(0 <= c <= 1 for c in light.color), "lights", "of colors between 0 and 1")
            self._require(0 < light.intensity < math.inf, "lights", "of positive intensity")
        shape, expected = [len(row) for row in self.residual], f"empty or 3 x {RESIDUAL_TERMS} numbers"
        self._require(shape in ([], [RESIDUAL_TERMS] * 3), "residual", expected)
        self._require(all(map(math.isfinite, sum(self.residual, ()))), "residual", "finite")

    def _require(self, condition: bool, name: str, expected: str) -> None:
        if not condition:
            given = f"{name} = {quoted(getattr(self, name, None))}"
            raise ObjectFolderError(f"sensor profile {self.name!r}: {given} must be {expected}")

    @property
    def half_extent(self) -> tuple[float, float]:
        """Tangents of half the vertical and half the horizontal field of view."""
        vertical = math.tan(math.radians(self.vertical_fov_deg) / 2)
        return vertical, vertical * self.width / self.height

    @property
    def pixel_pitch(self) -> float:
        """Distance between pixel centres on the gel at its apex, in metres."""
        return 2 * self.half_extent[0] * self.camera_to_gel / self.height

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary; `from_dict` reads it. An empty residual is left out."""
        values = asdict(self)
        if not self.residual:
            del values["residual"]
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], stored: bool = False) -> "SensorProfile":
        """Inverse of `to_dict`; also accepts lists and whole numbers, as JSON and YAML store them.

        Raises ObjectFolderError if a field is missing, of the wrong type, outside its range, or unknown,
        which in values ``stored`` in an Object File are those of newer versions, and ignored.
        """
        return _from_mapping(cls, _known(cls, values) if stored else values, "sensor profile")


def available_profiles() -> list[str]:
    """Return the names of the profiles in the package."""
    return sorted(path.stem for path in _PROFILES.glob("*.yaml"))


def load_profile(sensor: str | Path | SensorProfile) -> SensorProfile:
    """Read a profile from YAML, by its name in the package or by path; a profile is returned as it is.

    Raises ObjectFolderError if there is no such profile, or it is not valid.
    """
    if isinstance(sensor, SensorProfile):
        return sensor
    if not isinstance(sensor, str | Path):
        kind = type(sensor).__name__
        raise ObjectFolderError(f"sensor is of type {kind}, expected a name, a path or a profile")
    path = Path(sensor)
    named = not is_yaml_name(path)
    if named:
        path = _PROFILES / f"{sensor}.yaml"
    try:
        known = path.is_file()
    except OSError:  # too long for a name
        known = False
    if not known:
        known_names = ", ".join(available_profiles())
        raise ObjectFolderError(
            f"unknown sensor profile {shortened(sensor)!r}: expected one of {known_names}, or a .yaml file"
            if named
            else f"sensor profile {shortened(sensor)!r}: there is no such file; give the path of one that "
            f"exists, or one of the names {known_names}"
        )
    values = read_yaml(path)
    try:
        profile = SensorProfile.from_dict(values)
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{path}: {error}") from error
    if not profile.background_image:
        return profile
    picture = path.parent / profile.background_image
    if picture.is_file():  # `Optics` raises an error if it is missing
        digest = hashlib.sha256(picture.read_bytes()).hexdigest()
        if digest != profile.background_sha256:
            raise ObjectFolderError(
                f"{path}: background_sha256 = {profile.background_sha256!r} is not that of {picture}; "
                f"if this is the picture you want, set background_sha256: {digest}"
            )
    return replace(profile, background_image=str(picture))


def require_renderer(profile: SensorProfile, renderer: str) -> None:
    """Raise ObjectFolderError unless the renderer can draw the sensor's images."""
    if renderer not in RENDERERS:
        raise ObjectFolderError(f"renderer is {renderer!r}, expected one of {', '.join(RENDERERS)}")
    if renderer == "tacto" and profile.gel != "rigid":
        raise ObjectFolderError(
            f"renderer tacto draws a rigid gel, and that of sensor {profile.name!r} is {profile.gel}; "
            "set sensor: tacto_digit, or render_touch.renderer: gel"
        )


def _known(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values without unknown fields, of lights neither."""
    known = {field.name: values[field.name] for field in fields(cls) if field.name in values}
    if isinstance(lights := known.get("lights"), list | tuple):
        known["lights"] = [_known(Light, of) if isinstance(of, Mapping) else of for of in lights]
    return known


def _from_mapping(cls: type[_T], values: Any, what: str) -> _T:
    if not isinstance(values, Mapping):
        raise ObjectFolderError(f"{what}: expected named fields, got {quoted(values)}")
    declared = {field.name: field.type for field in fields(cls)}  # type: ignore[arg-type]
    required = {field.name for field in fields(cls) if field.default is MISSING}  # type: ignore[arg-type]
    missing, unknown = required - values.keys(), values.keys() - declared.keys()
    if missing or unknown:
        problems = [f"lacks {', '.join(sorted(missing))}"] if missing else []
        problems += [f"has unknown fields {', '.join(sorted(map(str, unknown)))}"] if unknown else []
        raise ObjectFolderError(f"{what} {' and '.join(problems)}; the fields are {', '.join(declared)}")
    given = {name: kind for name, kind in declared.items() if name in values}
    return cls(**{name: _coerce(values[name], kind, f"{what}: {name}") for name, kind in given.items()})


def _coerce(value: Any, kind: Any, what: str) -> Any:
    """Check a YAML or JSON value against the declared type of its field."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    sequence = isinstance(value, list | tuple)
    if kind is str and isinstance(value, str):
        return value
    if kind is int and number and float(value).is_integer():
        return int(value)
    if kind is float and number:
        return float(value)
    if kind == tuple[Light, ...] and sequence:
        return tuple(_from_mapping(Light, item, what) for item in value)
    rows = sequence and all(isinstance(row, list | tuple) for row in value)
    if kind == tuple[tuple[float, ...], ...] and rows:
        return tuple(tuple(_coerce(item, float, what) for item in row) for row in value)
    lengths = {Vector: 3, tuple[float, float]: 2}
    if kind in lengths and sequence and len(value) == lengths[kind]:
        return tuple(_coerce(item, float, what) for item in value)
    expected = {str: "text", int: "a whole number", float: "a number"}.get(kind, "a list of numbers")
    if kind in lengths:
        expected = f"{lengths[kind]} numbers"
    raise ObjectFolderError(f"{what} = {quoted(value)} must be {expected}")


def _flat(value: float | tuple[float, ...]) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)
