"""What a fitted light model leaves over: a polynomial in the gel's tilt and the place in the image."""

import numpy as np

from objectfolder.touch.arrays import Array, array_library, zeros
from objectfolder.touch.camera import ray_directions
from objectfolder.touch.profiles import SensorProfile

DEGREE = 3  #: of the polynomial in the tilt; it is linear in the place

#: Powers of the tilt along y and z in the terms; each is multiplied by 1, y and z of the place.
POWERS = [(total - b, b) for total in range(1, DEGREE + 1) for b in range(total + 1)]


def places(profile: SensorProfile) -> np.ndarray:
    """Return the places of the pixels, left and up, -1 to 1 along the image's longer side; (2, H, W)."""
    rays = ray_directions(profile)
    return np.moveaxis(rays[..., 1:], -1, 0) / max(profile.half_extent)


def tilt(slopes: Array, gel: Array) -> Array:
    """Return the sine of the deformed gel's slope against the undeformed one, along y and z.

    Slopes (2, N, H, W) are derivatives of the displacement by the tangents of the rays, metres, gel (H, W)
    the depth of the undeformed gel, metres; float32 arrays or tensors.
    """
    gradient = slopes / gel
    return gradient / array_library(gradient).sqrt((gradient * gradient).sum(0) + 1)


def residual_terms(leaning: Array, place: Array) -> list[Array]:
    """Return the `RESIDUAL_TERMS` terms of the polynomial, each (...); all are 0 where the gel is not tilted.

    Of `tilt` (2, ...) and `places` (2, ...).
    """
    tilted = [leaning[0] ** a * leaning[1] ** b for a, b in POWERS]
    return [term * factor for term in tilted for factor in (1.0, place[0], place[1])]


def residual_levels(leaning: Array, place: Array, coefficients: tuple[tuple[float, ...], ...]) -> Array:
    """Return the residual in grey levels, (3, ...), by the coefficients of red, green and blue."""
    levels = zeros((3, *leaning.shape[1:]), leaning)
    for term, of_term in zip(residual_terms(leaning, place), zip(*coefficients)):
        for channel, coefficient in enumerate(of_term):
            levels[channel] += term * coefficient
    return levels
