"""Occupancy of grid cells by a solid, measured along columns with exact surface crossings.

The columns form a quadrature rule for the Legendre moments of the occupancy, and their overlaps show which
material is connected: a cell may hold several parts, such as two walls with a narrow gap between them.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre

from objectfolder.mesh.scanline import crossings
from objectfolder.mesh.topology import components

DEGREE = 5  # Legendre polynomials per axis; products of two shape functions have degree 4
MARGIN = 1e-4  # by which the grid is larger than the object
_ORDERS = 300  # tried permutations of the columns' shifts
_CHUNK = 1 << 17  # crossings processed at once


@dataclass(frozen=True)
class Occupancy:
    """Solid as parts: connected pieces of material, each inside one cell of a grid."""

    cell: np.ndarray  #: (P, 3) int64, position in the grid
    moments: np.ndarray  #: (P, 5, 5, 5), Legendre moments in x, y, z over [-1, 1]^3
    links: np.ndarray  #: (L, 2) pairs of parts in neighbouring cells with continuous material, each once
    samples: np.ndarray  #: (S, 3) positions, in cells, throughout the material of cells with several parts
    sample_part: np.ndarray  #: (S,) part of each sample

    @property
    def fill(self) -> np.ndarray:
        """(P,) fraction of the cell that each part fills."""
        return self.moments[:, 0, 0, 0] / 8


def measure(vertices: np.ndarray, faces: np.ndarray, resolution: int, subdivisions: int) -> Occupancy:
    """Measure the material of a closed surface, (V, 3) in the unit frame and (F, 3), in the cells of a grid.

    Columns run along the axis that most of the surface faces, because walls parallel to them are quantised.
    Material is continuous along a column, and between neighbouring columns (diagonals included) where their
    intervals inside the solid overlap. Gaps narrower than a column (half a sub-cell) are not resolved.
    Resolution and subdivisions are those of `objectfolder.sound.fem.cutcell.cut_cells`.
    """
    turn = 2 - facing_axis(vertices, faces)  # cyclic, so that the surface stays oriented
    found = _measure_along_z(np.roll(vertices, turn, axis=1), faces, resolution, subdivisions)
    return replace(
        found,
        cell=np.roll(found.cell, -turn, axis=1),
        moments=found.moments.transpose(0, *(1 + np.roll(range(3), -turn))),
        samples=np.roll(found.samples, -turn, axis=1),
    )


def facing_axis(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Return the axis along which the surface has the largest projected area; z on ties."""
    a, b = np.diff(vertices[faces], axis=1).swapaxes(0, 1)
    area = np.abs(np.cross(a, b)).sum(0)
    return 2 if area[2] > (1 - 1e-6) * area.max() else int(area.argmax())


def _measure_along_z(
    vertices: np.ndarray, faces: np.ndarray, resolution: int, subdivisions: int
) -> Occupancy:
    across = 2 * subdivisions  # columns along each side of a cell
    count, side = resolution * across, 1 + MARGIN
    place, _ = _columns(across)
    shift = np.tile(across * place[0] - 0.5, resolution)
    origin = -side / 2 + np.array([0.5, 0.5, 0]) * side / count
    found = _borders(*crossings(vertices, faces, count, origin, side / count, np.stack([shift, shift])))
    intervals = _Intervals.between(found, resolution, across).outer()
    cells = _distinct(intervals.cell)
    whole = _column_moments(found, resolution, across, cells)
    first, second = intervals.touching()
    same = intervals.cell[first] == intervals.cell[second]
    first, second, inner = first[~same], second[~same], (first[same], second[same])
    parts, part = components(*inner, len(intervals.cell))
    links = _pairs(part[first], part[second], parts)
    parts, merged = components(*intervals.join_specks(part, *links.T), parts)
    ends = merged[links]
    part, links = merged[part], _pairs(ends[:, 0], ends[:, 1], parts)
    cell = np.zeros(parts, np.int64)
    cell[part] = intervals.cell
    several = np.bincount(cell, minlength=resolution**3)[cell] > 1
    moments = whole.reshape(-1, *(DEGREE,) * 3)[np.searchsorted(cells, cell)]
    inside = intervals.select(several[part])
    moments[several] = inside.moments(part[several[part]], parts)[several]
    samples, owner = inside.samples()
    return Occupancy(
        cell=np.stack(np.unravel_index(cell, (resolution,) * 3), 1),
        moments=moments,
        links=links,
        samples=samples,
        sample_part=part[several[part]][owner],
    )


def _borders(column: np.ndarray, height: np.ndarray, sign: np.ndarray) -> tuple[np.ndarray, ...]:
    """Keep the crossings (N,), in their order, at which a column enters or leaves winding numbers above 0.

    Pieces that overlap count once, and material that is inside out, whose mass would be negative, does not.
    """
    order = np.lexsort((-sign, height, column))  # merges touching intervals
    winding = np.cumsum(sign[order])
    kept = np.sort(order[(winding > 0) != (winding > sign[order])])
    return column[kept], height[kept], sign[kept]


def _pairs(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Return the distinct unordered pairs of indices below ``count``; (L, 2)."""
    flat = np.minimum(first, second) * np.int64(count) + np.maximum(first, second)
    return np.stack(np.divmod(_distinct(flat), count), 1)


def _distinct(values: np.ndarray) -> np.ndarray:
    """Return the distinct integers (N,), ascending: `numpy.unique`, which hashes, takes twice as long.

    Most repetitions follow each other, and go before the rest is sorted.
    """
    for step in (np.sort, np.asarray):
        first = np.ones(len(values), bool)
        np.not_equal(values[1:], values[:-1], out=first[1:])
        values = step(values[first])
    return values


@dataclass(frozen=True)
class _Intervals:
    """Intervals of the columns inside the solid, cut at cell borders, sorted by column and height."""

    column: np.ndarray  #: (I,) int64
    lower: np.ndarray  #: (I,) z in cells
    upper: np.ndarray  #: (I,)
    resolution: int
    across: int

    @classmethod
    def between(cls, found: tuple[np.ndarray, ...], resolution: int, across: int) -> "_Intervals":
        """Build the intervals inside the solid from its `_borders`."""
        column, height, sign = found
        order = np.lexsort((-sign, height, column))
        column, (lower, upper) = column[order[::2]], (height[order] / across).reshape(-1, 2).T
        lower, upper = lower.clip(0, resolution), upper.clip(0, resolution)
        bottom = np.minimum(lower.astype(np.int64), resolution - 1)
        pieces = np.maximum(np.ceil(upper).astype(np.int64) - bottom, 1)
        run = np.repeat(np.arange(len(column)), pieces)
        k = bottom[run] + np.arange(len(run)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        return cls(column[run], np.maximum(lower[run], k), np.minimum(upper[run], k + 1), resolution, across)

    def select(self, keep: np.ndarray) -> "_Intervals":
        """Return the intervals in a mask."""
        return replace(self, column=self.column[keep], lower=self.lower[keep], upper=self.upper[keep])

    def outer(self) -> "_Intervals":
        """Drop the inner columns of full cells, which carry no connectivity."""
        _, _, _, a, b = self.indices
        cell, length = self.cell, self.upper - self.lower
        full = np.bincount(cell, weights=length, minlength=self.resolution**3) > self.across**2 - 1e-6
        inner = (np.minimum(a, b) > 0) & (np.maximum(a, b) < self.across - 1)
        return self.select(~(full[cell] & inner))

    @cached_property
    def indices(self) -> tuple[np.ndarray, ...]:
        """Cells i, j, k of the intervals and columns a, b inside them; (I,) each."""
        column = np.divmod(self.column, self.resolution * self.across)
        (i, a), (j, b) = (np.divmod(part, self.across) for part in column)
        k = np.minimum(((self.lower + self.upper) / 2).astype(np.int64), self.resolution - 1)
        return i, j, k, a, b

    @cached_property
    def cell(self) -> np.ndarray:
        """(I,) flat index of the cell of each interval."""
        i, j, k, _, _ = self.indices
        return (i * self.resolution + j) * self.resolution + k

    def touching(self) -> tuple[np.ndarray, np.ndarray]:
        """Find pairs of overlapping intervals, in the same column and in neighbouring ones."""
        count, gap = self.resolution * self.across, 1 / self.across
        high = 2.0 * self.resolution  # offset that keeps the z ranges of columns apart
        starts, ends = self.column * high + self.lower, self.column * high + self.upper
        i, j = np.divmod(self.column, count)
        pairs = [(np.arange(len(i)), np.arange(len(i)))]
        for di, dj in ((0, 0), (0, 1), (1, -1), (1, 0), (1, 1)):
            own = np.flatnonzero((i + di < count) & (j + dj >= 0) & (j + dj < count))
            base = (self.column[own] + di * count + dj) * high
            first = np.searchsorted(ends, base + self.lower[own] - gap)
            number = np.searchsorted(starts, base + self.upper[own] + gap, "right") - first
            step = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
            pairs.append((np.repeat(own, number), np.repeat(first, number) + step))
        return np.concatenate([p for p, _ in pairs]), np.concatenate([q for _, q in pairs])

    def join_specks(
        self, part: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find pairs of parts of one cell to merge: only some columns hit a layer thinner than their gaps.

        Each speck is paired with the largest part of its cell that is linked to the same part of another
        cell.
        """
        fill = np.bincount(part, weights=(self.upper - self.lower) / self.across**2)
        cell = np.zeros(len(fill), np.int64)
        cell[part] = self.cell
        own, other = np.concatenate([first, second]), np.concatenate([second, first])
        order = np.lexsort((-fill[own], other, cell[own]))
        own, other = own[order], other[order]
        leads = np.concatenate([[True], (np.diff(cell[own]) != 0) | (np.diff(other) != 0)])[: len(own)]
        leader = own[np.maximum.accumulate(np.where(leads, np.arange(len(own)), 0))]
        speck = fill[own] < 1 / self.across
        return own[speck], leader[speck]

    def moments(self, group: np.ndarray, groups: int) -> np.ndarray:
        """Sum the Legendre moments of the intervals by group; (groups, 5, 5, 5)."""
        place, weight = _columns(self.across)
        _, _, k, a, b = self.indices
        flat = _products(_legendre(place[a, b]) * weight[a, b][:, None], _legendre(place[b, a]))
        rise = _legendre_above(self.lower - k) - _legendre_above(self.upper - k)
        total = np.stack([_sum_rows(flat, part, group, groups) for part in rise.T], -1)
        return total.reshape(groups, *(DEGREE,) * 3)

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Sample the intervals a column's width apart: positions in cells (S, 3) and interval (S,)."""
        place, _ = _columns(self.across)
        i, j, _, a, b = self.indices
        steps = np.ceil((self.upper - self.lower) * self.across).astype(np.int64) + 1
        owner = np.repeat(np.arange(len(steps)), steps)
        place_in = np.arange(len(owner)) - np.repeat(np.cumsum(steps) - steps, steps)
        share = place_in / np.maximum(steps - 1, 1)[owner]
        z = self.lower[owner] + share * (self.upper - self.lower)[owner]
        return np.stack([(i + place[a, b])[owner], (j + place[b, a])[owner], z], 1), owner


def _column_moments(
    found: tuple[np.ndarray, ...], resolution: int, across: int, cells: np.ndarray
) -> np.ndarray:
    """Compute the Legendre moments of the occupancy of flat cells, sorted; (C,) -> (C, 125)."""
    place, weight = _columns(across)
    column, height, sign = found
    (i, a), (j, b) = (np.divmod(part, across) for part in np.divmod(column, resolution * across))
    z = np.clip(height / across, 0, resolution - 1e-9)
    k = z.astype(np.int64)
    # Levels number the upper ends of cells: a crossing fills the rest of its cell and whole cells from its
    # level on.
    level = (i * resolution + j) * (resolution + 1) + k + 1
    levels, event = np.unique(level, return_inverse=True)
    crossed = (i * resolution + j) * resolution + k
    seat = np.searchsorted(cells, crossed).clip(max=len(cells) - 1)
    held = cells[seat] == crossed
    inner = np.zeros((DEGREE, len(cells), DEGREE**2))  # by degree in z
    above = np.zeros((len(levels), DEGREE**2))
    for start in range(0, len(k), _CHUNK):
        part = slice(start, start + _CHUNK)
        left = _legendre(place[a[part], b[part]]) * (weight[a[part], b[part]] * sign[part])[:, None]
        flat = _products(left, _legendre(place[b[part], a[part]]))
        above += _sum_rows(flat, np.full(len(flat), 2.0), event[part], len(levels))
        own = np.flatnonzero(held[part])
        rises = _legendre_above((z - k)[part][own]).T
        for moment, rise in zip(inner, rises):
            moment += _sum_rows(flat[own], rise, seat[part][own], len(cells))
    running = np.concatenate([np.zeros((1, DEGREE**2)), np.cumsum(above, axis=0)])
    pillar, rank = np.divmod(cells, resolution)
    last = np.searchsorted(levels, pillar * (resolution + 1) + rank, "right")
    inner[0] += running[last] - running[np.searchsorted(levels, pillar * (resolution + 1))]
    return np.moveaxis(inner, 0, -1).reshape(len(cells), DEGREE**3)


@cache
def _columns(across: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places and weights of a cell's columns, a quadrature rule over [-1, 1]^2; (across, across) each.

    Column (a, b) is at x = place[a, b], y = place[b, a] of the unit cell. Each row is shifted by its own
    fraction of a column, so that all positions along an axis differ: an aligned lattice would quantise the
    thickness of walls parallel to it (a table top by several per cent). The weights are the closest to equal
    ones that integrate a full cell's polynomials exactly, and positive. Of several point-symmetric
    permutations of the shifts, the one with the most even weights is used. The number of columns across is
    even.
    """
    rng, half = np.random.default_rng(0), across // 2
    equal, rules = 4 / across**2, []
    for _ in range(_ORDERS):
        order = rng.permutation(half)
        order = np.where(rng.random(half) < 0.5, order, across - 1 - order)
        order = np.concatenate([order, across - 1 - order[::-1]])
        place = (np.arange(across)[:, None] + (order + 0.5) / across) / across
        basis = _products(_legendre(place.ravel()), _legendre(place.T.ravel()))
        missing = np.eye(1, DEGREE**2)[0] * 4 - equal * basis.sum(0)
        gram = basis.T @ basis
        if np.linalg.cond(gram) < 1e6:
            shift = basis @ np.linalg.solve(gram, missing)
            rules.append((float(np.abs(shift).max()), place, equal + shift.reshape(across, across)))
    return min(rules, key=lambda rule: rule[0])[1:]


def _legendre(place: np.ndarray) -> np.ndarray:
    """Evaluate the Legendre polynomials of the unit interval; (Q,) -> (Q, 5)."""
    return legendre.legvander(2 * place - 1, DEGREE - 1)


def _legendre_above(place: np.ndarray) -> np.ndarray:
    """Evaluate twice their integrals from a position to the upper end; (Q,) -> (Q, 5)."""
    p = legendre.legvander(2 * place - 1, DEGREE)
    below = (p[:, 2:] - p[:, :-2]) / (2 * np.arange(1, DEGREE) + 1)  # zero at both ends
    return np.concatenate([1 - p[:, 1:2], -below], 1)


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Multiply all pairs of two sets of values; (Q, A), (Q, B) -> (Q, A B)."""
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), left.shape[1] * right.shape[1])


def _sum_rows(rows: np.ndarray, factor: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sum rows times factors by group; (Q, M), (Q,), (Q,) -> (count, M)."""
    return sp.csr_array((factor, (group, np.arange(len(rows)))), shape=(count, len(rows))) @ rows
