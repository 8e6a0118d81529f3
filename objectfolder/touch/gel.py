"""How the gel gives way: exactly, or as an elastic layer on a rigid base."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.fft

from objectfolder.errors import ObjectFolderError
from objectfolder.touch.profiles import SensorProfile

# The Fourier transform repeats the contact; the copies are this many thicknesses apart.
_SPACING = 2.5

# Gap that may be left where there is pressure, and overlap where there is none, of the deepest overlap.
_TOLERANCE = 1e-2

_MAX_STEPS = 300  # tens are usual
_COARSEST = 40  # pixels along the shorter side

# Of the preconditioner: waves as compliant as this, relative to the most compliant, are treated alike.
_STIFFEST = 0.1


@dataclass(frozen=True)
class Layer:
    """Elastic layer, bonded to a rigid base."""

    thickness: float  #: m
    young_modulus: float  #: Pa
    poisson_ratio: float

    def compliance(self, wavenumber: np.ndarray) -> np.ndarray:
        """Normal displacement of the surface per unit of a sinusoidal pressure, m/Pa.

        Linear elasticity without friction (Nogi and Kato 1997, with a rigid base). Waves much shorter than
        the thickness see a half space, 2 (1 - ν²) / (E q); long ones a slab that cannot give way sideways.

        Parameters
        ----------
        wavenumber : array
            q, rad/m, zero or positive.
        """
        nu, thickness = self.poisson_ratio, self.thickness
        phase = np.where(wavenumber > 0, wavenumber * thickness, 1.0)
        decay = np.exp(-2 * phase)  # sinh and cosh would overflow
        sinh, cosh = (1 - decay**2) / 2, (1 + decay**2) / 2
        above = (3 - 4 * nu) * sinh - 2 * phase * decay
        below = (3 - 4 * nu) * cosh + (2 * phase**2 + 5 - 12 * nu + 8 * nu**2) * decay
        waves = 2 * (1 - nu**2) / self.young_modulus * thickness / phase * above / below
        confined = (1 + nu) * (1 - 2 * nu) / (1 - nu) / self.young_modulus * thickness
        return np.where(wavenumber > 0, waves, confined)


def deform(height: np.ndarray, profile: SensorProfile) -> tuple[np.ndarray, np.ndarray]:
    """Press a rigid object into the gel.

    A rigid gel takes the exact imprint. A soft one is an elastic layer on a rigid base in unilateral contact
    without friction: pressure >= 0, gap >= 0, and no pressure where there is a gap. Found by conjugate
    gradients with Fourier transforms (Polonsky and Keer 1999), with a preconditioner and from coarse grids to
    the finest. The object is met exactly where it presses; elsewhere the surface is free: drawn in beside
    the contact, bulging further off, since the gel hardly changes its volume.

    Limits: linear elasticity, which strains beyond about a third exceed; no friction, no adhesion; the layer
    is flat, evenly thick, on a grid of the apex's pixel pitch (a dome's curvature counts in ``height``
    only); it goes on past the image, where nothing presses but copies of the contact, 2.5 thicknesses
    off the image's border.

    Parameters
    ----------
    height : (N, H, W) array
        How far the object is past the undeformed surface, metres; negative is a gap. See `heightmaps`.
    profile : SensorProfile

    Returns
    -------
    displacement : (N, H, W) float32
        Of the surface towards the camera, metres; negative where it bulges.
    pressure : (N, H, W) float32
        Pa. NaN for a rigid gel, which has none.

    Raises
    ------
    ObjectFolderError
        If a contact does not converge.
    """
    height = np.asarray(height, np.float32)
    if profile.gel == "rigid":
        return height.clip(0), np.full_like(height, np.nan)
    layer = Layer(profile.elastomer_thickness, profile.young_modulus, profile.poisson_ratio)
    displacement, pressure = np.zeros_like(height), np.zeros_like(height)
    for i, image in enumerate(height):  # one at a time: the same bits whatever else is in the batch
        if image.max(initial=0) > 0:
            displacement[i], pressure[i] = indent(image, profile.pixel_pitch, layer)
    return displacement, pressure


def indent(height: np.ndarray, pitch: float, layer: Layer) -> tuple[np.ndarray, np.ndarray]:
    """One contact with an elastic layer; as `deform`.

    Parameters
    ----------
    height : (H, W) float32 array, metres
        Pixels of the lowest value are out of reach: they never touch, however far the layer bulges.
    pitch : float
        Metres between pixels.
    layer : Layer

    Returns
    -------
    displacement : (H, W) float32, metres
    pressure : (H, W) float32, Pa
    """
    reachable = height > min(height.min(), 0)
    pressure, gap = _solve(height, reachable, pitch, layer)
    # What the tolerance leaves in contact, is taken out.
    gap[reachable & ((pressure > 0) | (gap < 0))] = 0
    return height + gap, pressure


def _solve(
    height: np.ndarray, reachable: np.ndarray, pitch: float, layer: Layer
) -> tuple[np.ndarray, np.ndarray]:
    """Pressure and gap."""
    if min(height.shape) >= 2 * _COARSEST:
        pressure, _ = _solve(_halve(height), _halve(reachable) > 0, 2 * pitch, layer)
        pressure = _double(pressure, height.shape) * reachable
    else:
        pressure = np.zeros_like(height)
    tolerance = _TOLERANCE * height.max()
    gap = _respond(pressure, pitch, layer) - height
    direction, old = np.zeros_like(height), np.inf
    touching = np.zeros(height.shape, bool)
    for _ in range(_MAX_STEPS):
        touching, before = ((pressure > 0) | (gap < 0)) & reachable, touching
        residual = gap * touching
        if max(residual.max(), -residual.min()) <= tolerance:
            return pressure, gap
        descent = _precondition(residual, pitch, layer) * touching
        square = float(np.vdot(residual, descent))
        grown = (touching & ~before).any()  # Polonsky and Keer start anew then
        direction = descent if grown else descent + np.float32(square / old) * direction * touching
        old = square
        response = _respond(direction, pitch, layer)
        step = np.float32(np.vdot(residual, direction) / np.vdot(response, direction))
        pressure = pressure - step * direction
        if pressure.min() < 0:
            pressure = np.maximum(pressure, 0)
            gap = _respond(pressure, pitch, layer) - height
        else:
            gap = gap - step * response
    raise ObjectFolderError(
        f"the contact did not converge in {_MAX_STEPS} steps on a gel of {layer}; "
        "a Poisson ratio farther from 0.5 converges faster"
    )


def _respond(pressure: np.ndarray, pitch: float, layer: Layer) -> np.ndarray:
    """Displacement under a pressure."""
    height, width = pressure.shape
    margin = round(_SPACING * layer.thickness / pitch)
    rows, columns = (scipy.fft.next_fast_len(n + margin, real=True) for n in pressure.shape)
    spectrum = scipy.fft.rfft2(pressure, (rows, columns))
    spectrum *= _compliance(rows, columns, pitch, layer)
    return scipy.fft.irfft2(spectrum, (rows, columns), overwrite_x=True)[:height, :width]


def _precondition(residual: np.ndarray, pitch: float, layer: Layer) -> np.ndarray:
    """Roughly the pressure that makes a displacement."""
    spectrum = scipy.fft.rfft2(residual)
    spectrum /= _stiffened(*residual.shape, pitch, layer)
    return scipy.fft.irfft2(spectrum, residual.shape, overwrite_x=True)


@cache
def _compliance(rows: int, columns: int, pitch: float, layer: Layer) -> np.ndarray:
    """Of the waves of `scipy.fft.rfft2`; (rows, columns // 2 + 1) float32."""
    along_rows, along_columns = scipy.fft.fftfreq(rows, pitch), scipy.fft.rfftfreq(columns, pitch)
    return layer.compliance(2 * np.pi * np.hypot(along_rows[:, None], along_columns)).astype(np.float32)


@cache
def _stiffened(rows: int, columns: int, pitch: float, layer: Layer) -> np.ndarray:
    compliance = _compliance(rows, columns, pitch, layer)
    return np.maximum(compliance, _STIFFEST * compliance.max())


def _halve(image: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels."""
    height, width = image.shape
    even = np.pad(image, ((0, height % 2), (0, width % 2)), mode="edge").astype(np.float32)
    return (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4


def _double(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Interpolate between the centres of 2 x 2 pixels."""
    for _ in range(2):
        padded = np.pad(image, ((1, 1), (0, 0)), mode="edge")
        fine = np.stack([image * 3 + padded[:-2], image * 3 + padded[2:]], axis=1) / 4
        image = fine.reshape(-1, image.shape[1]).T
    return image[: shape[0], : shape[1]]
