"""Tables: rectangular or oval top, on four legs with an apron or on a pillar; standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.boards import board, leg, timber
from objectfolder.shapes.extrusion import polygon, prism, rectangle
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import bar

SEAM = 0.002  #: width of the joints between the planks of the top, m
SUNK = 0.6  #: depth of a leg's end in the top, in thicknesses of the top
SIDES = 96  #: facets around an oval top


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
        outline = polygon(SIDES, 0.5) * [length, width]
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
    disc = prism([polygon(SIDES, 0.30 * across)], foot, spacing, 4 * bevel)
    plate = prism([polygon(SIDES, 2.2 * radius)], 1.5 * collar, spacing, bevel)
    pillar = bar((0, 0, 0.5 * foot), (0, 0, under + SUNK * top), (2.0 * radius, 1.7 * radius), spacing, 48)
    plate = plate.translate((0, 0, under - collar))
    level, upright = np.eye(3), np.eye(3)[:, [2, 0, 1]]
    return [
        PaintedPart.of(disc, timber(look, 11, np.array([0, 0, foot / 2]), level, 0.6 * across)),
        PaintedPart.of(plate, timber(look, 14, np.array([0, 0, under]), level, 4 * radius)),
        PaintedPart.of(pillar, timber(look, 15, np.array([0, 0, under / 2]), upright, 2 * radius)),
    ]
