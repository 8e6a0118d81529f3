"""Surfaces of revolution about z, meshed and charted as sleeves and discs.

A profile is a polyline (N, 2) of radius and height, m, with the solid to its left: up an outer wall, down
an inner one.
"""

from itertools import pairwise

import numpy as np

from objectfolder.shapes.atlas import Chart, Paint
from objectfolder.shapes.solid import Patch

SEGMENTS = 120  #: facets of a full circle; a multiple of 8, so that bounds are exact
TAPER = 2.0  #: largest ratio of radii within a sleeve
SHORT = 0.3  #: length, in distances from the axis, below which a run joins its neighbour


def arc(centre: tuple[float, float], radius: float, start: float, stop: float, pieces: int) -> np.ndarray:
    """Return points (pieces + 1, 2) on a circle from angle ``start`` to ``stop``, rad."""
    angle = np.linspace(start, stop, pieces + 1)
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def polyline(*parts: np.ndarray, step: float) -> np.ndarray:
    """Join parts end to end without repeated points, and divide segments longer than ``step``."""
    points = np.concatenate(parts)
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.append(True, gaps > 1e-6 * gaps.sum())]
    pieces = np.ceil(np.linalg.norm(np.diff(points, axis=0), axis=1) / step).astype(int)
    divided = [
        a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a)
        for a, b, n in zip(points[:-1], points[1:], pieces)
    ]
    return np.concatenate([*divided, points[-1:]])


def arc_length(curve: np.ndarray) -> np.ndarray:
    """Return the length (N,) along a polyline (N, 2) up to each point."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))


def points_along(curve: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Interpolate a polyline (N, 2) at arc lengths (M,), constant beyond both ends; (M, 2)."""
    length = arc_length(curve)
    return np.stack([np.interp(s, length, curve[:, k]) for k in (0, 1)], 1)


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Triangulate a grid of ``rows`` x ``columns`` vertices, numbered row by row."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij"))
    a, d = i * columns + j, (i + 1) * columns + j
    return np.concatenate([np.stack([a, a + 1, d + 1], 1), np.stack([a, d + 1, d], 1)])


def spin(rz: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotate radius and height ``rz`` (N, 2) by an angle (N,) about z; (N, 3)."""
    return np.stack([rz[:, 0] * np.cos(angle), rz[:, 0] * np.sin(angle), rz[:, 1]], 1)


def sleeve(profile: np.ndarray, chart: int, paint: Paint) -> tuple[Patch, Chart]:
    """Revolve a profile off the axis; the chart is angle by arc length, cut at angle 0."""
    rows, n = len(profile), SEGMENTS
    length = arc_length(profile)
    # The area-weighted mean radius makes texels square on average.
    radius = np.average(profile[:, 0], weights=np.gradient(length) * profile[:, 0])
    width = 2 * np.pi * radius
    turn = np.arange(n + 1) / n
    # The last column repeats the first exactly, to close the cut.
    angle = 2 * np.pi * (np.arange(n + 1) % n) / n
    vertices = spin(np.repeat(profile, n + 1, axis=0), np.tile(angle, rows))
    xy = np.stack([np.tile(turn * width, rows), np.repeat(length, n + 1)], 1)

    def locate(at: np.ndarray) -> np.ndarray:
        return spin(points_along(profile, at[:, 1]), 2 * np.pi * at[:, 0] / width)

    return Patch(vertices, grid_faces(rows, n + 1), xy, chart), Chart((width, length[-1]), locate, paint)


def disc(profile: np.ndarray, chart: int, paint: Paint, segments: int = SEGMENTS) -> tuple[Patch, Chart]:
    """Revolve a profile that starts or ends near or on the axis; the chart is polar, without a cut.

    Towards the axis the number of facets halves repeatedly, which avoids needle triangles. A disc with a
    central hole keeps its number of facets, so that its neighbours fit.
    """
    outward = profile[0, 0] < profile[-1, 0]
    spokes = profile if outward else profile[::-1]  # from the axis out
    along = spokes[0, 0] + arc_length(spokes)
    # Seen from outside, the angle is reversed where the profile runs outward.
    sense = -1.0 if outward else 1.0
    reach = along[-1]

    closed = spokes[0, 0] == 0
    counts = [segments]
    for r in spokes[-2::-1, 0]:
        crowded = r < 0.55 * spokes[-1, 0] * counts[-1] / segments
        halve = closed and crowded and counts[-1] % 2 == 0 and counts[-1] >= 16
        counts.append(counts[-1] // 2 if halve else counts[-1])
    counts = counts[::-1]
    if closed:
        counts[0] = 1
    starts = np.cumsum([0, *counts])
    angle = np.concatenate([2 * np.pi * np.arange(n) / n for n in counts])
    ring = np.repeat(np.arange(len(counts)), counts)
    xy = reach + along[ring, None] * np.stack([np.cos(sense * angle), np.sin(sense * angle)], 1)
    if closed:
        xy[0] = reach

    rings = zip(counts, counts[1:], starts)
    triangles = np.concatenate([_strip(one, other, start, start + one) for one, other, start in rings])

    def locate(at: np.ndarray) -> np.ndarray:
        x, y = (at - reach).T
        s = np.hypot(x, y) - spokes[0, 0]
        return spin(points_along(spokes, s), np.arctan2(sense * y, x))

    patch = Patch(spin(spokes[ring], angle), triangles if outward else triangles[:, ::-1], xy, chart)
    return patch, Chart((2 * reach, 2 * reach), locate, paint)


def _strip(inner: int, outer: int, a: int, b: int) -> np.ndarray:
    """Triangulate between a ring of `inner` vertices from index `a` and one of `outer` from `b`."""
    j = np.arange(inner)
    if inner == 1:
        k = np.arange(outer)
        return np.stack([np.full(outer, a), b + (k + 1) % outer, b + k], 1)
    after = a + (j + 1) % inner
    if inner == outer:
        far = b + (j + 1) % outer
        return np.concatenate([np.stack([a + j, after, far], 1), np.stack([a + j, far, b + j], 1)])
    first, middle, last = (b + (2 * j + k) % outer for k in range(3))
    fans = ([a + j, middle, first], [a + j, after, middle], [after, last, middle])
    return np.concatenate([np.stack(fan, 1) for fan in fans])


def revolve(profile: np.ndarray, first_chart: int, paint: Paint) -> list[tuple[Patch, Chart]]:
    """Revolve any profile (N, 2), cut into few sleeves and discs with little texture distortion.

    Charts are numbered from ``first_chart`` on.
    """
    parts: list[tuple[Patch, Chart]] = []
    for start, stop, flat in _runs(profile):
        piece, chart = profile[start : stop + 1], first_chart + len(parts)
        parts.append(disc(piece, chart, paint) if flat else sleeve(piece, chart, paint))
    return parts


def _runs(profile: np.ndarray) -> list[tuple[int, int, int]]:
    """Split a profile into runs (first point, last point, kind): 1 flat outward, -1 flat inward, 0 steep."""
    step = np.diff(profile, axis=0)
    length = np.append(0.0, np.cumsum(np.linalg.norm(step, axis=1)))
    kind = np.where(np.abs(step[:, 0]) > np.abs(step[:, 1]), np.sign(step[:, 0]), 0).astype(int)
    # A sleeve cannot contain the axis.
    kind[0] = 1 if profile[0, 0] == 0 else kind[0]
    kind[-1] = -1 if profile[-1, 0] == 0 else kind[-1]
    while True:
        edges = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1, [len(kind)]])
        if len(edges) == 2:
            break
        # Length relative to the distance from the axis: short runs join a neighbour.
        spans = np.diff(length[edges])
        means = [profile[a : b + 1, 0].mean() for a, b in pairwise(edges)]
        reach = spans / np.array(means)
        if profile[0, 0] == 0:
            reach[0] = np.inf
        if profile[-1, 0] == 0:
            reach[-1] = np.inf
        k = int(np.argmin(reach))
        if reach[k] > SHORT:
            break
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(spans)]
        j = max(beside, key=lambda m: spans[m])
        kind[edges[k] : edges[k + 1]] = kind[edges[j]]
    runs = []
    for a, b in pairwise(edges):
        if kind[a]:
            runs.append((int(a), int(b), int(kind[a])))
            continue
        start = int(a)
        for k in range(int(a) + 1, int(b) + 1):
            r = profile[start : k + 1, 0]
            if r.max() > TAPER * r.min() and k - start > 1:
                runs.append((start, k - 1, 0))
                start = k - 1
        runs.append((start, int(b), 0))
    return runs
