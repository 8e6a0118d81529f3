"""Spoons and ladles: an oval bowl of even thickness on a curved handle; the bowl rests on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.revolution import arc_length, points_along
from objectfolder.shapes.sweep import tube

SEGMENTS = 96  #: facets around the bowl


@generator("brushed")
def spoon(
    order: Order, length: Size = 0.19, bowl_length: Size = 0.060, bowl_width: Size = 0.040,
    depth: Size = 0.011, wall: Size = 0.0018, handle_width: Size = 0.014, rise: float = 0.012,
    hook: float = 0.0, point: float = 0.14,
) -> TexturedMesh:  # fmt: skip
    """Build a spoon, or a ladle if the bowl is deep and the handle high and hooked.

    One closed surface, along x, the middle of the bowl at x = 0.

    Parameters
    ----------
    length : float
        Length along x from the tip of the bowl to the end of the handle, without hook, m.
    bowl_length, bowl_width, depth : float
        Outer dimensions of the bowl, m.
    wall : float
        Thickness of the bowl, m.
    handle_width : float
        Largest width of the handle, m.
    rise : float
        Height of the end of the handle above the rim, m.
    hook : float
        Radius of the hook at the end of the handle, m; 0 for none.
    point : float
        Narrowing of the bowl's tip relative to an ellipse, 0 to 0.3.
    """
    order.between(0.4 * bowl_length, bowl_length, "40 % to 100 % of the bowl's length", bowl_width=bowl_width)
    order.between(0.15 * bowl_width, 0.9 * bowl_width, "15 % to 90 % of the bowl's width", depth=depth)
    order.between(0.02 * bowl_width, 0.45 * depth, "2 % of the width to 45 % of the depth", wall=wall)
    order.between(1.5 * bowl_length, 8 * bowl_length, "1.5 to 8 lengths of the bowl", length=length)
    slim, wide = 0.1 * bowl_width, 0.45 * bowl_width
    order.between(slim, wide, "10 % to 45 % of the bowl's width", handle_width=handle_width)
    order.between(0, 1.5 * length, "1.5 lengths", rise=rise)
    order.between(0, 0.12 * length, "12 % of the length", hook=hook)
    if hook > 0:
        order.between(0.8 * handle_width, 0.5 * rise, "so that it curls clear of handle and table", hook=hook)
    order.between(0, 0.3, "a blunt tip", point=point)

    size = max(length, rise + depth)
    look = Look.of(order, size)
    a, b = bowl_length / 2, bowl_width / 2
    ball = manifold3d.Manifold.sphere(1.0, SEGMENTS).trim_by_plane((0, 0, -1.0), 0.0)
    outer = ball.scale((a, b, depth))
    inner = ball.scale((a - wall, b - wall, depth - wall))
    # Extends upwards, to remove the handle's root from the bowl.
    rim = inner.trim_by_plane((0, 0, 1.0), -1e-3 * depth)
    opening = inner + manifold3d.Manifold.hull(rim + rim.translate((0, 0, size)))

    def pointed(points: np.ndarray) -> np.ndarray:
        narrow = 1 + point * np.clip(points[:, 0] / a, -1, 0.35)
        return points * np.column_stack([np.ones_like(narrow), narrow, np.ones_like(narrow)])

    metal = look.paint((1, 0, 0))
    handle = _handle(a, length - a, wall, handle_width, rise, hook)
    solids = (outer.warp_batch(pointed), handle, opening.warp_batch(pointed))
    parts = [PaintedPart.of(solid, metal) for solid in solids]
    whole = parts[0].solid + parts[1].solid - parts[2].solid
    return assemble(whole.translate((0, 0, depth)), parts, look, order.texture_size)


def _handle(a: float, end: float, wall: float, width: float, rise: float, hook: float) -> manifold3d.Manifold:
    """Build the handle from the rim of the bowl, at x = a and z = 0, to its end."""
    thick = max(1.3 * wall, 0.20 * width)
    root = np.array([a - 1.2 * wall, -0.75 * thick])
    bend = np.array([a + 0.28 * (end - a), 0.95 * rise])
    tip = np.array([end, rise])
    t = np.linspace(0, 1, 401)[:, None]
    path = (1 - t) ** 2 * root + 2 * t * (1 - t) * bend + t**2 * tip
    if hook > 0:
        along = (tip - bend) / np.linalg.norm(tip - bend)
        across = np.array([along[1], -along[0]])  # to the right: down
        turn = np.linspace(0, np.deg2rad(200), 101)[1:, None]
        path = np.concatenate([path, tip + hook * (np.sin(turn) * along + (1 - np.cos(turn)) * across)])
    total = arc_length(path)[-1]
    # Even stations, closer where the end is rounded.
    cap = 0.5 * width
    even = np.linspace(0, total - cap, int((total - cap) / (0.22 * width)) + 2)
    at = np.append(even, total - cap * (1 - np.sin(np.linspace(0, np.pi / 2, 9)[1:])))
    path = points_along(path, at)
    u = at / total
    wide = width * (0.48 + 0.52 * u**1.5 + 0.45 * np.exp(-((at / (0.9 * width)) ** 2)))
    rounding = np.sqrt(np.clip(1 - np.clip((at - total + cap) / cap, 0, 1) ** 2, 0.02, 1))
    depth = thick * (1 + 0.5 * np.exp(-((at / (1.5 * width)) ** 2))) * (0.6 + 0.4 * rounding)
    return tube(np.column_stack([path[:, 0], 0 * at, path[:, 1]]), wide * rounding, depth, (0, 1, 0), 32, 2.6)
