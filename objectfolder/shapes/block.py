"""Blocks: plain, with holes through them or into them, or with studs on top; standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.atlas import Paint
from objectfolder.shapes.boards import timber
from objectfolder.shapes.extrusion import polygon, prism, rectangle
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.texture import over

RELIEFS = ("plain", "holes", "studs")
HOLES = ("round", "square", "hexagon", "star", "mixed")


@generator("wood")
def block(
    order: Order, length: Size = 0.12, width: Size = 0.12, height: Size = 0.05, relief: str = "holes",
    rows: int = 3, columns: int = 3, diameter: Size = 0.022, depth: float | None = None, hole: str = "round",
    rounding: float = 0.003,
) -> TexturedMesh:  # fmt: skip
    """Build a block, optionally with a grid of holes or studs.

    One closed surface; x and y about 0, z from 0.

    Parameters
    ----------
    length, width, height : float
        Dimensions along x, y and z, m, without studs.
    relief : str
        "plain", "holes" or "studs".
    rows, columns : int
        Size of the grid along y and x, 1 to 6.
    diameter : float
        Diameter of a stud, or of the circle around a hole, m.
    depth : float, optional
        Depth of a hole, m, default: through the block; or height of a stud, default: 40 % of its diameter.
    hole : str
        Shape: "round", "square", "hexagon", "star", or these four in turn, "mixed".
    rounding : float
        Radius of the edges, m; 0 leaves them sharp.
    accent : str, optional
        Colour inside the holes, or of the studs; default: the block's own, darker in a hole.
    """
    order.choice(RELIEFS, relief=relief)
    order.choice(HOLES, hole=hole)
    order.count(1, 6, rows=rows, columns=columns)
    accent = order.accent
    least, most = min(length, width, height), max(length, width, height)
    order.between(0, 12 * least, "no longer than 12 times its least side", size=most)
    order.between(0, 0.2 * least, "a fifth of the least side", rounding=rounding)
    if relief != "plain":
        pitch = min(length / columns, width / rows)
        order.between(0.2 * pitch, 0.8 * pitch, "20 % to 80 % of the pitch of the grid", diameter=diameter)
        room = min(0.2 * (pitch - diameter), 0.15 * diameter)
        order.between(0, room, "so that neighbouring edges stay apart", rounding=rounding)
    through = depth is None or (relief == "holes" and depth == height)
    if depth is not None and relief != "plain" and not through:
        deepest = height - 2 * rounding - 0.02 * height if relief == "holes" else diameter
        flattest = 2.2 * rounding + 0.02 * height
        order.between(flattest, deepest, "a hole with a floor, or a low stud", depth=depth)

    look = Look.of(order, most, accent=None)
    spacing = most / 32
    middle = np.array([0, 0, height / 2])
    long = 0 if length >= width else 1
    skin = timber(look, 1, middle, np.eye(3)[:, [long, 1 - long, 2]] * [1, 1 - 2 * long, 1], 0.1)
    outline = rectangle(length, width, 2 * rounding)
    centres = grid(length, width, rows, columns)
    if relief != "holes":
        parts = [PaintedPart.of(prism([outline], height, spacing, rounding, 2), skin)]
        if relief == "studs":
            rise = 0.4 * diameter if depth is None else depth
            sunk = 0.5 * height
            stud = prism([polygon(40, diameter / 2)], rise + sunk, spacing, min(rounding, 0.3 * rise), 2)
            cover = skin if accent is None else look.dye(accent).paint()
            parts += [PaintedPart.of(stud.translate((x, y, height - sunk)), cover) for x, y in centres]
        return assemble(union(parts), parts, look, order.texture_size)

    shapes = [_shape(hole, k, diameter / 2) for k in range(len(centres))]
    bored = [shape[::-1] + centre for shape, centre in zip(shapes, centres)]
    inside = None if accent is None else look.dye(accent).paint()
    cover = _paint_holes(skin, centres, diameter / 2, rounding, height, inside)
    parts = [PaintedPart.of(prism([outline, *bored], height, spacing, rounding, 2), cover)]
    if depth is not None and not through:
        # A plug wider than the hole's rounded rim but narrower than the pitch.
        grow = 1 + 0.5 * (pitch - diameter) / diameter
        floor = height - depth
        for shape, centre in zip(shapes, centres):
            plug = prism([shape * grow], floor, spacing).translate((*centre, 0))
            parts.append(PaintedPart.of(plug, cover))
    return assemble(union(parts), parts, look, order.texture_size)


def grid(length: float, width: float, rows: int, columns: int) -> np.ndarray:
    """Return the centres (rows * columns, 2) of equal cells of a rectangle about the origin, m."""
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * length
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * width
    return np.stack(np.meshgrid(x, y), 2).reshape(-1, 2)


def _shape(hole: str, place: int, radius: float) -> np.ndarray:
    """Return the outline (N, 2), counter-clockwise, of the hole at one place."""
    kind = HOLES[place % 4] if hole == "mixed" else hole
    if kind == "star":
        points = polygon(10, radius, np.pi / 2)
        points[1::2] *= 0.62
        return points
    sides, turn = {"round": (32, 0.0), "square": (4, np.pi / 4), "hexagon": (6, 0.0)}[kind]
    return polygon(sides, radius, turn)


def _paint_holes(
    skin: Paint, centres: np.ndarray, radius: float, rounding: float, height: float, inside: Paint | None
) -> Paint:
    """Return the paint of a block whose holes have another colour below their rims."""

    def paint(points: np.ndarray) -> np.ndarray:
        colour = skin(points)
        apart = np.min([np.hypot(*(points[:, :2] - centre).T) for centre in centres], axis=0)
        rim = max(0.5 * rounding, 0.004 * height)
        deep = (apart < 1.02 * radius) & (points[:, 2] > rim) & (points[:, 2] < height - rim)
        shade = 0.55 * colour if inside is None else inside(points)
        return over(colour, shade, 1.0 * deep)

    return paint
