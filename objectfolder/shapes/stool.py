"""Stools: a round seat on splayed round legs with rungs between them; standing on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, frame, union
from objectfolder.shapes.boards import timber
from objectfolder.shapes.extrusion import polygon, prism
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import bar

SIDES = 80  #: facets around the seat
SUNK = 0.6  #: depth of a leg's end in the seat, in thicknesses of the seat


@generator("wood")
def stool(
    order: Order, diameter: Size = 0.34, height: Size = 0.46, seat: Size = 0.036, leg_diameter: Size = 0.034,
    legs: int = 4, splay: float = 0.05, rung_height: float = 0.16, dish: float = 0.006,
) -> TexturedMesh:  # fmt: skip
    """Build a stool.

    One closed surface, standing on z = 0 about the z axis.

    Parameters
    ----------
    diameter, height : float
        Diameter of the seat and height of the stool, m.
    seat : float
        Thickness of the seat, m.
    leg_diameter : float
        Diameter of the legs at the seat, m; they taper towards the floor.
    legs : int
        Number of legs, 3 to 6.
    splay : float
        Radial offset of the legs between seat and floor, m.
    rung_height : float
        Height of the rungs above the floor, m; 0 for none.
    dish : float
        Depth of the hollow of the seat, m.
    """
    order.count(3, 6, legs=legs)
    order.between(0.4 * diameter, 3 * diameter, "0.4 to 3 diameters of the seat", height=height)
    order.between(0.05 * diameter, 0.2 * height, "a seat that bears", seat=seat)
    order.between(0.05 * diameter, 0.15 * diameter, "5 % to 15 % of the seat", leg_diameter=leg_diameter)
    order.between(0, 0.3 * height, "30 % of the height", splay=splay)
    order.between(0, 0.7 * (height - seat), "clear of the seat", rung_height=rung_height)
    if rung_height > 0:
        order.between(leg_diameter, height, "clear of the floor", rung_height=rung_height)
    order.between(0, 0.25 * seat, "a quarter of the seat", dish=dish)

    look = Look.of(order, max(diameter, height))
    spacing = look.size / 30
    under = height - seat
    plate = prism([polygon(SIDES, diameter / 2)], seat, diameter / 24, 0.3 * seat)

    def hollow(points: np.ndarray) -> np.ndarray:
        r = np.hypot(points[:, 0], points[:, 1]) / (0.45 * diameter)
        depth = dish * np.clip(1 - r**2, 0, 1) ** 2
        return points - np.outer(depth * points[:, 2] / seat, [0, 0, 1])

    plate = plate.warp_batch(hollow).translate((0, 0, under))
    parts = [
        PaintedPart.of(plate, timber(look, 21, np.array([0, 0, height - seat / 2]), np.eye(3), diameter))
    ]

    radius = diameter / 2 - 0.9 * leg_diameter  # of the circle of the legs' tops

    def middle(k: int, z: float) -> np.ndarray:
        """Return the point of the axis of leg k at height z."""
        turn = 2 * np.pi * (k + 0.5) / legs
        r = radius + splay * (under - z) / under - 0.1 * splay
        return np.array([r * np.cos(turn), r * np.sin(turn), z])

    for k in range(legs):
        ends = middle(k, -leg_diameter), middle(k, under + SUNK * seat - 0.75 * dish)
        post = bar(*ends, (0.75 * leg_diameter, leg_diameter), spacing, 24).trim_by_plane((0, 0, 1), 0)
        parts.append(_place_bar(look, 1 + k, post, ends, leg_diameter))
    if rung_height > 0:
        for k in range(legs):
            # Staggered, so that neighbours meet a leg at different heights.
            z = rung_height * (1.0 + 0.18 * (k % 2))
            ends = middle(k, z), middle((k + 1) % legs, z)
            rung = bar(*ends, (0.55 * leg_diameter, 0.55 * leg_diameter), spacing, 20)
            parts.append(_place_bar(look, 11 + k, rung, ends, leg_diameter))
    return assemble(union(parts), parts, look, order.texture_size)


def _place_bar(
    look: Look, piece: int, solid: manifold3d.Manifold, ends: tuple[np.ndarray, np.ndarray], diameter: float
) -> PaintedPart:
    """Build the part of a bar between two ends, its grain along it."""
    axes = frame(ends[1] - ends[0])
    return PaintedPart.of(solid, timber(look, piece, (ends[0] + ends[1]) / 2, axes, diameter), axes)
