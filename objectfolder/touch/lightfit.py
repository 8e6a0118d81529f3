"""Fit of the lights of a sensor, and of what they leave over, to photographs of a pressed ball."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import least_squares

from objectfolder.touch.ball import BallModel
from objectfolder.touch.profiles import Light, SensorProfile, Vector
from objectfolder.touch.residual import places, residual_levels, residual_terms
from objectfolder.touch.shading import Vectors, radiance

_MAX_LEVEL = 255.0  # grey levels

# Bounds: distance of a light from the gel and off the axis, m; logarithms of intensity, ambient light and
# gamma; roughness. Intensities are in units of candelas per grey level where radiance 1 is white.
_GEL_CLEARANCE, _MAX_OFFSET = 1e-3, 0.06
_INTENSITY = np.log(1e-7), np.log(0.05)
_AMBIENT = np.log(1e-4), 0.0
_GAMMA = np.log(0.7), np.log(3.0)
_ROUGHNESS = 0.05, 1.0

# Start: lights this far before the gel, and that far off the axis.
_START_HEIGHT, _START_OFFSET = 0.01, 0.016
_START_INTENSITY, _START_AMBIENT, _START_GAMMA, _START_ROUGHNESS = 5e-4, 0.05, 1.5, 0.8

_POSITION_STEP = 1e-4  # m, step of a light's finite differences
_STEPS = np.array([0.2, 0.2, 0.02])  # of a ball's: pixels, pixels, part of its depth
_MAX_POSE_SHIFT = 6.0  # pixels that a ball may move
_LIGHT_ROUNDS, _POSE_ROUNDS = 40, 8

_MAX_RADIANCE = 0.9  # radiance

_RESIDUAL_ROUNDS = 30
_RIDGE = 0.01  # of the residual, relative to the mean square of its scaled terms


@dataclass(frozen=True)
class Photograph:
    """A ball pressed on the sensor."""

    picture: np.ndarray  #: (H, W, 3) float32, grey levels
    disc: np.ndarray  #: (H, W) bool, the pixels to explain
    pose: np.ndarray  #: (3,) row and column of the ball's centre, pixels; press depth, m


def circle_mask(circle: tuple[float, float, float], shape: tuple[int, ...]) -> np.ndarray:
    """Return the pixels within a circle of row, column and radius in pixels; (H, W) bool."""
    row, column, radius = circle
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


class _Surface:
    """Points of the gel inside the discs of some photographs, deformed and at rest, and what they show."""

    def __init__(self, model: BallModel, untouched: np.ndarray, photographs: list[Photograph]):
        place, rest = places(model.profile), model.still
        parts = []
        for photograph in photographs:
            disc = photograph.disc
            moved = model.optics.surface(model.displacement(photograph.pose))
            axes = [np.asarray(axis) for vectors in (*moved[:2], *rest) for axis in vectors]
            columns = [axis.reshape(disc.shape)[disc] for axis in axes]
            columns += [moved[2][i][0][disc] for i in (0, 1)] + [axis[disc] for axis in place]
            parts.append(np.stack(columns).astype(np.float32))
        values = np.concatenate(parts, axis=1)
        self.moved: tuple[Vectors, Vectors] = tuple(values[:3]), tuple(values[3:6])
        self.still: tuple[Vectors, Vectors] = tuple(values[6:9]), tuple(values[9:12])
        self.tilt, self.place = values[12:14], values[14:16]
        seen = [np.stack([untouched[p.disc], p.picture[p.disc]]) for p in photographs]
        self.untouched, self.picture = np.moveaxis(np.concatenate(seen, axis=1), -1, 1).astype(float)

    def levels(self, profile: SensorProfile) -> np.ndarray:
        """Return what a profile shows, grey levels before saturation; (3, M)."""
        change = _display(radiance(*self.moved, profile), profile.gamma)
        change -= _display(radiance(*self.still, profile), profile.gamma)
        levels = self.untouched + _MAX_LEVEL * profile.gain * change
        if profile.residual:
            levels += residual_levels(self.tilt, self.place, profile.residual)
        return levels

    def error(self, profile: SensorProfile) -> np.ndarray:
        """Return the difference of image and photograph, grey levels; (3, M)."""
        return self.levels(profile).clip(0, _MAX_LEVEL) - self.picture


def squared_error(
    profile: SensorProfile, radius: float, untouched: np.ndarray, photographs: list[Photograph]
) -> float:
    """Return the mean squared error of a profile's images inside the discs, squared grey levels.

    Gel and optics are those of the profile, without its optical blur; the radius of the ball is in metres,
    ``untouched`` (H, W, 3) the picture of the sensor at rest.
    """
    surface = _Surface(BallModel(profile, radius), untouched, photographs)
    return float(np.mean(surface.error(profile) ** 2))


def fit_lights(
    model: BallModel, untouched: np.ndarray, photographs: list[Photograph], start: SensorProfile
) -> SensorProfile:
    """Fit places and colours of the lights, ambient light, roughness and gamma, for balls in known poses.

    Least squares over the pixels of the discs, with pixel values cut off at 0 and 255 as a camera does, from
    the values of ``start``, which is returned with what was fitted.
    """
    surface = _Surface(model, untouched, photographs)
    count = len(start.lights)
    deepest = model.profile.camera_to_gel - _GEL_CLEARANCE
    place = (0.0, -_MAX_OFFSET, -_MAX_OFFSET), (deepest, _MAX_OFFSET, _MAX_OFFSET)
    bounds = [
        np.concatenate([np.tile(np.r_[at, [strength] * 3], count), coating])
        for at, strength, coating in zip(place, _INTENSITY, zip(_AMBIENT, _GAMMA, _ROUGHNESS))
    ]
    scale = np.concatenate([np.tile(np.r_[[1e-3] * 3, [0.1] * 3], count), [0.1, 0.1, 0.05]])

    def residuals(x: np.ndarray) -> np.ndarray:
        return surface.error(_with_lights(start, x)).ravel()

    def jacobian(x: np.ndarray) -> np.ndarray:
        return _light_jacobian(surface, start, x)

    first = np.clip(_parameters(start), bounds[0] + 1e-9, bounds[1] - 1e-9)
    options = {"bounds": bounds, "x_scale": scale, "max_nfev": _LIGHT_ROUNDS, "ftol": 1e-4}
    found = least_squares(residuals, first, jacobian, **options)
    return _with_lights(start, found.x)


def fit_pose(
    model: BallModel, profile: SensorProfile, untouched: np.ndarray, photograph: Photograph
) -> Photograph:
    """Return a photograph with the ball where the profile's image agrees best inside the disc."""
    scale = np.array([1, 1, photograph.pose[2]])

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = replace(photograph, pose=x * scale)
        return _Surface(model, untouched, [moved]).error(profile).ravel()

    def jacobian(x: np.ndarray) -> np.ndarray:
        # From both sides: outside the rim of a rigid imprint the image does not change at all.
        moved = [residuals(x + step) - residuals(x - step) for step in np.diag(_STEPS)]
        return np.stack(moved, axis=1) / (2 * _STEPS)

    first = photograph.pose / scale
    reach = np.array([_MAX_POSE_SHIFT, _MAX_POSE_SHIFT, 0.95])
    low, high = first - reach, first + reach
    high[2] = max(model.profile.max_indentation / scale[2], 1.001)
    found = least_squares(
        residuals, first, jacobian, bounds=(low, high), x_scale=_STEPS, max_nfev=_POSE_ROUNDS, xtol=1e-3
    )
    return replace(photograph, pose=found.x * scale)


def limit_radiance(profile: SensorProfile, photographs: list[Photograph], model: BallModel) -> SensorProfile:
    """Return the same change of colours by dimmer lights and a larger gain.

    Optics cut radiance off at 1, the fit does not. Here no pixel of the gel, at rest or under the ball, is
    brighter than ``_MAX_RADIANCE``.
    """
    pressed = [model.displacement(photograph.pose) for photograph in photographs]
    points, normals, _ = model.optics.surface(torch.cat([torch.zeros_like(pressed[0]), *pressed]))
    factor = _MAX_RADIANCE / float(radiance(points, normals, profile).max())
    lights = tuple(replace(light, intensity=light.intensity * factor) for light in profile.lights)
    gain = profile.gain * factor ** (-1 / profile.gamma)
    return replace(profile, lights=lights, ambient=profile.ambient * factor, gain=gain)


def fit_residual(
    model: BallModel, profile: SensorProfile, untouched: np.ndarray, photographs: list[Photograph]
) -> SensorProfile:
    """Return the profile with the polynomial that explains best what its lights leave over.

    Ridge regression, with pixel values cut off at 0 and 255 as a camera does.
    """
    surface = _Surface(model, untouched, photographs)
    lights = replace(profile, residual=())
    levels = surface.levels(lights)
    terms = np.stack(residual_terms(surface.tilt, surface.place), axis=1).astype(float)
    scale = np.sqrt(np.mean(terms**2, axis=0)) + 1e-12
    terms /= scale
    ridge = np.sqrt(_RIDGE * len(terms)) * np.eye(terms.shape[1])
    rows = []
    for level, seen in zip(levels, surface.picture):

        def errors(row: np.ndarray, level: np.ndarray = level, seen: np.ndarray = seen) -> np.ndarray:
            return np.concatenate([(level + terms @ row).clip(0, _MAX_LEVEL) - seen, ridge @ row])

        def jacobian(row: np.ndarray, level: np.ndarray = level) -> np.ndarray:
            shown = level + terms @ row
            return np.concatenate([terms * ((shown > 0) & (shown < _MAX_LEVEL))[:, None], ridge])

        found = least_squares(errors, np.zeros(terms.shape[1]), jacobian, max_nfev=_RESIDUAL_ROUNDS)
        rows.append(found.x / scale)
    return replace(profile, residual=tuple(tuple(map(float, row)) for row in rows))


def starting_lights(profile: SensorProfile, count: int) -> SensorProfile:
    """Return the profile with white lights in a circle, and the optics that `fit_lights` starts from.

    Nothing blurs the image: the lights are fitted to single pixels.
    """
    azimuth = 2 * np.pi * (np.arange(count) + 0.4) / count
    depth = profile.camera_to_gel - min(_START_HEIGHT, profile.camera_to_gel / 2)
    places = [(depth, _START_OFFSET * float(np.cos(a)), _START_OFFSET * float(np.sin(a))) for a in azimuth]
    lights = tuple(Light(place, (1.0, 1.0, 1.0), _START_INTENSITY) for place in places)
    plain = replace(profile, lights=lights, gain=1.0, residual=(), image_smoothing=0.0)
    return replace(plain, ambient=_START_AMBIENT, gamma=_START_GAMMA, roughness=_START_ROUGHNESS)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _display(light: np.ndarray, gamma: float) -> np.ndarray:
    return light.astype(float).clip(1e-30) ** (1 / gamma)


def _parameters(profile: SensorProfile) -> np.ndarray:
    """Return places and logarithmic colours of the lights, then ambient, gamma and roughness."""
    colors = [np.maximum(np.array(light.color) * light.intensity, 1e-12) for light in profile.lights]
    lights = [np.r_[light.position, np.log(color)] for light, color in zip(profile.lights, colors)]
    coating = [np.log(max(profile.ambient, 1e-12)), np.log(profile.gamma), profile.roughness]
    return np.concatenate([*lights, coating])


def _with_lights(profile: SensorProfile, x: np.ndarray) -> SensorProfile:
    lights = []
    for values in x[:-3].reshape(-1, 6):
        color = np.exp(values[3:])
        lights.append(Light(_vector(values[:3]), _vector(color / color.max()), float(color.max())))
    ambient, gamma = (float(np.exp(value)) for value in x[-3:-1])
    return replace(profile, lights=tuple(lights), ambient=ambient, gamma=gamma, roughness=float(x[-1]))


def _light_jacobian(surface: _Surface, start: SensorProfile, x: np.ndarray) -> np.ndarray:
    """Derivatives of the errors (3, M), flattened: exact but for places and roughness.

    Radiance is a sum over the lights, so a light's derivatives need that light alone.
    """
    profile = _with_lights(start, x)
    count = len(profile.lights)
    columns = np.zeros((len(x), *surface.picture.shape))
    for sign, at in ((1, surface.moved), (-1, surface.still)):
        fields = [_field(at, profile, light.position) for light in profile.lights]
        colors = np.exp(x[: 6 * count].reshape(count, 6)[:, 3:])
        light = radiance(*at, profile).astype(float)
        slope = light.clip(1e-12) ** (1 / profile.gamma - 1) / profile.gamma
        for k, (field, color) in enumerate(zip(fields, colors)):
            for axis in range(3):
                position = np.array(profile.lights[k].position)
                position[axis] -= _POSITION_STEP
                change = (field - _field(at, profile, _vector(position))) / _POSITION_STEP
                columns[6 * k + axis] += sign * slope * change * color[:, None]
            for channel in range(3):
                columns[6 * k + 3 + channel, channel] += sign * slope[channel] * field * color[channel]
        columns[-3] += sign * slope * profile.ambient
        shown = _display(light, profile.gamma)
        columns[-2] -= sign * shown * np.log(light.clip(1e-30)) / profile.gamma
        rougher = replace(profile, roughness=profile.roughness - 0.01)
        columns[-1] += sign * slope * (light - radiance(*at, rougher)) / 0.01
    levels = surface.levels(profile)
    columns *= _MAX_LEVEL * profile.gain * ((levels > 0) & (levels < _MAX_LEVEL))
    return columns.reshape(len(x), -1).T


def _field(at: tuple[Vectors, Vectors], profile: SensorProfile, position: Vector) -> np.ndarray:
    """Radiance by one light of unit intensity; (M,) float64."""
    one = replace(profile, ambient=0.0, lights=(Light(position, (1.0, 0.0, 0.0), 1.0),))
    return radiance(*at, one)[0].astype(float)
