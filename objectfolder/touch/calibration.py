"""Fits a sensor profile to a few pictures of a ball of known size, pressed on a real sensor."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from skimage.filters import threshold_otsu
from skimage.measure import label, regionprops

from objectfolder.errors import ObjectFolderError
from objectfolder.io import atomic, file_digest, write_json, write_png
from objectfolder.metrics import psnr
from objectfolder.touch.camera import gel_depth, ray_directions
from objectfolder.touch.contact import GAP
from objectfolder.touch.gel import deform
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile

# Of an imprint: pixels, how far its brightness stands out of the noise, how full its hull is of it, and how
# long it is for its width.
_MIN_RADIUS, _MIN_CONTRAST, _MIN_FILL, _MAX_ELONGATION = 4.0, 4.0, 0.5, 1.6

# Without a picture of the untouched sensor, this much of each imprint must be free in another picture.
_MIN_FREE = 0.5

# Of the parameters, for finite differences: logarithm of an intensity, pixels, pixels, a part of the depth.
_STEPS = np.array([0.02, 0.2, 0.2, 0.02])

_MAX_ROUNDS = 30


@dataclass(frozen=True)
class Imprint:
    """Where and how deep a ball is pressed."""

    row: float  #: pixels, of its centre
    column: float  #: pixels
    depth: float  #: m, that the ball is pressed beyond the undeformed gel, along the gel's normal


@dataclass(frozen=True)
class LightFit:
    """Strength of the lights of one colour, which change together."""

    color: tuple[float, float, float]
    factor: float  #: by which the intensities of the given profile are multiplied
    error: float  #: one standard deviation of the factor, as far as the pictures' noise explains it


@dataclass(frozen=True)
class SensorFit:
    """A fitted profile, and how well it does."""

    profile: SensorProfile
    background: np.ndarray  #: (H, W, 3) uint8
    imprints: list[Imprint]
    lights: list[LightFit]
    psnr_before: float  #: dB, of the pictures, with the given intensities on the fitted background
    psnr_after: float  #: dB


def fit_sensor(
    pictures: np.ndarray,
    radius: float,
    profile: SensorProfile,
    untouched: np.ndarray | None = None,
    circles: Sequence[tuple[float, float, float]] | None = None,
    names: Sequence[str] | None = None,
) -> SensorFit:
    """Fit the strength of the lights, and the background, by least squares.

    Unknown are one factor per colour of light, and for each picture the ball's place and depth. The
    background is the picture of the untouched sensor; without one it is, per pixel, the mean of what the
    model leaves of the pictures. Everything else is the given profile's, the gel above all.

    Parameters
    ----------
    pictures : (K, H, W, 3) uint8 array
        One ball each, pressed anywhere, RGB.
    radius : float
        Of the ball, metres.
    profile : SensorProfile
        To start from.
    untouched : (H, W, 3) uint8 array, optional
    circles : K tuples of three floats, optional
        Row, column and radius of the imprints, pixels, to start from; found in the pictures if not given.
    names : K strings, optional
        Of the pictures, for errors.

    Raises
    ------
    ObjectFolderError
        If a picture shows no imprint of a ball, or the pictures do not tell the background.
    """
    names = names or [f"picture {i}" for i in range(1, len(pictures) + 1)]
    if not (np.isfinite(radius) and radius > 0):
        raise ObjectFolderError(f"the ball's radius is {radius:g} m, expected a positive length in metres")
    wanted = 1 if untouched is not None else 3 if circles is None else 2
    if len(pictures) < wanted:
        raise ObjectFolderError(
            f"{len(pictures)} pictures do not tell the background: give one of the untouched sensor, or "
            f"{wanted} pictures with the ball in different places"
        )
    if circles is not None and len(circles) != len(pictures):
        raise ObjectFolderError(f"{len(circles)} circles for {len(pictures)} pictures: expected one for each")
    observed = np.asarray(pictures, np.float32)
    if circles is None:
        circles = [
            find_imprint(picture - rest, name)
            for picture, rest, name in zip(observed, _rest(observed, untouched), names)
        ]
    if untouched is None:
        _check_free(circles, observed.shape[1:3], names)
    model = _Model(profile, radius)
    start = [np.zeros(len(model.colors))]
    for row, column, pixels in circles:
        start.append(np.array([row, column, model.depth_of(row, column, pixels)]))
    return _solve(model, observed, untouched, np.concatenate(start))


def find_imprint(change: np.ndarray, name: str = "picture") -> tuple[float, float, float]:
    """Row, column and radius, pixels, of the round spot where a picture (H, W, 3) changes.

    Raises
    ------
    ObjectFolderError
        If nothing stands out of the noise, or what does is not round, too small or cut by the border.
    """
    strength = np.linalg.norm(gaussian_filter(change, (1.5, 1.5, 0)), axis=2)
    noise = np.median(strength)
    ask = "give its --circle, or leave the picture out"
    level = threshold_otsu(strength)
    above = strength[strength > level]
    if not above.size or above.mean() < _MIN_CONTRAST * noise + 1:
        raise ObjectFolderError(f"{name}: no imprint stands out of the untouched gel; press harder, or {ask}")
    spot = max(regionprops(label(strength > level)), key=lambda region: region.area)
    hull_radius = float(np.sqrt(spot.area_convex / np.pi))
    if hull_radius < _MIN_RADIUS:
        raise ObjectFolderError(
            f"{name}: the imprint is {hull_radius:.1f} pixels in radius, expected {_MIN_RADIUS:g} at least; "
            f"press harder, or {ask}"
        )
    top, left, bottom, right = spot.bbox
    height, width = bottom - top, right - left
    elongation = max(height, width) / min(height, width)
    if min(top, left) == 0 or bottom == change.shape[0] or right == change.shape[1]:
        raise ObjectFolderError(f"{name}: the imprint is cut by the picture's border; press further inside")
    if elongation > _MAX_ELONGATION or spot.solidity < _MIN_FILL:
        raise ObjectFolderError(
            f"{name}: what changes is not the imprint of a ball ({width} x {height} pixels, "
            f"{spot.solidity:.0%} of its hull); {ask}"
        )
    return (top + bottom - 1) / 2, (left + right - 1) / 2, (height + width) / 4


class _Model:
    """Pictures of a ball under lights of any strength."""

    def __init__(self, profile: SensorProfile, radius: float):
        self.profile, self.radius = profile, radius
        self.colors = sorted({light.color for light in profile.lights}, reverse=True)
        self._rays, self._gel = ray_directions(profile), gel_depth(profile)
        self._optics: dict[bytes, Optics] = {}
        self._displacements: dict[bytes, torch.Tensor] = {}

    def lit(self, logarithms: np.ndarray) -> SensorProfile:
        """The profile with its lights multiplied by exp of the (C,) logarithms."""
        factor = dict(zip(self.colors, np.exp(logarithms)))
        lights = [
            replace(light, intensity=float(light.intensity * factor[light.color]))
            for light in self.profile.lights
        ]
        return replace(self.profile, lights=tuple(lights), background_image="", background_sha256="")

    def depth_of(self, row: float, column: float, pixels: float) -> float:
        """Press depth, metres, at which the contact has about a radius in pixels.

        Two surfaces that overlap by δ meet at a radius sqrt(2 δ ρ), with ρ from the sum of their curvatures;
        an elastic contact has the radius sqrt(δ ρ) (Hertz).
        """
        contact = pixels * self.profile.pixel_pitch
        curvature = 1 / self.radius + self.profile.gel_curvature
        depth = contact**2 * curvature * (0.5 if self.profile.gel == "rigid" else 1.0)
        return float(np.clip(depth, 0.02 * self.profile.max_indentation, 0.9 * self.profile.max_indentation))

    def displacement(self, pose: np.ndarray) -> torch.Tensor:
        """Of the gel under the ball; (1, H, W)."""
        key = pose.tobytes()
        if key not in self._displacements:
            self._displacements[key] = torch.from_numpy(
                deform(self.height(pose)[None].astype(np.float32), self.profile)[0]
            )
        return self._displacements[key]

    def height(self, pose: np.ndarray) -> np.ndarray:
        """How far the ball is past the gel along the pixel rays; (H, W), metres; negative is a gap."""
        row, column, depth = pose
        profile = self.profile
        vertical, horizontal = profile.half_extent
        slope = np.array(
            [
                1,
                (1 - (column + 0.5) * 2 / profile.width) * horizontal,
                (1 - (row + 0.5) * 2 / profile.height) * vertical,
            ]
        )
        # The undeformed gel below the ball's centre, and its normal away from the camera.
        at = slope * gel_depth(profile, slope)
        dome = profile.gel_dome_radius
        leaning = profile.gel_curvature * dome / np.sqrt(dome**2 - at[1] ** 2 - at[2] ** 2)
        normal = np.array([1, leaning * at[1], leaning * at[2]])
        centre = at + normal / np.linalg.norm(normal) * (
            self.radius - np.clip(depth, 0, profile.max_indentation)
        )
        along, square = self._rays @ centre, (self._rays**2).sum(axis=2)
        root = along**2 - square * (centre @ centre - self.radius**2)
        ball = np.where(root >= 0, (along - np.sqrt(np.maximum(root, 0))) / square, np.inf)
        return np.clip(self._gel - ball, -GAP * profile.elastomer_thickness, profile.max_indentation)

    def change(self, logarithms: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """By how many grey levels the ball brightens the picture; (H, W, 3) float32."""
        key = logarithms.tobytes()
        if key not in self._optics:
            self._optics = {key: Optics(self.lit(logarithms))}
        return self._optics[key].change(self.displacement(pose))[0].permute(1, 2, 0).numpy()


def _solve(model: _Model, observed: np.ndarray, untouched: np.ndarray | None, start: np.ndarray) -> SensorFit:
    count = len(model.colors)
    steps = np.concatenate([np.full(count, _STEPS[0]), np.tile(_STEPS[1:], len(observed))])
    steps[count + 2 :: 3] *= start[count + 2 :: 3]

    def changes(x: np.ndarray) -> np.ndarray:
        return np.stack([model.change(x[:count], pose) for pose in x[count:].reshape(-1, 3)])

    def left(changed: np.ndarray) -> np.ndarray:
        rest = observed - changed
        rest -= rest.mean(axis=0) if untouched is None else untouched
        return rest.ravel()

    def jacobian(x: np.ndarray) -> np.ndarray:
        here = changes(x)
        columns = []
        for i, step in enumerate(steps):
            there = x.copy()
            there[i] += step
            changed = here.copy()
            if i < count:
                changed = changes(there)
            else:  # only one picture moves
                k = (i - count) // 3
                changed[k] = model.change(x[:count], there[count + 3 * k : count + 3 * k + 3])
            columns.append((left(changed) - left(here)) / step)
        return np.stack(columns, axis=1)

    found = least_squares(
        lambda x: left(changes(x)), start, jacobian, x_scale=steps, max_nfev=_MAX_ROUNDS, xtol=1e-4, ftol=1e-6
    )
    free = found.fun.size - found.x.size
    if untouched is None:  # as many unknowns as the background has values
        free -= observed[0].size
    variance = 2 * found.cost / max(free, 1)
    information = found.jac.T @ found.jac
    weakest = np.abs(np.diag(information)[:count]).min()
    if not weakest > 0:
        raise ObjectFolderError(
            "a light changes nothing in the pictures: it cannot be fitted; check the profile"
        )
    deviation = np.sqrt(variance * np.diag(np.linalg.pinv(information)))
    factors = np.exp(found.x[:count])
    lights = [
        LightFit(color, float(factor), float(factor * d))
        for color, factor, d in zip(model.colors, factors, deviation)
    ]
    background = untouched
    if background is None:
        mean = (observed - changes(found.x)).mean(axis=0)
        background = mean.round().clip(0, 255).astype(np.uint8)
    as_given = np.concatenate([np.zeros(count), found.x[count:]])
    before, after = (float(psnr(float(np.mean(left(changes(x)) ** 2)), 255)) for x in (as_given, found.x))
    imprints = [Imprint(*map(float, pose)) for pose in found.x[count:].reshape(-1, 3)]
    return SensorFit(model.lit(found.x[:count]), background, imprints, lights, before, after)


def _rest(observed: np.ndarray, untouched: np.ndarray | None) -> np.ndarray:
    """What to compare each picture with to see its imprint; (K, H, W, 3)."""
    if untouched is not None:
        return np.broadcast_to(np.asarray(untouched, np.float32), observed.shape)
    return np.broadcast_to(np.median(observed, axis=0), observed.shape)


def _check_free(
    circles: Sequence[tuple[float, float, float]], shape: tuple[int, ...], names: Sequence[str]
) -> None:
    rows, columns = np.indices(shape)
    spots = np.stack([(rows - r) ** 2 + (columns - c) ** 2 < radius**2 for r, c, radius in circles])
    everywhere = spots.all(axis=0)
    for spot, name in zip(spots, names):
        if everywhere.sum() > (1 - _MIN_FREE) * spot.sum():
            raise ObjectFolderError(
                f"{name}: the ball is in the same place as in all other pictures, which do not tell the "
                "background there; press elsewhere, or give a picture of the untouched sensor"
            )


def save_fit(fit: SensorFit, path: str | Path, name: str, source: str) -> list[Path]:
    """Write a fitted profile, its background (``_background.png``) and a report (``_report.json``).

    Parameters
    ----------
    fit : SensorFit
    path : str or Path
        Of the profile, ``.yaml``.
    name, source : str
        Of the new profile: what it is called, where its numbers come from.

    Returns
    -------
    list of Path
        What was written.
    """
    from ruamel.yaml import YAML

    path = Path(path)
    picture, report = (path.with_name(f"{path.stem}_{end}") for end in ("background.png", "report.json"))
    write_png(picture, fit.background)
    profile = replace(
        fit.profile,
        name=name,
        source=source,
        background_image=picture.name,
        background_sha256=file_digest(picture),
    )
    yaml = YAML()
    yaml.default_flow_style = None
    values = json.loads(json.dumps(profile.to_dict()))  # lists for tuples, which YAML does not have
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8") as stream:
        yaml.dump(values, stream)
    write_json(
        report,
        {
            "lights": [asdict(light) for light in fit.lights],
            "imprints": [asdict(imprint) for imprint in fit.imprints],
            "psnr_before": fit.psnr_before,
            "psnr_after": fit.psnr_after,
        },
    )
    return [path, picture, report]
