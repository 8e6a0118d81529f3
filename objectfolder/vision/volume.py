"""Volume rendering: rays through a cube, samples along them, and their weights by density.

The integral of Max (1995) with the quadrature of Mildenhall et al. (2020): density is constant over the
interval of a sample. Intervals end midway between samples and together fill the ray's segment in the cube.
"""

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Rays:
    """Rays with the segment of each that may hold density; tensors share their first dimension N."""

    origins: torch.Tensor  #: (N, 3)
    directions: torch.Tensor  #: (N, 3), of unit length
    near: torch.Tensor  #: (N,) distance from the origin
    far: torch.Tensor  #: (N,)

    @classmethod
    def through_cube(cls, origins: torch.Tensor, directions: torch.Tensor, half: float) -> "Rays":
        """Return rays clipped to the cube [-half, half]^3; ``far`` <= ``near`` where a ray misses it."""
        # Avoid 0 / 0 along a face; such a slope is parallel for all purposes.
        slope = torch.where(directions.abs() < 1e-9, 1e-9, directions)
        first, second = (-half - origins) / slope, (half - origins) / slope
        near = torch.minimum(first, second).amax(1).clamp(min=0)  # a camera may be inside
        return cls(origins, directions, near, torch.maximum(first, second).amin(1))

    def __getitem__(self, index: torch.Tensor | slice) -> "Rays":
        """Return some of the rays."""
        return Rays(self.origins[index], self.directions[index], self.near[index], self.far[index])

    def points(self, distance: torch.Tensor) -> torch.Tensor:
        """Return the points at (N, S) distances; (N, S, 3)."""
        return self.origins[:, None] + distance[..., None] * self.directions[:, None]

    def intervals(self, distance: torch.Tensor) -> torch.Tensor:
        """Return the ends of the intervals of samples at (N, S) ascending distances; (N, S + 1)."""
        middle = (distance[:, 1:] + distance[:, :-1]) / 2
        return torch.cat([self.near[:, None], middle, self.far[:, None]], 1)


def sample_strata(
    low: torch.Tensor, high: torch.Tensor, count: int, generator: torch.Generator | None = None
) -> torch.Tensor:
    """Return a sample in each of ``count`` equal parts of intervals, low to high (N,); ascending (N, count).

    A generator, on the CPU, draws each sample uniformly within its part; without one, samples are the
    midpoints.
    """
    shape = len(low), count
    place = torch.full(shape, 0.5) if generator is None else torch.rand(*shape, generator=generator)
    fraction = (torch.arange(count, device=low.device) + place.to(low)) / count
    return low[:, None] + fraction * (high - low)[:, None]


def opacity(density: torch.Tensor, lengths: torch.Tensor) -> torch.Tensor:
    """Return the fraction of light that intervals absorb, 1 - exp(-density length); any shape."""
    return -torch.expm1(-density * lengths)


def transmittance(density: torch.Tensor, lengths: torch.Tensor) -> torch.Tensor:
    """Return the fraction of light that reaches the start of every interval, and the end of the last one.

    T_i = exp(-sum over j < i of density_j length_j); (N, S) -> (N, S + 1).
    """
    depth = (density * lengths).cumsum(1)
    return torch.exp(-torch.cat([torch.zeros_like(depth[:, :1]), depth], 1))


def visibility(density: torch.Tensor, lengths: torch.Tensor) -> torch.Tensor:
    """Return the weight of every sample in its pixel, T_i (1 - exp(-density_i length_i)); (N, S).

    They sum to the pixel's alpha, one minus the transmittance of the ray.
    """
    return transmittance(density, lengths)[:, :-1] * opacity(density, lengths)


def resample(
    intervals: torch.Tensor,
    weights: torch.Tensor,
    count: int,
    generator: torch.Generator | None = None,
    floor: float = 1e-5,
) -> torch.Tensor:
    """Draw samples by weights (N, S), with the inverse of their cumulative distribution; sorted (N, count).

    The density of samples is constant within each of the intervals, whose ends are (N, S + 1). Samples are
    stratified by a generator, or else the midpoints of equal parts of the weight. The floor is added to every
    weight, so that rows of zeros give uniform samples.
    """
    share = weights + floor
    cumulative = torch.cat([torch.zeros_like(share[:, :1]), share.cumsum(1)], 1)
    cumulative = cumulative / cumulative[:, -1:]
    start = torch.zeros_like(cumulative[:, 0])
    target = sample_strata(start, start + 1, count, generator)
    found = torch.searchsorted(cumulative, target, right=True).clamp(1, weights.shape[1])
    (c0, c1), (t0, t1) = (
        (ends.gather(1, found - 1), ends.gather(1, found)) for ends in (cumulative, intervals)
    )
    return t0 + (t1 - t0) * ((target - c0) / (c1 - c0).clamp(min=1e-12)).clamp(0, 1)
