"""Photometric inverse of a sensor: the shape of its gel from its images."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch.nn.functional import adaptive_avg_pool2d

from objectfolder.base.seeding import numpy_generator
from objectfolder.touch.ball import BallModel
from objectfolder.touch.profiles import SensorProfile

BALLS = 100  #: presses that an inverse is fitted to; as many others give its error
RADII = (0.001, 0.03)  #: of these balls, log-uniform, m
DEGREE = 3  #: of the polynomials, in colours and place
_COLOR = 1 / 32  # unit of changes in colour: a pixel's is seldom more than a few
_RIDGE = 1e-6  # of the least squares, relative to the mean square of a term
_TERMS = [
    term
    for degree in range(1, DEGREE + 1)
    for term in combinations_with_replacement(range(5), degree)
    if min(term) < 3  # without colour there is no slope: the gel rests
]


@dataclass(frozen=True)
class PhotometricInverse:
    """Displacement of a sensor's gel from its images, averaged to a size (h, w).

    The gel's slopes are polynomials of a pixel's change in colour and of its place. They are fitted to
    simulated presses of balls, as real sensors are calibrated (Yuan, Dong and Adelson 2017, section 3.3).
    """

    background: torch.Tensor  #: (3, h, w) float32, grey levels of the sensor while nothing touches it
    coefficients: torch.Tensor  #: (terms, 2) float32: mm per pixel along columns and rows
    error: float  #: of slopes under other balls, root mean square over that of the slopes

    @classmethod
    def fitted(
        cls, profile: SensorProfile, background: np.ndarray, size: tuple[int, int]
    ) -> "PhotometricInverse":
        """Fit the inverse of a sensor with a background (H, W, 3) uint8, for images averaged to a size."""
        still = _averaged(torch.from_numpy(background).movedim(-1, 0), size)
        return cls(still, *_fit(profile, size))

    def displacement(self, images: np.ndarray) -> torch.Tensor:
        """Return the gel's displacement, up to a constant, from images (B, H, W, 3) uint8; (B, h, w), mm."""
        height, width = self.background.shape[1:]
        small = _averaged(torch.from_numpy(images).movedim(-1, 1), (height, width))
        slopes = _terms(small - self.background) @ self.coefficients
        return integrated(slopes.reshape(-1, height, width, 2).movedim(-1, 0))


@lru_cache(maxsize=1)  # jobs on parts of a split ask again
def _fit(profile: SensorProfile, size: tuple[int, int]) -> tuple[torch.Tensor, float]:
    """Return coefficients and error of an inverse."""
    terms, slopes = _calibration(profile, size, "fit")
    ridge = _RIDGE * np.diag((terms**2).sum(0))
    coefficients = np.linalg.solve(terms.T @ terms + ridge, terms.T @ slopes)
    others, truth = _calibration(profile, size, "error")
    error = np.sqrt(np.mean((others @ coefficients - truth) ** 2) / np.mean(truth**2))
    return torch.from_numpy(coefficients).float(), float(error)


def _averaged(images: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    return adaptive_avg_pool2d(images.float(), size)


def _terms(change: torch.Tensor) -> torch.Tensor:
    """Return the monomials of each pixel's change in grey levels (B, 3, h, w) and place; (B h w, terms)."""
    height, width = change.shape[2:]
    down, across = (torch.linspace(-1, 1, pixels) for pixels in (height, width))
    place = torch.stack(torch.meshgrid(down, across, indexing="ij"))
    values = [*(_COLOR * change).unbind(1), *place.unbind(0)]
    columns = []
    for term in _TERMS:
        product = values[term[0]]
        for each in term[1:]:
            product = product * values[each]
        columns.append(product)
    return torch.stack(torch.broadcast_tensors(*columns), -1).flatten(0, 2)


def _calibration(
    profile: SensorProfile, size: tuple[int, int], purpose: str
) -> tuple[np.ndarray, np.ndarray]:
    """Press balls on a sensor; return the terms (N, terms) and slopes (N, 2), mm per pixel, of all pixels."""
    rng = numpy_generator(0, "inverse", purpose)
    deepest = 0.9 * profile.max_indentation
    least = np.array([0, 0, 0.1 * deepest])
    most = np.array([profile.height, profile.width, deepest])
    changes, displacements = [], []
    smallest, largest = np.log(RADII)
    for radius in np.exp(rng.uniform(smallest, largest, BALLS)):
        ball = BallModel(profile, float(radius))
        moved = ball.displacement(rng.uniform(least, most))
        changes.append(_averaged(ball.optics.change(moved), size))
        displacements.append(1e3 * _averaged(moved, size))
    slopes = torch.stack(torch.gradient(torch.cat(displacements), dim=(2, 1)), -1)
    return _terms(torch.cat(changes)).double().numpy(), slopes.reshape(-1, 2).double().numpy()


def integrated(slopes: torch.Tensor) -> torch.Tensor:
    """Return the surfaces (B, h, w) of mean 0 whose differences are nearest to slopes (2, B, h, w).

    The slopes are per pixel, along columns and rows; between two pixels their mean counts. The least squares
    are Poisson's equation without flow over the border, which the discrete cosine transform solves.
    """
    along, down = slopes.numpy()
    height, width = along.shape[1:]
    divergence = np.zeros_like(along)
    for part, slope in ((divergence, along), (divergence.swapaxes(1, 2), down.swapaxes(1, 2))):
        steps = (slope[..., 1:] + slope[..., :-1]) / 2
        part[..., :-1] += steps
        part[..., 1:] -= steps
    squares = [2 - 2 * np.cos(np.pi * np.arange(pixels) / pixels) for pixels in (height, width)]
    laplacian = -np.add.outer(*squares).astype(divergence.dtype)
    laplacian[0, 0] = np.inf  # the mean is free
    waves = dctn(divergence, axes=(1, 2), norm="ortho") / laplacian
    return torch.from_numpy(idctn(waves, axes=(1, 2), norm="ortho"))
