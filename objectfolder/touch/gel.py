"""Deformation of the gel: an exact imprint, or an elastic layer on a rigid base."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # scipy.fft loads at first use: views and sounds start without it
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.arrays import Array, array_library, zeros
from objectfolder.touch.profiles import SensorProfile

#: Largest gap between gel and object that heightmaps resolve, as a fraction of the elastomer's thickness;
#: a soft gel bulges into gaps beside a contact.
GAP = 0.15

#: The Fourier transform makes the contact periodic; the copies are this many thicknesses apart.
SPACING = 2.5

#: Tolerated gap under pressure and overlap without pressure, relative to the deepest overlap.
CONTACT_TOLERANCE = 8e-3

_MAX_STEPS = 300  # typically tens suffice
MIN_GRID_SIDE = 40  #: pixels along the shorter side of the coarsest grid

MAX_DENSE_PIXELS = 512  #: pixels of a grid up to which a matrix is faster than transforms

# Least stiffness in the preconditioner, relative to that of the stiffest wave of the grid.
_MIN_STIFFNESS = 0.06

#: First step size and bounds of the others; 1 is optimal for a perfect preconditioner.
FIRST_STEP, STEP_BOUNDS = 0.7, (0.2, 3.0)


@dataclass(frozen=True)
class Layer:
    """Elastic layer bonded to a rigid base."""

    thickness: float  #: m
    young_modulus: float  #: Pa
    poisson_ratio: float

    def compliance(self, wavenumber: np.ndarray) -> np.ndarray:
        """Return the normal displacement of the surface per unit of a sinusoidal pressure, m/Pa.

        Linear elasticity without friction (Nogi and Kato 1997, with a rigid base), for wavenumbers q >= 0,
        rad/m. For waves much shorter than the thickness it is that of a half space, 2 (1 - ν²) / (E q); for
        long ones, that of a laterally confined slab.
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


def layer_of(profile: SensorProfile) -> Layer:
    """Return the layer of a soft gel."""
    return Layer(profile.elastomer_thickness, profile.young_modulus, profile.poisson_ratio)


def deform(
    height: np.ndarray, profile: SensorProfile, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Press a rigid object into the gel: displacement towards the camera, metres, and pressure, Pa.

    A rigid gel takes the exact imprint. A soft one is an elastic layer on a rigid base in unilateral contact
    without friction: pressure >= 0, gap >= 0, and pressure * gap = 0. It is solved by preconditioned
    projected gradients with the steps of Barzilai and Borwein (1988), on grids from coarse to fine, with the
    layer's response by Fourier transforms. Where they touch, the gel follows the object exactly; elsewhere
    its surface is free: it sinks beside the contact and bulges further away, since the gel is nearly
    incompressible.

    Limits: linear elasticity, valid up to strains of about a third; no friction, no adhesion; the layer is
    flat and of even thickness, on a grid of the apex's pixel pitch (a dome's curvature enters through
    ``height`` only); it continues past the image, where only periodic copies of the contact press, 2.5
    thicknesses from the image's border.

    Heights (N, H, W) of the object past the undeformed surface, metres, are negative at a gap; see
    `heightmaps`. The solution is sought from the pressures ``start`` (N, H, W) of similar contacts, or else
    from a coarser grid. Returns (N, H, W) float32; displacements are negative where the gel bulges, pressures
    NaN for a rigid gel. Raises ObjectFolderError if a contact does not converge.
    """
    height = np.asarray(height, np.float32)
    if profile.gel == "rigid":
        return height.clip(0), np.full_like(height, np.nan)
    layer = layer_of(profile)
    displacement, pressure = np.zeros_like(height), np.zeros_like(height)
    for i, image in enumerate(height):  # one at a time: the same bits whatever else is in the batch
        if image.max(initial=0) > 0:
            similar = None if start is None else start[i]
            displacement[i], pressure[i] = indent(image, profile.pixel_pitch, layer, similar)
    return displacement, pressure


def indent(
    height: np.ndarray, pitch: float, layer: Layer, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Solve one contact with an elastic layer; displacement and pressure, (H, W) float32. See `deform`.

    A gap of `GAP` thicknesses in ``height`` (H, W) float32 stands for any wider one, and is never closed;
    ``pitch`` is metres between pixels.
    """
    reachable = within_reach(height, layer.thickness)
    pressure, displacement = _solve(height, reachable, pitch, layer, start)
    # Remove the gaps and overlaps that the tolerance leaves.
    touching = ((pressure > 0) | (displacement < height)) & reachable
    return np.where(touching, height, displacement), pressure


def within_reach(height: Array, thickness: float) -> Array:
    """Return where heights (..., H, W) are within `GAP` of a gel of some thickness, metres; bool."""
    return height > -GAP * thickness * (1 - 1e-6)  # a float32 may be rounded


def _solve(
    height: np.ndarray, reachable: np.ndarray, pitch: float, layer: Layer, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pressure and the displacement under it."""
    if start is not None:
        pressure = start * reachable
        displacement = respond(pressure, pitch, layer)
    elif min(height.shape) >= 2 * MIN_GRID_SIDE:
        pressure, _ = _solve(halve(height), halve(reachable) > 0, 2 * pitch, layer)
        pressure = double(pressure, height.shape) * reachable
        displacement = respond(pressure, pitch, layer)
    else:
        pressure = displacement = np.zeros_like(height)
    tolerance = CONTACT_TOLERANCE * max(height.max(), 0)  # on a coarse grid, small peaks may not touch
    step = FIRST_STEP
    for _ in range(_MAX_STEPS):
        gap = displacement - height
        touching = ((pressure > 0) | (gap < 0)) & reachable
        residual = gap * touching
        if max(residual.max(), -residual.min()) <= tolerance:
            return pressure, displacement
        descent = precondition(residual, pitch, layer) * touching
        before, pressure = pressure, np.maximum(pressure - np.float32(step) * descent, 0)
        changed, moved = pressure - before, displacement
        displacement = respond(pressure, pitch, layer)
        moved = displacement - moved
        # The optimal step if the preconditioner is right up to a factor.
        work = _sum_of_products(changed, moved)
        if work > 0:
            step = float(np.clip(-step * _sum_of_products(changed, residual) / work, *STEP_BOUNDS))
    raise ObjectFolderError(
        f"the contact did not converge in {_MAX_STEPS} steps on a gel of {layer}; "
        "a Poisson ratio farther from 0.5 converges faster"
    )


def respond(pressure: np.ndarray, pitch: float, layer: Layer) -> np.ndarray:
    """Return the displacement of the surface, metres, under a pressure (H, W), Pa; float32 or float64.

    The response is symmetric and positive definite; ``pitch`` is metres between pixels.
    """
    if pressure.size <= MAX_DENSE_PIXELS:
        # Unlike BLAS, einsum sums in an order independent of the number of threads.
        found: np.ndarray = np.einsum("ij,j->i", _matrix(pressure.shape, pitch, layer), pressure.ravel())
        return found.reshape(pressure.shape)
    return _transformed(pressure, pitch, layer)


def _transformed(pressure: np.ndarray, pitch: float, layer: Layer) -> np.ndarray:
    """Return the displacement of `respond`, by Fourier transforms."""
    height, width = pressure.shape
    rows, columns = period(pressure.shape, round(SPACING * layer.thickness / pitch))
    # Axis by axis, to skip transforms of zeros only and of results that are cut off.
    waves = scipy.fft.fft(scipy.fft.rfft(pressure, rows, axis=0), columns, axis=1, overwrite_x=True)
    parts = waves.view(waves.real.dtype)
    parts *= _compliance(rows, columns, pitch, layer)
    waves = scipy.fft.ifft(waves, axis=1, overwrite_x=True)[:, :width]
    return scipy.fft.irfft(waves, rows, axis=0)[:height]


def precondition(residual: Array, pitch: float, layer: Layer) -> Array:
    """Return the approximate pressure (..., H, W), Pa, that causes a displacement (..., H, W), metres.

    Float32, of arrays or tensors; parameters are those of `respond`.
    """
    centre, side, corner = map(float, _stencil(pitch, layer))
    padded = zeros((*residual.shape[:-2], residual.shape[-2] + 2, residual.shape[-1] + 2), residual)
    padded[..., 1:-1, 1:-1] = residual
    columns = padded[..., :-2, :] + padded[..., 2:, :]
    result = columns[..., :-2] + columns[..., 2:]
    result *= corner
    columns = columns[..., 1:-1]
    columns += padded[..., 1:-1, :-2]
    columns += padded[..., 1:-1, 2:]
    columns *= side
    result += columns
    result += centre * residual
    return result


def _sum_of_products(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("ij,ij->", a, b))  # not by BLAS, as in `respond`


@lru_cache(maxsize=32)  # two for each sensor, as below
def period(shape: tuple[int, ...], margin: int) -> tuple[int, ...]:
    """Return the rows and columns of the transforms of an image and a margin."""
    return tuple(scipy.fft.next_fast_len(n + margin, real=True) for n in shape)


@lru_cache(maxsize=8)
def _matrix(shape: tuple[int, ...], pitch: float, layer: Layer) -> np.ndarray:
    """Displacement of each pixel, metres, under a pressure of 1 Pa on each; (H W, H W) float32."""
    count = math.prod(shape)
    pixels = np.eye(count, dtype=np.float32).reshape(count, *shape)
    return np.stack([_transformed(pixel, pitch, layer).ravel() for pixel in pixels])  # symmetric


@lru_cache(maxsize=32)
def _compliance(rows: int, columns: int, pitch: float, layer: Layer) -> np.ndarray:
    """Compliance of the waves of `respond`, repeated for their real and imaginary parts."""
    along_rows, along_columns = scipy.fft.rfftfreq(rows, pitch), scipy.fft.fftfreq(columns, pitch)
    wavenumber = 2 * np.pi * np.hypot(along_rows[:, None], along_columns)
    return layer.compliance(wavenumber).astype(np.float32).repeat(2, axis=1)


@lru_cache(maxsize=32)
def _stencil(pitch: float, layer: Layer) -> tuple[np.float32, np.float32, np.float32]:
    """Return the weights of a pixel, of its edge neighbours and of its corner neighbours, Pa/m.

    Their response equals the layer's for the two shortest waves of the grid, along an axis and diagonal; for
    the longest wave, it is the layer's greatest compliance.
    """
    axis, diagonal = 1 / layer.compliance(np.pi / pitch * np.array([1, np.sqrt(2)]))
    waves = np.geomspace(0.01 / layer.thickness, np.pi / pitch, 200)
    long = max(1 / layer.compliance(waves).max(), _MIN_STIFFNESS * diagonal)
    # Of centre + 2 side (cos x + cos y) + 4 corner cos x cos y, at (0, 0), (π, 0) and (π, π).
    centre = (long + 2 * axis + diagonal) / 4
    return np.float32(centre), np.float32((long - diagonal) / 8), np.float32((centre - axis) / 4)


def halve(image: Array) -> Array:
    """Means of 2 x 2 pixels of images (..., H, W), arrays or tensors."""
    height, width = image.shape[-2:]
    even = image.float() if isinstance(image, torch.Tensor) else image.astype(np.float32)
    join = array_library(even).concatenate
    if height % 2:
        even = join([even, even[..., -1:, :]], axis=-2)
    if width % 2:
        even = join([even, even[..., -1:]], axis=-1)
    rows = even[..., ::2, :] + even[..., 1::2, :]
    return (rows[..., ::2] + rows[..., 1::2]) / 4


def double(image: Array, shape: tuple[int, ...]) -> Array:
    """Interpolate images (..., H, W), arrays or tensors, between the centres of 2 x 2 pixels."""
    for _ in range(2):
        *many, height, width = image.shape
        fine = zeros((*many, 2 * height, width), image)
        fine[..., ::2, :] = fine[..., 1::2, :] = 0.75 * image
        quarter = 0.25 * image
        fine[..., 2::2, :] += quarter[..., :-1, :]
        fine[..., 0, :] += quarter[..., 0, :]
        fine[..., 1:-1:2, :] += quarter[..., 1:, :]
        fine[..., -1, :] += quarter[..., -1, :]
        image = fine.swapaxes(-1, -2)
    return image[..., : shape[0], : shape[1]]
