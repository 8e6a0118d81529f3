"""Toys, in metres, standing on z = 0: a car, a duck, and a tower of rings."""

from collections.abc import Callable

import manifold3d
import numpy as np
from skimage.measure import marching_cubes

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.atlas import Paint
from objectfolder.shapes.boards import board
from objectfolder.shapes.extrusion import extrude_y, polygon, prism, round_corners, solid
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.texture import over, rgb, smoothstep, stroke

KINDS = ("car", "truck", "duck", "rings")
RAINBOW = ("d8392f", "ef8b2c", "f2c83b", "4da754", "2f7fc1", "6a4fa3", "c2498f", "38a3a5")
#: Colour and accent of each kind where none is asked for.
COLOURS = {"car": ("d23b30", "2b2c30"), "truck": ("2f74b5", "2b2c30"), "duck": ("f5cf36", "ee7f25")}
CELLS = 60  #: grid cells along the duck for marching cubes


@generator("plastic")
def toy(
    order: Order, kind: str = "car", span: Size = 0.16, plump: Size = 1.0, count: int = 5
) -> TexturedMesh:
    """Build a toy.

    One closed surface, facing +x.

    Parameters
    ----------
    kind : str
        "car", "truck", "duck" or "rings".
    span : float
        Length of a car, truck or duck along x; height of a tower of rings, m.
    plump : float
        Width relative to the default, 0.75 to 1.3.
    count : int
        Number of rings of a tower, 3 to 8.
    color : str, optional
        Rings without a colour take rainbow colours.
    accent : str, optional
        Colour of the wheels or the bill; rings grade from the colour to it.
    """
    order.choice(KINDS, kind=kind)
    order.between(0.75, 1.3, "usual widths", plump=plump)
    order.count(3, 8, count=count)

    if kind == "rings":
        look = Look.of(order, span)
        parts = _rings(look, span, plump, count)
    else:
        body, trim = COLOURS[kind]
        look = Look.of(order, span, color=order.color or body, accent=order.accent or trim)
        parts = {"car": _car, "truck": _truck, "duck": _duck}[kind](look, span, plump)
    return assemble(union(parts), parts, look, order.texture_size)


def _wheels(
    look: Look, places: list[float], radius: float, width: float, spacing: float
) -> list[PaintedPart]:
    """Build pairs of wheels with hubs at positions along x; `width` is between their outer sides."""
    thick, hub = 0.5 * radius, 0.55 * radius
    tyre = look.dye(look.accent).paint((0, 1, 0), 1)
    cap = look.dye("ece7da").paint((0, 1, 0), 2)
    parts = []
    for x in places:
        for sign in (-1, 1):
            disc = extrude_y([polygon(40, radius)], thick, spacing, 0.18 * radius)
            boss = extrude_y([polygon(24, hub)], thick, spacing, 0.12 * radius)
            y = sign * (width - thick) / 2
            parts.append(PaintedPart.of(disc.translate((x, y, radius)), tyre))
            parts.append(PaintedPart.of(boss.translate((x, y + sign * 0.14 * radius, radius)), cap))
    return parts


def _lamps(
    look: Look, x: float, width: float, z: float, radius: float, code: str, spacing: float
) -> list[PaintedPart]:
    lamp = prism([polygon(24, radius)], 3 * radius, spacing, 0.5 * radius).rotate((0, 90, 0))
    paint = look.dye(code).paint()
    places = [(x - 2.5 * radius, sign * 0.32 * width, z) for sign in (-1, 1)]
    return [PaintedPart.of(lamp.translate(place), paint) for place in places]


def _paint_cabin(body: Paint, sides: np.ndarray, width: float, border: float, pillar: float | None) -> Paint:
    """Return the paint of a cabin with windows on all sides, inside a convex outline in x and z."""
    glass, edge = rgb("9fd3e6"), np.roll(sides, -1, axis=0) - sides
    inward = np.stack([-edge[:, 1], edge[:, 0]], 1) / np.linalg.norm(edge, axis=1, keepdims=True)
    soft = 0.15 * border
    low, high = sides[:, 1].min() + 1.1 * border, sides[:, 1].max() - 1.1 * border

    def paint(points: np.ndarray) -> np.ndarray:
        colour = body(points)
        deep = np.min([(points[:, [0, 2]] - p) @ n for p, n in zip(sides, inward)], axis=0)
        y = np.abs(points[:, 1])
        beside = smoothstep(border - soft, border + soft, deep) * (y > 0.42 * width)
        if pillar is not None:
            beside = beside * (1 - stroke(points[:, 0] - pillar, border / 2, soft))
        z = points[:, 2]
        height = smoothstep(low - soft, low + soft, z) * smoothstep(high + soft, high - soft, z)
        ahead = height * smoothstep(width / 2 - border + soft, width / 2 - border - soft, y)
        ahead = ahead * (deep < 0.7 * border)
        return over(colour, glass * (0.9 + 0.1 * colour), np.maximum(beside, ahead))

    return paint


def _car(look: Look, span: float, plump: float) -> list[PaintedPart]:
    s, width = span, 0.46 * span * plump
    spacing, r = span / 36, 0.125 * span
    x, z = [-0.5, 0.5, 0.5, 0.46, -0.48, -0.5], [0.09, 0.09, 0.22, 0.27, 0.29, 0.26]
    hull = round_corners(s * np.stack([x, z], 1), 0.045 * s)
    cabin_corners = s * np.array([(-0.36, 0.2), (0.29, 0.2), (0.13, 0.44), (-0.27, 0.44)])
    cabin_width = 0.86 * width
    cabin = extrude_y([round_corners(cabin_corners, 0.045 * s)], cabin_width, spacing, 0.03 * s)
    body = look.dye(look.color).paint((1, 0, 0))
    windows = s * np.array([(-0.33, 0.27), (0.245, 0.27), (0.13, 0.44), (-0.27, 0.44)])
    return [
        PaintedPart.of(extrude_y([hull], width, spacing, 0.032 * s), body),
        PaintedPart.of(cabin, _paint_cabin(body, windows, cabin_width, 0.032 * s, -0.06 * s)),
        *_wheels(look, [-0.29 * s, 0.29 * s], r, 1.04 * width, spacing),
        *_lamps(look, 0.5 * s, width, 0.19 * s, 0.032 * s, "f6e9a8", spacing),
        *_lamps(look, -0.45 * s, width, 0.20 * s, 0.025 * s, "a01f1f", spacing),
    ]


def _truck(look: Look, span: float, plump: float) -> list[PaintedPart]:
    s, width = span, 0.40 * span * plump
    spacing, r = span / 36, 0.085 * span
    frame = round_corners(s * np.array([(-0.5, 0.08), (0.5, 0.08), (0.5, 0.16), (-0.5, 0.16)]), 0.02 * s)
    cab_corners = s * np.array([(0.16, 0.12), (0.49, 0.12), (0.49, 0.27), (0.43, 0.45), (0.16, 0.45)])
    windows = s * np.array([(0.16, 0.255), (0.50, 0.255), (0.43, 0.45), (0.16, 0.45)])
    body = look.dye(look.color).paint((1, 0, 0))
    load = look.dye("f2c83b")
    x, y, z, t = (-0.49 * s, 0.11 * s), width / 2, (0.14 * s, 0.35 * s), 0.025 * s
    boards = [
        ((x[0], -y, z[0]), (x[1], y, z[0] + 1.6 * t)),
        ((x[0], -y, z[0]), (x[1], t - y, z[1])),
        ((x[0], y - t, z[0]), (x[1], y, z[1])),
        ((x[0], 0.5 * t - y, z[0]), (x[0] + t, y - 0.5 * t, z[1] - 0.1 * t)),
        ((x[1] - t, 0.5 * t - y, z[0]), (x[1], y - 0.5 * t, z[1] - 0.1 * t)),
    ]
    tray = [board(load, 10 + k, low, high, spacing, 0.2 * t) for k, (low, high) in enumerate(boards)]
    cab = extrude_y([round_corners(cab_corners, 0.035 * s)], 0.96 * width, spacing, 0.025 * s)
    under = extrude_y([frame], 0.8 * width, spacing, 0.012 * s)
    return [
        *tray,
        PaintedPart.of(under, look.dye("6b6e73").paint((1, 0, 0), 4)),
        PaintedPart.of(cab, _paint_cabin(body, windows, 0.96 * width, 0.03 * s, None)),
        *_wheels(look, [-0.38 * s, -0.16 * s, 0.33 * s], r, 1.06 * width, spacing),
        *_lamps(look, 0.49 * s, width, 0.17 * s, 0.028 * s, "f6e9a8", spacing),
    ]


def _rings(look: Look, height: float, plump: float, count: int) -> list[PaintedPart]:
    """Build rings that shrink upwards on a post, between a foot and a ball."""
    foot, ball = 0.09 * height, 0.11 * height
    widest = 0.36 * height * plump
    pitch = (height - foot - 1.75 * ball) / count
    thick = 1.12 * pitch  # rings overlap
    colours = ramp(look.color, look.accent, count + 2)
    base = prism([polygon(72, widest)], foot, height / 40, 0.3 * foot)
    parts = [PaintedPart.of(base, look.dye(colours[0]).paint((1, 0, 0)))]
    post = prism([polygon(48, 0.16 * widest)], height - foot - ball, height / 40)
    parts.append(PaintedPart.of(post.translate((0, 0, 0.5 * foot)), parts[0].paint))
    for k in range(count):
        outer = widest * (0.94 - 0.46 * k / (count - 1))
        half = min(0.8 * thick, 0.42 * outer)
        oval = polygon(22, 1.0) * [half, thick / 2] + [outer - half, 0]
        ring = manifold3d.CrossSection([oval]).revolve(72)
        disc = prism([polygon(48, outer - half)], 1.02 * pitch, height / 40).translate((0, 0, -0.51 * pitch))
        place = (0, 0, foot + pitch * (k + 0.5))
        paint = look.dye(colours[k + 1]).paint(None, k)
        parts.append(PaintedPart.of((ring + disc).translate(place), paint))
    top = manifold3d.Manifold.sphere(ball, 64).translate((0, 0, height - ball))
    parts.append(PaintedPart.of(top, look.dye(colours[-1]).paint(None, count)))
    return parts


def ramp(first: str | None, last: str | None, count: int) -> list[str]:
    """Return hexadecimal colours from the first to the last, or rainbow colours without a first."""
    if first is None:
        return [RAINBOW[k % len(RAINBOW)] for k in range(count)]
    ends = rgb(first), rgb(last or first)
    steps = [ends[0] + t * (ends[1] - ends[0]) for t in np.linspace(0, 1, count)]
    return ["".join(f"{round(255 * c):02x}" for c in step) for step in steps]


def _duck(look: Look, span: float, plump: float) -> list[PaintedPart]:
    """Build a duck: blended body, head and tail, with bill and painted eyes."""
    wide = np.array([1.0, plump, 1.0])

    def blend(a: np.ndarray, b: np.ndarray, soft: float) -> np.ndarray:
        """Blend two distances into a smooth union."""
        h = np.clip(0.5 + 0.5 * (b - a) / soft, 0, 1)
        return b + h * (a - b) - soft * h * (1 - h)

    def distance(points: np.ndarray) -> np.ndarray:
        at = points / wide
        body = _ellipsoid(at, (-0.06, 0, 0.24), (0.40, 0.29, 0.235))
        tail = _ellipsoid(at, (-0.44, 0, 0.40), (0.14, 0.13, 0.075))
        head = _ellipsoid(at, (0.22, 0, 0.605), (0.205, 0.19, 0.19))
        neck = _ellipsoid(at, (0.17, 0, 0.42), (0.16, 0.15, 0.12))
        side = np.abs(at) * [0, 1, 0] + at * [1, 0, 1]
        wing = _ellipsoid(side, (-0.12, 0.265, 0.29), (0.22, 0.055, 0.12))
        torso = blend(blend(body, tail, 0.16), blend(neck, head, 0.05), 0.06)
        return blend(torso, wing, 0.02)

    made = _extract_solid(distance, np.array([[-0.66, -0.44 * plump, -0.05], [0.5, 0.44 * plump, 0.85]]))
    made = made.trim_by_plane((0, 0, 1.0), 0.02).translate((0, 0, -0.02))
    feathers = look.dye(look.color).paint((1, 0, 0))

    def paint(points: np.ndarray) -> np.ndarray:
        at = (points / span + [0, 0, 0.02]) / wide
        eye = np.linalg.norm(np.abs(at) * [0, 1, 0] + at * [1, 0, 1] - [0.325, 0.115, 0.665], axis=1)
        colour = over(feathers(points), np.array([0.97, 0.97, 0.95]), smoothstep(0.058, 0.054, eye))
        return over(colour, rgb("1c1a1c"), smoothstep(0.040, 0.036, eye))

    ball = manifold3d.Manifold.sphere(1.0, 64)
    upper = ball.scale((0.15, 0.105 * plump, 0.042)).rotate((0, -8, 0)).translate((0.40, 0, 0.565))
    lower = ball.scale((0.115, 0.085 * plump, 0.036)).rotate((0, 10, 0)).translate((0.39, 0, 0.525))
    bill = look.dye(look.accent).paint((1, 0, 0), 1)
    parts = (made, paint), (upper, bill), (lower, bill)
    return [PaintedPart.of(part.scale([span] * 3), cover) for part, cover in parts]


def _ellipsoid(at: np.ndarray, middle: tuple[float, ...], half: tuple[float, ...]) -> np.ndarray:
    """Compute the distance (N,) to an ellipsoid, to first order near its surface."""
    scaled = (at - middle) / half
    radius = np.maximum(np.linalg.norm(scaled, axis=1), 1e-9)
    return radius * (radius - 1) / np.maximum(np.linalg.norm(scaled / half, axis=1), 1e-9)


def _extract_solid(distance: Callable[[np.ndarray], np.ndarray], bounds: np.ndarray) -> manifold3d.Manifold:
    """Extract the solid where a distance is negative."""
    step = np.ptp(bounds, axis=0).max() / CELLS
    axes = [np.arange(a, b + step, step) for a, b in bounds.T]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    values = distance(points.reshape(-1, 3)).reshape(points.shape[:3])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(step,) * 3, allow_degenerate=False)
    vertices = vertices.astype(np.float64) + [axis[0] for axis in axes]
    for _ in range(2):  # Newton steps onto the surface
        shifts = 1e-4 * np.eye(3)
        slope = np.stack([distance(vertices + d) - distance(vertices - d) for d in shifts], 1) / 2e-4
        vertices -= (distance(vertices) / np.sum(slope**2, axis=1))[:, None] * slope
    return solid(vertices, faces.astype(np.int64))
