"""Furniture of painted boards and bars, standing on z = 0: tables, stools, bookcases and cabinets."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, frame, union
from objectfolder.shapes.boards import board, leg, timber
from objectfolder.shapes.extrusion import polygon, prism, rectangle
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import bar

SEAM = 0.002  #: width of the joints between the planks of a table's top, m
SUNK = 0.6  #: depth of a leg's end in a top or a seat, in thicknesses of that
LAP = 0.5  #: overlap of a board's end with the board it meets, in thicknesses
TOP_SIDES, SEAT_SIDES = 96, 80  #: facets around an oval top, and around a seat
FRONTS = ("open", "doors", "drawers")
GAP = 0.004  #: between doors or drawers, in sizes of the furniture; opens the bays


@generator("wood")
def table(
    order: Order, length: Size = 1.5, width: Size = 0.8, height: Size = 0.74, top: Size = 0.032,
    leg_size: Size = 0.065, apron: float = 0.09, overhang: float = 0.04, taper: Size = 0.7,
    shape: str = "rectangle", base: str = "legs", bevel: float = 0.003,
) -> TexturedMesh:  # fmt: skip
    """Build a table.

    One closed surface; x and y about 0, z from 0 to ``height``.

    Parameters
    ----------
    length, width, height : float
        Dimensions along x, y and z, m.
    top : float
        Thickness of the top, m.
    leg_size : float
        Side of a square leg under the top, or radius of the pillar, m.
    apron : float
        Height of the boards between the legs, m; 0 for none. Unused with a pillar.
    overhang : float
        Overhang of the top beyond the legs, m.
    taper : float
        Size of a leg at the floor, relative to its size under the top.
    shape : str
        Shape of the top: "rectangle" or "oval" (round if length and width are equal).
    base : str
        "legs", four, or "pillar", one with a round foot.
    bevel : float
        Radius of rounded edges, m; 0 leaves them sharp.
    """
    order.choice(("rectangle", "oval"), shape=shape)
    order.choice(("legs", "pillar"), base=base)
    order.between(width, 4 * width, "1 to 4 widths", length=length)
    order.between(0.2 * width, 3 * width, "0.2 to 3 widths", height=height)
    order.between(0.01 * length, 0.25 * height, "a top that bears itself", top=top)
    order.between(0.02 * length, 0.15 * width, "2 % of the length to 15 % of the width", leg_size=leg_size)
    order.between(0.4, 1.0, "sizes of a leg", taper=taper)
    order.between(0, 0.15 * width, "so that the legs stay apart", overhang=overhang)
    order.between(0, 0.5 * (height - top), "half the height under the top", apron=apron)
    order.between(0, 0.2 * min(top, taper * leg_size), "a fifth of top and leg", bevel=bevel)

    look = Look.of(order, max(length, width, height))
    spacing = look.size / 40
    if shape == "rectangle":
        outline = rectangle(length, width, 4 * bevel)
        corner = np.array([length, width]) / 2 - overhang - leg_size / 2
    else:
        outline = polygon(TOP_SIDES, 0.5) * [length, width]
        # Legs stand on the oval's diagonal.
        corner = (np.array([length, width]) / 2 - overhang - leg_size / 2) / np.sqrt(2)
    plate = prism([outline], top, spacing, bevel, 1).translate((0, 0, height - top))
    middle = np.array([0, 0, height - top / 2])
    cover = timber(look, 31, middle, np.eye(3), width, SEAM)
    parts = [PaintedPart.of(plate, cover)]

    under = height - top
    if base == "pillar":
        parts += _pillar(look, min(length, width), under, top, leg_size, spacing, bevel)
        return assemble(union(parts), parts, look, order.texture_size)

    for k, quarter in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        foot = [*(corner * quarter), 0.0]
        parts.append(leg(look, 11 + k, foot, under + SUNK * top, leg_size, spacing, bevel, taper))
    if apron > 0:
        # Set back behind the legs, and sunk into legs and top.
        half = 0.17 * leg_size
        x, y = corner
        low, high = under - apron, under + 0.5 * top
        for k, sign in enumerate((-1, 1)):
            for j, (end, off) in enumerate((((x, half), (0, sign * y)), ((half, y), (sign * x, 0)))):
                first = [off[0] - end[0], off[1] - end[1], low]
                second = [off[0] + end[0], off[1] + end[1], high]
                parts.append(board(look, 21 + 2 * k + j, first, second, spacing, min(bevel, 0.1 * half)))
    return assemble(union(parts), parts, look, order.texture_size)


def _pillar(
    look: Look, across: float, under: float, top: float, radius: float, spacing: float, bevel: float
) -> list[PaintedPart]:
    """Build a turned pillar on a round foot, with a collar under the top."""
    foot = 0.6 * top + 0.01 * across
    collar = 0.4 * foot
    disc = prism([polygon(TOP_SIDES, 0.30 * across)], foot, spacing, 4 * bevel)
    plate = prism([polygon(TOP_SIDES, 2.2 * radius)], 1.5 * collar, spacing, bevel)
    pillar = bar((0, 0, 0.5 * foot), (0, 0, under + SUNK * top), (2.0 * radius, 1.7 * radius), spacing, 48)
    plate = plate.translate((0, 0, under - collar))
    level, upright = np.eye(3), np.eye(3)[:, [2, 0, 1]]
    return [
        PaintedPart.of(disc, timber(look, 11, np.array([0, 0, foot / 2]), level, 0.6 * across)),
        PaintedPart.of(plate, timber(look, 14, np.array([0, 0, under]), level, 4 * radius)),
        PaintedPart.of(pillar, timber(look, 15, np.array([0, 0, under / 2]), upright, 2 * radius)),
    ]


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
    plate = prism([polygon(SEAT_SIDES, diameter / 2)], seat, diameter / 24, 0.3 * seat)

    def hollow(points: np.ndarray) -> np.ndarray:
        r = np.hypot(points[:, 0], points[:, 1]) / (0.45 * diameter)
        depth = dish * np.clip(1 - r**2, 0, 1) ** 2
        return points - np.outer(depth * points[:, 2] / seat, [0, 0, 1])

    plate = plate.warp_batch(hollow).translate((0, 0, under))
    cover = timber(look, 21, np.array([0, 0, height - seat / 2]), np.eye(3), diameter)
    parts = [PaintedPart.of(plate, cover)]

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


@generator("wood")
def shelf(
    order: Order, width: Size = 0.8, depth: Size = 0.3, height: Size = 1.2, board_thickness: Size = 0.022,
    back: float = 0.010, bays: int = 4, front: str = "open", plinth: float = 0.05, bevel: float = 0.0015,
    joined: bool = True,
) -> TexturedMesh:  # fmt: skip
    """Build a bookcase, a cabinet or a chest of drawers, its front towards -y.

    One closed surface if joined; x from -width / 2 to width / 2, y of the case from -depth / 2 to depth /
    2.

    Parameters
    ----------
    width, depth, height : float
        Dimensions of the case along x, y and z, m.
    board_thickness : float
        Thickness of sides, shelves, doors and fronts, m.
    back : float
        Thickness of the back panel, m; 0 for none.
    bays : int
        Number of bays, one above the other, 1 to 8.
    front : str
        "open"; "doors", two with knobs; or "drawers", one per bay. Doors and drawers are fixed to the case;
        gaps beside them open the bays.
    plinth : float
        Height of the lowest board above the floor, m.
    bevel : float
        Radius of rounded edges, m; 0 leaves them sharp.
    joined : bool
        Whether the boards are united; otherwise each is a closed piece of its own, and they overlap.
    """
    order.choice(FRONTS, front=front)
    order.count(1, 8, bays=bays)
    t = board_thickness
    largest = max(width, depth, height)
    order.between(0.012 * largest, 0.12 * min(width, depth), "a board for that case", board_thickness=t)
    order.between(0, 2 * t, "twice the boards' thickness", back=back)
    order.between(0, 0.3 * height, "30 % of the height", plinth=plinth)
    order.between(plinth + (bays + 1) * t + bays * 3 * t, np.inf, "room for those bays", height=height)
    order.between(0, 0.1 * t, "a tenth of the boards' thickness", bevel=bevel)
    if back > 0:
        order.between(0.3 * t, 2 * t, "0.3 to 2 thicknesses of the boards", back=back)

    look = Look.of(order, largest)
    spacing = largest / {"open": 28, "doors": 24, "drawers": 17}[front]
    x, y = width / 2, depth / 2
    parts = [
        board(look, 1, (-x, -y, 0), (-x + t, y, height), spacing, bevel),
        board(look, 2, (x - t, -y, 0), (x, y, height), spacing, bevel),
    ]
    levels = shelf_levels(height, t, bays, plinth)
    reach = x - (1 - LAP) * t
    inset = 0.1 * t  # shelves and back stay behind the edges of the sides
    for k, z in enumerate(levels):
        first, second = (-reach, -y + inset, z), (reach, y - inset, z + t)
        parts.append(board(look, 3 + k, first, second, spacing, bevel))
    if back > 0:
        first = (-reach, y - 2 * inset - back, levels[0] + LAP * t)
        second = (reach, y - 2 * inset, levels[-1] + LAP * t)
        parts.append(board(look, 13, first, second, spacing, min(bevel, 0.1 * back)))
    if front != "open":
        parts += _fronts(look, front, width, y, levels, t, spacing, bevel)
    solid = union(parts) if joined else [part.solid for part in parts]
    return assemble(solid, parts, look, order.texture_size)


def shelf_levels(height: float, thickness: float, bays: int, plinth: float) -> np.ndarray:
    """Return the heights (bays + 1,) of the level boards, m, for equal bays and protruding sides."""
    top = height - 1.2 * thickness
    return plinth + (top - plinth) * np.arange(bays + 1) / bays


def _fronts(
    look: Look, front: str, width: float, y: float, levels: np.ndarray, t: float, spacing: float, bevel: float
) -> list[PaintedPart]:
    """Build doors or drawer fronts with knobs, half a board deep in the sides of the case."""
    gap = GAP * look.size
    near, far = -y - (1 - LAP) * t, -y + LAP * t
    edge = width / 2 - 0.1 * t
    low, high = levels[0] + 0.1 * t, levels[-1] + 0.9 * t
    panels, knobs = [], []
    if front == "doors":
        panels = [((-edge, low), (-gap / 2, high)), ((gap / 2, low), (edge, high))]
        knobs = [(sign * (gap / 2 + 1.6 * t), low + 0.55 * (high - low)) for sign in (-1, 1)]
    else:
        # The gap is above each board, where it opens the bay.
        starts = levels[:-1] + t + gap
        stops = np.append(levels[1:-1] + t, high)
        panels = [((-edge, a), (edge, b)) for a, b in zip(starts, stops)]
        knobs = [(sign * 0.25 * width, (a + b) / 2) for a, b in zip(starts, stops) for sign in (-1, 1)]
    parts = [
        board(look, 14 + k, (a[0], near, a[1]), (b[0], far, b[1]), spacing, bevel)
        for k, (a, b) in enumerate(panels)
    ]
    radius = 0.75 * t
    knob = prism([polygon(20, radius)], 1.5 * t, spacing, 0.35 * radius, 2).rotate((90, 0, 0))
    for k, (at, z) in enumerate(knobs):
        grain = timber(look, 24 + k, np.array([at, near, z]), np.eye(3)[:, [1, 0, 2]], 2 * radius)
        parts.append(PaintedPart.of(knob.translate((at, near + 0.5 * t, z)), grain))
    return parts
