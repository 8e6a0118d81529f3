"""Bookcases and cabinets: boards around bays, open, with doors or drawers; standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.boards import board, timber
from objectfolder.shapes.extrusion import polygon, prism
from objectfolder.shapes.parameters import Order, Size, generator

FRONTS = ("open", "doors", "drawers")
GAP = 0.004  #: between doors or drawers, in sizes of the furniture; opens the bays
SUNK = 0.5  #: overlap of a board's end with the board it meets, in thicknesses


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
    reach = x - (1 - SUNK) * t
    inset = 0.1 * t  # shelves and back stay behind the edges of the sides
    for k, z in enumerate(levels):
        first, second = (-reach, -y + inset, z), (reach, y - inset, z + t)
        parts.append(board(look, 3 + k, first, second, spacing, bevel))
    if back > 0:
        first = (-reach, y - 2 * inset - back, levels[0] + SUNK * t)
        second = (reach, y - 2 * inset, levels[-1] + SUNK * t)
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
    near, far = -y - (1 - SUNK) * t, -y + SUNK * t
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
