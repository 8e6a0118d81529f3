"""Fit of a sensor profile to a few pictures of a ball of known size, pressed on a real sensor."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from objectfolder.base.arrays import write_png
from objectfolder.base.errors import ObjectFolderError, plural
from objectfolder.base.io import file_digest, write_json, write_text
from objectfolder.base.metrics import psnr
from objectfolder.touch import imprint, lightfit
from objectfolder.touch.ball import BallModel
from objectfolder.touch.imprint import Imprint, check_circles, find_imprint
from objectfolder.touch.lightfit import Photograph
from objectfolder.touch.profiles import SensorProfile

# Steps of finite differences: logarithm of an intensity, row and column in pixels, part of the depth.
_STEPS = np.array([0.02, 0.2, 0.2, 0.02])

# Factors of these steps, one fit after another. Images of a rigid gel jump at the rim of the imprint, pixel
# by pixel; with large steps first, the fit passes over the local minima.
_REFINEMENTS = {"soft": (1.0,), "rigid": (6.0, 3.0, 1.5)}

_MAX_ROUNDS = 30

_ALTERNATIONS = 4  # of lights and poses

MAX_BALL_RADIUS = 0.05  #: m, radius: more is given in millimetres

_MIN_PIXELS = 50  # of an imprint whose lights are fitted; as of the smallest that `find_imprint` accepts


@dataclass(frozen=True)
class LightFit:
    """Fitted strength of the lights of one colour, which change together."""

    color: tuple[float, float, float]
    factor: float  #: multiplies the intensities of the given profile
    error: float  #: standard error of the factor, from the pictures' noise alone


@dataclass(frozen=True)
class SensorFit:
    """Fitted profile and its quality."""

    profile: SensorProfile
    background: np.ndarray  #: (H, W, 3) uint8
    imprints: list[Imprint]
    lights: list[LightFit]
    psnr_before: float  #: dB over all pictures, with the given lights on the fitted background
    psnr_after: float  #: dB, with the fitted lights


def fit_sensor(
    pictures: np.ndarray,
    radius: float,
    profile: SensorProfile,
    untouched: np.ndarray | None = None,
    circles: Sequence[tuple[float, float, float]] | None = None,
    names: Sequence[str] | None = None,
) -> SensorFit:
    """Fit the strength of the lights, and the background, by least squares.

    The unknowns are one factor per colour of light, and the position and depth of the ball in each picture.
    The background is the picture of the untouched sensor; without one, it is the per-pixel mean of the
    residuals. Everything else, above all the gel, is taken from the given profile.

    Parameters
    ----------
    pictures : (K, H, W, 3) uint8 array
        RGB, each of the ball pressed anywhere.
    radius : float
        Radius of the ball, metres.
    profile : SensorProfile
        Initial profile.
    untouched : (H, W, 3) uint8 array, optional
    circles : K tuples of three floats, optional
        Initial row, column and radius of the imprints, pixels; by default found in the pictures.
    names : K strings, optional
        Names of the pictures in error messages.

    Raises
    ------
    ObjectFolderError
        If a picture shows no imprint of a ball, a circle is not in its picture, or the pictures do not
        determine the background.
    """
    names = _checked_names(names, len(pictures), radius)
    needed = 1 if untouched is not None else 3 if circles is None else 2
    if len(pictures) < needed:
        raise ObjectFolderError(
            f"{plural(len(pictures), 'picture')} cannot determine the background: give one of the untouched "
            f"sensor, or {needed} pictures with the ball at different positions"
        )
    observed = np.asarray(pictures, np.float32)
    if circles is None:
        changes = observed - imprint.estimate_untouched(observed, untouched)
        circles = [find_imprint(change, name) for change, name in zip(changes, names)]
    check_circles(circles, observed.shape[1:3], names)
    if untouched is None:
        imprint.check_background_seen(circles, observed.shape[1:3], names)
    model = BallModel(profile, radius)
    start = [np.zeros(len(model.colors))]
    for row, column, pixels in circles:
        start.append(np.array([row, column, model.depth_of(row, column, pixels)]))
    return _solve(model, observed, untouched, np.concatenate(start))


def fit_sensor_lights(
    pictures: np.ndarray,
    radius: float,
    profile: SensorProfile,
    untouched: np.ndarray,
    circles: Sequence[tuple[float, float, float]] | None = None,
    names: Sequence[str] | None = None,
    count: int = 6,
    residual: bool = False,
) -> SensorFit:
    """Fit places, colours and strengths of lights, the coating and the camera's exponent.

    Lights and the balls' poses are fitted in turn, to the pixels inside the circles of the imprints: outside
    them, a photograph shows cast shadows, which the optics leave out. Pixels that overflowed are left out,
    too. Only geometry and gel are taken from the given profile. Decibels are those of the fitted pixels.

    Parameters
    ----------
    pictures, radius, profile, circles, names : as for `fit_sensor`
    untouched : (H, W, 3) uint8 array
        Picture of the untouched sensor.
    count : int
        Number of lights.
    residual : bool
        Fit the profile's ``residual``, too; see `objectfolder.touch.residual`.

    Raises
    ------
    ObjectFolderError
        If a picture shows no imprint of a ball, a circle is not in its picture or too small, or the ball's
        radius is not positive.
    """
    names = _checked_names(names, len(pictures), radius)
    if count < 1:
        raise ObjectFolderError(f"{count} lights to fit, expected at least 1")
    observed, rest = np.asarray(pictures, np.float32), np.asarray(untouched, np.float32)
    if circles is None:
        circles = [find_imprint(picture - rest, name) for picture, name in zip(observed, names)]
    check_circles(circles, rest.shape, names)
    within = (lightfit.circle_mask(circle, rest.shape) for circle in circles)
    discs = [disc & ~imprint.find_overflow(of) for of, disc in zip(observed, within)]
    for disc, name in zip(discs, names):
        if disc.sum() < _MIN_PIXELS:
            raise ObjectFolderError(
                f"{name}: the circle covers {disc.sum()} pixels that did not overflow, expected at least "
                f"{_MIN_PIXELS}; give a larger --circle, or leave the picture out"
            )
    model = BallModel(profile, radius)
    poses = [np.array([*circle[:2], model.depth_of(*circle)]) for circle in circles]
    photographs = list(map(Photograph, observed, discs, poses))
    fitted = lightfit.starting_lights(profile, count)
    for _ in range(_ALTERNATIONS):
        fitted = lightfit.fit_lights(model, rest, photographs, fitted)
        photographs = [lightfit.fit_pose(model, fitted, rest, photograph) for photograph in photographs]
    fitted = lightfit.limit_radiance(fitted, photographs, model)
    if residual:
        fitted = lightfit.fit_residual(model, fitted, rest, photographs)
    errors = (lightfit.squared_error(of, radius, rest, photographs) for of in (profile, fitted))
    before, after = (float(psnr(error, 255)) for error in errors)
    imprints = [Imprint(*map(float, photograph.pose)) for photograph in photographs]
    background = np.asarray(untouched, np.uint8)
    fitted = replace(fitted, background_image="", background_sha256="")
    return SensorFit(fitted, background, imprints, [], before, after)


def _checked_names(names: Sequence[str] | None, count: int, radius: float) -> Sequence[str]:
    """Return names of so many pictures, if the radius is one of a ball."""
    if not (np.isfinite(radius) and 0 < radius <= MAX_BALL_RADIUS):
        hint = f"; did you mean {radius / 1000:g}, in metres?" if MAX_BALL_RADIUS < radius < 1000 else ""
        raise ObjectFolderError(
            f"the ball's radius is {radius:g} m, expected a positive length up to {MAX_BALL_RADIUS:g} m{hint}"
        )
    return names or [f"picture {i}" for i in range(1, count + 1)]


def _solve(
    model: BallModel, observed: np.ndarray, untouched: np.ndarray | None, start: np.ndarray
) -> SensorFit:
    count = len(model.colors)
    steps = np.concatenate([np.full(count, _STEPS[0]), np.tile(_STEPS[1:], len(observed))])
    steps[count + 2 :: 3] *= start[count + 2 :: 3]

    def changes(x: np.ndarray) -> np.ndarray:
        return np.stack([model.change(x[:count], pose) for pose in x[count:].reshape(-1, 3)])

    def residuals(changed: np.ndarray) -> np.ndarray:
        remaining = observed - changed
        remaining -= remaining.mean(axis=0) if untouched is None else untouched
        return remaining.ravel()

    def jacobian(x: np.ndarray, steps: np.ndarray) -> np.ndarray:
        here = changes(x)
        columns = []
        # From both sides: outside the rim of a rigid imprint the image does not change at all.
        for i, step in enumerate(np.diag(steps)):
            sides = []
            for there in (x + step, x - step):
                changed = here.copy()
                if i < count:
                    changed = changes(there)
                else:  # the pose of one ball changes one picture
                    k = (i - count) // 3
                    changed[k] = model.change(x[:count], there[count + 3 * k : count + 3 * k + 3])
                sides.append(residuals(changed))
            columns.append((sides[0] - sides[1]) / (2 * steps[i]))
        return np.stack(columns, axis=1)

    for factor in _REFINEMENTS[model.profile.gel]:
        slopes = partial(jacobian, steps=factor * steps)
        limits = {"max_nfev": _MAX_ROUNDS, "xtol": 1e-4, "ftol": 1e-6}
        found = least_squares(lambda x: residuals(changes(x)), start, slopes, x_scale=steps, **limits)
        start = found.x
    free = found.fun.size - found.x.size
    if untouched is None:  # the background is unknown, too
        free -= observed[0].size
    variance = 2 * found.cost / max(free, 1)
    information = found.jac.T @ found.jac
    weakest = np.abs(np.diag(information)[:count]).min()
    if not weakest > 0:
        raise ObjectFolderError(
            f"one of the lights of profile {model.profile.name!r} has no effect on the pictures and cannot "
            "be fitted; correct or remove it"
        )
    deviation = np.sqrt(variance * np.diag(np.linalg.pinv(information)))
    factors = np.exp(found.x[:count])
    fits = zip(model.colors, factors, deviation)
    lights = [LightFit(color, float(factor), float(factor * d)) for color, factor, d in fits]
    background = untouched
    if background is None:
        mean = (observed - changes(found.x)).mean(axis=0)
        background = mean.round().clip(0, 255).astype(np.uint8)
    as_given = np.concatenate([np.zeros(count), found.x[count:]])
    errors = (float(np.mean(residuals(changes(x)) ** 2)) for x in (as_given, found.x))
    before, after = (float(psnr(error, 255)) for error in errors)
    imprints = [Imprint(*map(float, pose)) for pose in found.x[count:].reshape(-1, 3)]
    return SensorFit(model.lit(found.x[:count]), background, imprints, lights, before, after)


def save_fit(fit: SensorFit, path: str | Path, name: str, source: str) -> list[Path]:
    """Write a fitted profile, its background (``_background.png``) and a report (``_report.json``).

    ``path`` is the ``.yaml`` file of the profile, ``source`` that of its numbers. Returns the files written.
    """
    from ruamel.yaml import YAML

    path = Path(path)
    picture, report = (path.with_name(f"{path.stem}_{end}") for end in ("background.png", "report.json"))
    write_png(picture, fit.background)
    profile = replace(fit.profile, name=name, source=source)
    profile = replace(profile, background_image=picture.name, background_sha256=file_digest(picture))
    yaml = YAML()
    yaml.default_flow_style = None
    values = json.loads(json.dumps(profile.to_dict()))  # lists for tuples, which YAML does not have
    stream = StringIO()
    yaml.dump(values, stream)
    write_text(path, stream.getvalue())
    found = {name: [asdict(one) for one in getattr(fit, name)] for name in ("lights", "imprints")}
    write_json(report, found | {"psnr_before": fit.psnr_before, "psnr_after": fit.psnr_after})
    return [path, picture, report]
