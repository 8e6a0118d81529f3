"""Sound fields as sums of spherical harmonics: what a surface sends out, and what a listener receives.

Harmonics are real and orthonormal, in order l^2 + l + m. A field with coefficients c is

    p(r d) = exp(i k r) / r sum_lm c_lm g_l(k r) Y_lm(d),    g_l(z) = i^(l + 1) z h_l(z) exp(-i z)

with the spherical Hankel functions h of outgoing waves; g is 1 far away.
"""

from functools import lru_cache

import numpy as np

from objectfolder.sound.radiation.triangles import Triangles

_SPACING = 0.05  # half the distance of the two poles of a dipole, edge lengths
_EXTRA_ORDERS = 20  # orders beyond the largest argument at which the recurrence of Bessel functions starts


def real_harmonics(directions: np.ndarray, order: int) -> np.ndarray:
    """Return real spherical harmonics up to an order; (N, 3) unit vectors -> (N, (order + 1)^2)."""
    from scipy.special import sph_harm_y_all  # loading it takes a fifth of a second

    x, y, z = np.asarray(directions, np.float64).T
    complex_ones = sph_harm_y_all(order, order, np.arccos(z.clip(-1, 1)), np.arctan2(y, x))
    of_degree, m, factor = _real_parts(order)
    found = complex_ones[of_degree, abs(m)]
    return (np.where(m[:, None] < 0, found.imag, found.real) * factor[:, None]).T


@lru_cache
def _real_parts(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return l and m of each real harmonic, and its factor on the part of the complex one that it is."""
    of_degree, m = degrees(order), np.arange((order + 1) ** 2)
    m -= of_degree * (of_degree + 1)
    return of_degree, m, np.where(m == 0, 1.0, np.sqrt(2) * (-1.0) ** abs(m))


def degrees(order: int) -> np.ndarray:
    """Return l of each harmonic up to an order; ((order + 1)^2,)."""
    each = np.arange(order + 1)
    return np.repeat(each, 2 * each + 1)


def spherical_bessel(order: int, x: np.ndarray) -> np.ndarray:
    """Return j_0 to j_order of (N,) positive numbers; (order + 1, N).

    Upward products of ratios from a continued fraction, which is stable where upward recurrence is not.
    """
    start = max(order, int(x.max(initial=0))) + _EXTRA_ORDERS
    ratio, ratios = np.zeros_like(x), np.empty((order + 1, len(x)))
    for degree in range(start, 0, -1):
        ratio = 1 / ((2 * degree + 1) / x - ratio)
        if degree <= order:
            ratios[degree] = ratio
    out = np.empty_like(ratios)
    out[0] = np.sin(x) / x
    for degree in range(1, order + 1):
        out[degree] = out[degree - 1] * ratios[degree]
    return out


def outgoing(order: int, z: np.ndarray) -> np.ndarray:
    """Return g_0 to g_order of the module's notes at positive numbers of any shape; (order + 1, ...)."""
    out = np.ones((order + 1, *np.shape(z)), np.complex128)
    factors = np.multiply.outer(1j * (2 * np.arange(order) + 1), 1 / z)
    if order:
        out[1] += factors[0]
    for degree in range(1, order):
        np.multiply(factors[degree], out[degree], out=out[degree + 1])
        out[degree + 1] += out[degree - 1]
    return out


class Radiator:
    """Map from the field on a surface to the harmonics, up to an order, of the sound that it sends out."""

    def __init__(self, triangles: Triangles, order: int):
        self.order = order
        step = _SPACING * np.sqrt(triangles.area)[:, None] * triangles.normal
        places = np.concatenate([triangles.centroid + step, triangles.centroid - step])
        self._radius = np.linalg.norm(places, axis=1)
        self._harmonics = real_harmonics(places / self._radius[:, None], order)
        self._area, self._step = triangles.area[:, None], np.linalg.norm(step, axis=1)[:, None]

    def coefficients(self, wavenumber: float, pressure: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return coefficients (M, (order + 1)^2) of fields of pressure and slope (N, M) on the triangles.

        The integral of Kirchhoff and Helmholtz in the far field, expanded by the theorem of Gegenbauer. The
        derivative along the normal is the difference of two poles.
        """
        dipole, pole = pressure / (2 * self._step), slopes / 2
        sources = np.concatenate([self._area * (dipole - pole), self._area * (-dipole - pole)]).T
        bessel = spherical_bessel(self.order, wavenumber * self._radius)
        out = np.empty((len(sources), (self.order + 1) ** 2), np.complex128)
        for degree in range(self.order + 1):
            part = slice(degree**2, (degree + 1) ** 2)
            weighted = sources * bessel[degree]
            shapes = self._harmonics[:, part]
            out[:, part] = (-1j) ** degree * (weighted.real @ shapes + 1j * (weighted.imag @ shapes))
        return out
