"""Shear and twist of the gel: an elastic layer under friction, with partial slip."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.camera import gel_depth, pixel_area, ray_directions
from objectfolder.touch.gel import MAX_DENSE_PIXELS, SPACING, Layer, double, halve, layer_of, period
from objectfolder.touch.profiles import SensorProfile

SLIP_TOLERANCE = 0.002  #: of the motion: error of the surface's displacement where it sticks
_MAX_STEPS = 400  # typically tens suffice
MAX_GRID_SIDE = 80  #: pixels; grids with a longer shorter side are halved


@dataclass(frozen=True)
class Shears:
    """What friction does to the gel in N contacts. Vectors are along image right and image up."""

    displacement: np.ndarray  #: (N, H, W, 2) float32, m, of the gel's surface, by pressure and friction
    dragged: np.ndarray  #: (N, H, W, 2) float32, m, the part of it that is by friction
    traction: np.ndarray  #: (N, H, W, 2) float32, Pa, of the object on the gel
    force: np.ndarray  #: (N, 2) float64, N, of the object on the gel
    torque: np.ndarray  #: (N,) float64, N m, about the optical axis, anticlockwise in the image
    slipping: np.ndarray  #: (N,) float64, part of the contact's area that slips; 0 without a contact


def shear_compliance(layer: Layer, wavenumber: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tangential displacement of the surface per unit of a sinusoidal shear traction, m/Pa.

    The first is that of tractions along the wave vector q, rad/m, (1 - ν) / (G q) for short waves; the second
    of those across it, tanh(q h) / (G q). Both are h / G for long ones. Linear elasticity of a layer bonded
    to a rigid base, its surface free of pressure.
    """
    nu, thickness = layer.poisson_ratio, layer.thickness
    shear_modulus = layer.young_modulus / (2 * (1 + nu))
    phase = np.where(wavenumber > 0, wavenumber * thickness, 1.0)
    sinh, below, decay = _hyperbolic(phase, nu)
    along = (1 - nu) / phase * ((3 - 4 * nu) * sinh + 2 * phase * decay) / below
    across = np.tanh(phase) / phase
    scale = thickness / shear_modulus
    return scale * np.where(wavenumber > 0, along, 1), scale * np.where(wavenumber > 0, across, 1)


def spreading(layer: Layer, wavenumber: np.ndarray) -> np.ndarray:
    """Return the amplitude, m/Pa, of the tangential displacement by a sinusoidal pressure.

    Under a pressure cos(q x) the surface moves by this times sin(q x) along x: away from where it is pressed,
    if positive. [(q h)² - (1 - 2 ν) (3 - 4 ν) sinh²(q h)] / (G q D), with D the denominator of
    `Layer.compliance`.
    """
    nu, thickness = layer.poisson_ratio, layer.thickness
    shear_modulus = layer.young_modulus / (2 * (1 + nu))
    phase = np.where(wavenumber > 0, wavenumber * thickness, 1.0)
    _, below, decay = _hyperbolic(phase, nu)
    square = (1 - decay) ** 2 / 4  # sinh² times the decay
    above = phase**2 * decay - (1 - 2 * nu) * (3 - 4 * nu) * square
    return np.where(wavenumber > 0, thickness / shear_modulus / phase * above / below, 0.0)


def shear_contacts(
    pressure: np.ndarray, shear: np.ndarray, twist: np.ndarray, friction: np.ndarray, profile: SensorProfile
) -> Shears:
    """Move a pressed object sideways and turn it, from a press without friction, in one step.

    Where it sticks, the gel's surface follows the object; where it slips, the traction is the friction times
    the pressure. The traction minimises the elastic energy less the work on the object's motion within these
    bounds (Kalker 1990), which is Coulomb's law for a motion in one step. Pressure and contact are those of
    the press: the coupling of shear and pressure, zero on a half space of Poisson's ratio 0.5, is left out
    (Goodman 1962). The press itself moves the surface sideways without friction. Images are halved until
    their shorter side has less than 80 pixels.

    Pressure (N, H, W), Pa, is that of `gel.deform`; shear (N, 2), metres, twist (N,), radians, and friction
    (N,) are those of `shear_touches`. Raises ObjectFolderError if the gel is rigid, or a contact does not
    converge.
    """
    if profile.gel == "rigid":
        raise ObjectFolderError(
            f"the gel of sensor {profile.name!r} is rigid and cannot be sheared; set gel: soft"
        )
    layer, pitch = layer_of(profile), profile.pixel_pitch
    count, height, width = pressure.shape
    place = gel_places(profile)
    displacement = np.zeros((count, height, width, 2), np.float32)
    dragged, traction = np.zeros_like(displacement), np.zeros_like(displacement)
    slipping = np.zeros(count)
    for i, image in enumerate(pressure):
        if not image.any():
            continue
        shapes, step = [], pitch
        while min(image.shape) >= MAX_GRID_SIDE:
            shapes.append(image.shape)
            image, step = halve(image), 2 * step
        right, up = coarse_grid(image.shape, step, (height, width), pitch)
        # The gel is dragged along the tangents of circles; their chords point inwards.
        half = twist[i] / 2
        turned = 2 * np.sin(half) * np.stack(np.broadcast_arrays(-up, right))
        motion = (shear[i, :, None, None] + turned).astype(np.float32)
        found = slide(image, motion, friction[i], step, layer)
        followed = _respond(found, image.shape, step, layer)
        # Where it follows, it arrives on the circle.
        inwards = (np.cos(half) - 1) * turned + np.sin(half) * np.stack([-turned[1], turned[0]])
        share = (followed * motion).sum(0) / np.maximum((motion**2).sum(0), np.float32(1e-20))
        followed = followed + share.clip(0, 1) * inwards.astype(np.float32)
        moved = followed + _spread(image, step, layer)
        bound = friction[i] * image
        slips = (image > 0) & (np.hypot(*found) >= 0.999 * bound) & (np.hypot(*motion).max() > 0)
        slipping[i] = slips.sum() / (image > 0).sum()
        for to, of in ((displacement[i], moved), (dragged[i], followed), (traction[i], found)):
            for axis in (0, 1):
                to[..., axis] = _refined(of[axis], shapes)
        # Interpolated, it stays within the friction of the interpolated pressure: now of the pressure.
        pressed = _refined(image, shapes)
        traction[i] *= (pressure[i] / np.where(pressed > 0, pressed, 1))[..., None]
    area = pixel_area(profile)
    force = np.array([[(of[..., axis] * area).sum() for axis in (0, 1)] for of in traction]).reshape(-1, 2)
    lever = traction[..., 1] * place[0] - traction[..., 0] * place[1]
    torque = np.array([(of * area).sum() for of in lever])
    return Shears(displacement, dragged, traction, force, torque, slipping)


def _refined(image: np.ndarray, shapes: list[tuple[int, ...]]) -> np.ndarray:
    """Double an image that was halved from images of these shapes, largest first."""
    for shape in reversed(shapes):
        image = double(image, shape)
    return image


def slide(
    pressure: np.ndarray, motion: np.ndarray, friction: float, pitch: float, layer: Layer
) -> np.ndarray:
    """Return the traction where a rigid object in frictional contact moves; (2, H, W) float32, Pa.

    Projected gradients with the steps of Barzilai and Borwein (1988). Pressure (H, W), Pa, and the motion (2,
    H, W) of the object's points, right and up in the image, metres, are float32.
    """
    traction = np.zeros_like(motion)
    rows, columns = (np.flatnonzero(pressure.any(axis=axis)) for axis in (1, 0))
    goal = np.abs(motion).max() * SLIP_TOLERANCE
    if not rows.size or goal == 0 or friction == 0:
        return traction
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    bound = np.float32(friction) * pressure[window]
    wanted = motion[:, *window] * (bound > 0)
    found = np.zeros_like(wanted)
    residual = -wanted  # gradient of the energy
    work = float(np.vdot(wanted, _respond(wanted, pressure.shape, pitch, layer) * (bound > 0)))
    step = np.vdot(wanted, wanted) / work
    least = step / 50  # of the stiffest waves
    for _ in range(_MAX_STEPS):
        after = _bounded(found - np.float32(step) * residual, bound)
        changed = after - found
        if max(changed.max(), -changed.min()) <= goal * step:
            traction[:, *window] = found
            return traction
        gradient = (_respond(after, pressure.shape, pitch, layer) - wanted) * (bound > 0)
        curvature = np.vdot(changed, gradient - residual)
        step = max(float(np.vdot(changed, changed) / curvature), least) if curvature > 0 else step
        found, residual = after, gradient
    raise ObjectFolderError(
        f"the sheared contact did not converge in {_MAX_STEPS} steps on a gel of {layer}; "
        "a smaller motion or friction converges faster"
    )


def _bounded(traction: np.ndarray, bound: np.ndarray) -> np.ndarray:
    length = np.sqrt(traction[0] ** 2 + traction[1] ** 2)
    return traction * (bound / np.maximum(length, np.maximum(bound, 1e-12)))


def _respond(traction: np.ndarray, shape: tuple[int, ...], pitch: float, layer: Layer) -> np.ndarray:
    """Return the tangential displacement under a traction, both (2, h, w), in a part of an image (H, W)."""
    if math.prod(shape) <= MAX_DENSE_PIXELS:
        matrix = _part(traction.shape[1:], shape, pitch, layer)
        found: np.ndarray = np.einsum("ij,j->i", matrix, traction.ravel())  # as in `gel.respond`
        return found.reshape(traction.shape)
    return _transformed(traction, shape, pitch, layer)


def _transformed(traction: np.ndarray, shape: tuple[int, ...], pitch: float, layer: Layer) -> np.ndarray:
    """Return the displacement of `_respond`, by Fourier transforms."""
    height, width = traction.shape[1:]
    wholes = period(shape, round(SPACING * layer.thickness / pitch))
    # Between the pixels of a part there are few shifts, for which smaller transforms do.
    fast = (scipy.fft.next_fast_len(2 * part - 1, real=True) for part in traction.shape[1:])
    rows, columns = map(min, wholes, fast)
    right, mixed, up = wave_compliances(rows, columns, wholes, pitch, layer)
    waves = scipy.fft.rfft2(traction, (rows, columns))
    moved = np.empty_like(waves)
    moved[0] = right * waves[0] + mixed * waves[1]
    moved[1] = mixed * waves[0] + up * waves[1]
    return scipy.fft.irfft2(moved, (rows, columns))[:, :height, :width]


def _spread(pressure: np.ndarray, pitch: float, layer: Layer) -> np.ndarray:
    """Return the tangential displacement under a pressure (H, W); (2, H, W)."""
    height, width = pressure.shape
    rows, columns = period((height, width), round(SPACING * layer.thickness / pitch))
    right, up = unit_waves(rows, columns, pitch)
    waves = scipy.fft.rfft2(pressure, (rows, columns)) * wave_spreading(rows, columns, pitch, layer)
    return scipy.fft.irfft2(np.stack([right * waves, up * waves]), (rows, columns))[:, :height, :width]


def _hyperbolic(phase: np.ndarray, nu: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sinh(2 q h) and the common denominator, both times exp(-2 q h), and this factor."""
    decay = np.exp(-2 * phase)
    sinh, cosh = (1 - decay**2) / 2, (1 + decay**2) / 2
    return sinh, (3 - 4 * nu) * cosh + (2 * phase**2 + 5 - 12 * nu + 8 * nu**2) * decay, decay


def _wavenumbers(rows: int, columns: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the wave vectors' components along image right and up, rad/m."""
    along_columns, along_rows = scipy.fft.rfftfreq(columns, pitch), scipy.fft.fftfreq(rows, pitch)
    return 2 * np.pi * along_columns[None], -2 * np.pi * along_rows[:, None]


@lru_cache(maxsize=16)
def _part(window: tuple[int, ...], shape: tuple[int, ...], pitch: float, layer: Layer) -> np.ndarray:
    """Displacement of each pixel of a part (h, w), metres, under 1 Pa on each; (2 h w, 2 h w) float32."""
    height, width = window
    whole = _whole(shape, pitch, layer)[:, :height, :width, :, :height, :width]
    return whole.reshape(2 * height * width, -1)


@lru_cache(maxsize=8)
def _whole(shape: tuple[int, ...], pitch: float, layer: Layer) -> np.ndarray:
    """Displacement of each pixel, metres, under 1 Pa on each; (2, H, W, 2, H, W) float32."""
    count = 2 * math.prod(shape)
    pixels = np.eye(count, dtype=np.float32).reshape(count, 2, *shape)
    found = np.stack([_transformed(pixel, shape, pitch, layer) for pixel in pixels])  # symmetric
    return found.reshape(2, *shape, 2, *shape)


@lru_cache(maxsize=64)
def unit_waves(rows: int, columns: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Return unit wave vectors' components along image right and up."""
    right, up = _wavenumbers(rows, columns, pitch)
    length = np.hypot(right, up)
    unit = np.where(length > 0, length, 1)
    return (right / unit).astype(np.float32), (up / unit).astype(np.float32)


@lru_cache(maxsize=64)
def wave_compliances(
    rows: int, columns: int, wholes: tuple[int, ...], pitch: float, layer: Layer
) -> tuple[np.ndarray, ...]:
    """Return the displacements of waves, right by right, right by up, and up by up; float32, m/Pa.

    Where the rows and columns of the transforms are less than those of the whole image, ``wholes``, the layer
    answers as there to shifts up to half of them.
    """
    vector = _wavenumbers(wholes[0], wholes[1], pitch)
    length = np.hypot(*vector)
    along, across = shear_compliance(layer, length)
    right, up = (part / np.where(length > 0, length, 1) for part in vector)
    more = along - across
    waves = np.stack([across + right**2 * more, right * up * more, across + up**2 * more])
    if (rows, columns) != wholes:
        by_shift = scipy.fft.irfft2(waves, wholes)
        kept = [
            np.arange(whole) if part == whole else np.arange(-((part - 1) // 2), (part + 1) // 2)
            for part, whole in zip((rows, columns), wholes)
        ]
        answers = np.zeros((3, rows, columns))
        answers[:, kept[0][:, None] % rows, kept[1] % columns] = by_shift[:, kept[0][:, None], kept[1]]
        waves = scipy.fft.rfft2(answers).real
    return tuple(waves.astype(np.float32))


@lru_cache(maxsize=32)
def wave_spreading(rows: int, columns: int, pitch: float, layer: Layer) -> np.ndarray:
    """Return `spreading` of the waves of an image; complex64."""
    # The sine wave lags the cosine by a quarter period. A wave of the grid's highest frequency has no sine.
    return (-1j * spreading(layer, np.hypot(*_wavenumbers(rows, columns, pitch)))).astype(np.complex64)


def coarse_grid(
    shape: tuple[int, ...], step: float, image: tuple[int, ...], pitch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances of a halved image's pixels from the centre of the whole, right (1, W), up (H, 1).

    Sizes that do not halve evenly are padded at the right and below; all lengths are in metres.
    """
    middle = [(np.arange(count) + 0.5) * step - side * pitch / 2 for count, side in zip(shape, image)]
    return middle[1][None], -middle[0][:, None]


@lru_cache(maxsize=16)
def gel_places(profile: SensorProfile) -> np.ndarray:
    """Return the pixels' places on the undeformed gel, right and up of the optical axis, m; (2, H, W)."""
    rays, gel = ray_directions(profile), gel_depth(profile)
    return np.stack([-rays[..., 1] * gel, rays[..., 2] * gel])
