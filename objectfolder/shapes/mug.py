"""A ceramic mug: a hollow cup with a swept handle, in metres, standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.atlas import Chart, Paint, pack_charts
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.revolution import (
    arc,
    arc_length,
    disc,
    grid_faces,
    points_along,
    polyline,
    sleeve,
)
from objectfolder.shapes.solid import Patch, bake_mesh, weld_patches
from objectfolder.shapes.texture import lattice, noise, over, rgb, smoothstep, stroke

GLAZE, TEAL, DEEP, SAGE, OCHRE, CLAY = map(rgb, ("f3ecdd", "2f7f86", "1c4f5c", "5f8f6b", "d9973c", "a8623a"))
SEED = 20210

FOOT = 0.0015  #: depth of the hollow under the foot, in m for a mug of 0.041 m radius
STATIONS = 56  #: rows of the handle along its path, even so that its outermost point is a vertex
ROUND = 28  #: facets of the handle's section
FLARE = 0.45  #: by how much the handle's section grows where it meets the wall


@generator()
def mug(
    order: Order, radius: Size = 0.041, height: Size = 0.095, wall: Size = 0.004, bottom: Size = 0.006,
    handle_reach: Size = 0.030,
) -> TexturedMesh:  # fmt: skip
    """Build a ceramic mug.

    One closed surface of genus 1; x from -radius to radius + handle_reach, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Outer radius, height and thickness of the wall, m.
    bottom : float
        Height of the inner floor above the table, m; the base is slightly hollow.
    handle_reach : float
        Protrusion of the handle from the wall, m.
    """
    order.between(0.03 * radius, 0.2 * radius, "3 % to 20 % of the radius", wall=wall)
    order.between(0.08 * radius, 0.25 * height, "a floor above the foot", bottom=bottom)
    order.between(1.2 * radius, 6.0 * radius, "1.2 to 6 radii", height=height)
    # The flared ends of the handle must stop inside the wall, which curves away from them.
    grip = np.sqrt(radius * wall - wall**2 / 4) / (0.20 * (1 + FLARE)) * 0.95
    # Their upper and lower edges keep clear of the rounded lip and base.
    upright = 0.9 * min(0.17 * height - wall / 2, 0.23 * height - 0.2 * radius) / (0.12 * (1 + FLARE))
    widest = min(grip, upright)
    order.between(0.3 * radius, widest, "a handle that the wall can hold", handle_reach=handle_reach)

    edge = 0.2 * radius  # rounding outside, where the wall meets the base
    foot = min(FOOT * radius / 0.041, 0.3 * bottom)
    inner = min(0.3 * (radius - wall), 0.4 * (height - bottom))
    lip = wall / 2
    step = height / 16
    top = height - lip
    base = np.array([[0, foot], [0.70 * radius, foot], [0.73 * radius, 0], [radius - edge, 0]])
    under = polyline(base, step=step)
    bend = arc((radius - edge, edge), edge, -np.pi / 2, 0, 7)
    outside = polyline(bend, arc((radius - lip, top), lip, 0, np.pi / 2, 5), step=step)
    bend = arc((radius - wall - inner, bottom + inner), inner, 0, -np.pi / 2, 8)
    inside = polyline(arc((radius - lip, top), lip, np.pi / 2, np.pi, 5), bend, step=step)
    floor = polyline(np.array([[radius - wall - inner, bottom], [0, bottom]]), step=step)

    decor = _Decor(radius, height)
    parts = [
        disc(under, 0, decor.base),
        sleeve(outside, 1, decor.outside),
        sleeve(inside, 2, decor.inside),
        disc(floor, 3, decor.inside),
    ]
    handle, handle_chart = _handle(radius, height, wall, handle_reach, 4, decor.handle)
    atlas = pack_charts([*(chart for _, chart in parts), handle_chart], order.texture_size)
    cup = weld_patches([patch for patch, _ in parts], atlas)
    return bake_mesh(cup + weld_patches(handle, atlas), atlas, roughness=0.25)


def _handle(
    radius: float, height: float, wall: float, reach: float, chart: int, paint: Paint
) -> tuple[list[Patch], Chart]:
    """Sweep an ellipse along a D-shaped path whose ends lie in the middle of the wall."""
    thick, wide = 0.12 * reach, 0.20 * reach  # half axes of the section
    start = radius - wall / 2
    across, up = radius + reach - thick - start, 0.30 * height
    fine = np.linspace(-np.pi / 2, np.pi / 2, 4001)
    # A superellipse leaves the wall squarely and has room for fingers.
    x = start + across * np.cos(fine).clip(0) ** 0.8
    path = np.stack([x, 0.53 * height + up * np.sign(fine) * np.abs(np.sin(fine)) ** 0.8], 1)
    total = arc_length(path)[-1]

    def station(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return centre, outward normal in the plane of the path, and size of the section."""
        s = np.clip(s, 0, total)
        before, after = (points_along(path, np.clip(s + d * total, 0, total)) for d in (-0.01, 0.01))
        normal = (after - before)[:, ::-1] * [1, -1]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        distance = np.minimum(s, total - s) - wall / 2
        size = 1 + FLARE * np.exp(-((np.maximum(distance, 0) / (0.16 * reach)) ** 2))
        return points_along(path, s), normal, size

    def surface(s: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return points (N, 3) at arc length s, m, and turn in [0, 1] around the section from its inside."""
        centre, normal, size = station(s)
        angle = 2 * np.pi * turn + np.pi
        out = centre + (thick * size * np.cos(angle))[:, None] * normal
        return np.stack([out[:, 0], wide * size * np.sin(angle), out[:, 1]], 1)

    around = np.pi * (3 * (thick + wide) - np.sqrt((3 * thick + wide) * (thick + 3 * wide)))  # Ramanujan
    rows, n = STATIONS + 1, ROUND
    grid = np.meshgrid(np.linspace(0, total, rows), np.arange(n + 1) / n, indexing="ij")
    s, turn = (k.ravel() for k in grid)
    vertices = surface(s, turn % 1.0)
    xy = np.stack([s, (1 - turn) * around], 1)  # horizontal: the atlas packs low charts better
    tube = Patch(vertices, grid_faces(rows, n + 1), xy, chart)

    ring = np.arange(n)
    cap = np.stack([np.full(n - 2, 0), ring[2:], ring[1:-1]], 1)
    last = STATIONS * (n + 1)
    ends = Patch(vertices, np.concatenate([cap, cap[:, ::-1] + last]), xy, chart)  # hidden in the wall
    used, faces_of_ends = np.unique(ends.faces, return_inverse=True)
    ends = Patch(vertices[used], faces_of_ends.reshape(-1, 3), xy[used], chart)

    def locate(at: np.ndarray) -> np.ndarray:
        return surface(at[:, 0], 1 - at[:, 1] / around)

    return [tube, ends], Chart((total, around), locate, paint)


class _Decor:
    """Glaze and painted decoration of a mug; methods map points (N, 3) to sRGB (N, 3)."""

    def __init__(self, radius: float, height: float):
        self.radius, self.height = radius, height
        self.unit = height / 0.095  # lengths below are those of the default mug
        self.values = lattice(SEED)

    def _glaze(self, points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        """Glaze with soft clouds and fine iron specks."""
        at = points / self.unit
        clouds = noise(at / 0.012, self.values, 3)
        specks = smoothstep(2.2, 2.7, noise(at / 0.0011 + 5, self.values))
        return over(colour * (1 + 0.016 * clouds)[:, None], 0.45 * CLAY + 0.1, 0.55 * specks)

    def _rim(self, colour: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Clay that shows through at the lip, the same from both sides."""
        u = self.unit
        low = self.height - 0.0022 * u - 0.0004 * u * noise(points / (0.006 * u), self.values)
        return over(colour, CLAY, 0.9 * smoothstep(-0.0005 * u, 0.0007 * u, points[:, 2] - low))

    def base(self, points: np.ndarray) -> np.ndarray:
        """Bare clay under the mug, glazed where it rounds into the wall."""
        r = np.hypot(points[:, 0], points[:, 1])
        bare = np.broadcast_to(0.35 * CLAY + 0.65 * GLAZE, points.shape)
        glazed = smoothstep(0.765 * self.radius, 0.775 * self.radius, r)
        return over(self._glaze(points, bare), self._glaze(points, DEEP), glazed)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Pool of teal that deepens towards the floor."""
        depth = np.clip(points[:, 2] / self.height, 0, 1)
        colour = over(np.broadcast_to(rgb("bfe0dc"), points.shape), TEAL, 0.75 * (1 - depth) ** 1.5)
        return self._rim(self._glaze(points, colour), points)

    def handle(self, points: np.ndarray) -> np.ndarray:
        """Plain glaze with a teal line down the back and another inside the grip."""
        u = self.unit
        colour = self._glaze(points, np.broadcast_to(GLAZE, points.shape))
        return over(colour, TEAL, stroke(points[:, 1], 0.0016 * u, 0.0005 * u))

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Waves at the foot, sprigs round the middle, dots and bands at the top."""
        u, soft = self.unit, 0.0005 * self.unit
        angle = np.arctan2(points[:, 1], points[:, 0])
        z = points[:, 2] / u
        around = 2 * np.pi * self.radius / u  # circumference in the default mug's metres
        colour = self._glaze(points, np.broadcast_to(GLAZE, points.shape))

        crest = max(3, round(around / 0.0215))
        for level, ink, shift in ((0.0265, SAGE, 0.9), (0.0225, TEAL, 0.0), (0.0165, DEEP, 2.1)):
            ripple = 0.0006 * np.sin(2 * crest * angle + 1.7 * shift)
            wave = level + 0.0019 * np.sin(crest * angle + shift) + ripple
            colour = over(colour, GLAZE, smoothstep(soft / u, -soft / u, z - wave - 0.0008))
            colour = over(colour, self._glaze(points, ink), smoothstep(soft / u, -soft / u, z - wave))

        sprigs = max(3, round(around / 0.0285))
        cell = around / sprigs
        x = ((angle / (2 * np.pi) * sprigs) % 1.0 - 0.5) * cell
        colour = over(colour, SAGE, sprig(x, z - 0.034, 0.0385))
        berries = np.full(len(z), np.inf)
        for dx, dz in ((0.5, 0.046), (0.5, 0.056), (0.5, 0.066)):
            berries = np.minimum(berries, np.hypot(np.abs(x) - dx * cell, z - dz))
        colour = over(colour, OCHRE, smoothstep(0.0019, 0.0015, berries))

        for level, half, ink in ((0.0785, 0.0004, DEEP), (0.0875, 0.0004, DEEP)):
            colour = over(colour, ink, stroke(z - level, half, 0.0004))
        dots = 3 * sprigs
        x = ((angle / (2 * np.pi) * dots) % 1.0 - 0.5) * around / dots
        colour = over(colour, TEAL, smoothstep(0.0023, 0.0019, np.hypot(x, z - 0.083)))
        return self._rim(colour, points)


def sprig(x: np.ndarray, z: np.ndarray, length: float) -> np.ndarray:
    """Return the opacity (N,) of a sprig with paired leaves from (0, 0) to (0, length), m."""
    stem = stroke(x, 0.00045, 0.0004) * smoothstep(-0.0002, 0.0002, z) * smoothstep(length, length - 0.002, z)
    cover = stem
    for k, root in enumerate(np.linspace(0.14, 0.72, 4) * length):
        size = 0.0105 - 0.0011 * k
        lean = np.deg2rad(48 - 5 * k)
        along = np.abs(x) * np.sin(lean) + (z - root) * np.cos(lean)
        side = np.abs(x) * np.cos(lean) - (z - root) * np.sin(lean)
        cover = np.maximum(cover, leaf(along, side, size))
    return np.maximum(cover, leaf(z - 0.78 * length, x, 0.22 * length))


def leaf(along: np.ndarray, side: np.ndarray, length: float) -> np.ndarray:
    """Return the opacity (N,) of a leaf from 0 to ``length`` on its axis, m, with a bare midrib."""
    t = np.clip(along / length, 0, 1)
    half = 0.62 * length * t**0.8 * (1 - t) ** 0.9
    blade = smoothstep(0.0002, -0.0002, np.abs(side) - half) * (along > 0) * (along < length)
    return blade * (1 - 0.8 * stroke(side, 0.00022, 0.0003) * (t < 0.8))
