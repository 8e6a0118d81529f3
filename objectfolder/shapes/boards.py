"""Timber of furniture: boards and legs with their grain."""

from collections.abc import Sequence

import numpy as np

from objectfolder.shapes.assembly import Look, PaintedPart
from objectfolder.shapes.atlas import Paint
from objectfolder.shapes.extrusion import prism, rectangle
from objectfolder.shapes.texture import over, stroke

#: Position of the pith in ``finish``, across a grain along x, in sizes of the object.
PITH = (0.62, -0.50)
#: Axis of the trunk in a board's frame (along, across, through); tilted, so that rings form arches.
TRUNK = (1.0, 0.02, 0.07)
PLANK = 0.15  #: approximate width of the planks that wide boards are glued from, m


def timber(
    look: Look, piece: int, middle: np.ndarray, axes: np.ndarray, width: float, seam: float = 0.0
) -> Paint:
    """Return the paint of a board sawn near the pith; wide boards are glued from several planks.

    ``piece`` selects the place that the board is sawn from; ``middle`` (3,) is its centre, m; the columns of
    ``axes`` (3, 3) run along, across and through it; ``seam`` is the width, m, of open joints between planks.
    """
    if look.finish != "wood":
        return look.paint(axes[:, 0], piece)
    count = max(1, round(width / PLANK))
    each = width / count
    chance = np.random.default_rng([look.seed, piece])
    place = np.array([0.5, 0.35 * each, 0.03]) * chance.uniform(-1, 1, (count, 3)) + [0, 0, 0.07]
    shifts = place + np.array([0, *PITH]) * look.size
    grown = [look.paint(TRUNK, 100 * piece + k) for k in range(count)]

    def paint(points: np.ndarray) -> np.ndarray:
        local = (points - middle) @ axes
        across = local[:, 1] / each + count / 2
        index = np.clip(np.floor(across).astype(int), 0, count - 1)
        local[:, 1] -= (index - (count - 1) / 2) * each
        colour = np.empty(points.shape)
        for k in range(count):
            colour[index == k] = grown[k](local[index == k] + shifts[k])
        if seam == 0 or count == 1:
            return colour
        joint = (across - np.clip(np.round(across), 1, count - 1)) * each
        return over(colour, 0.35 * colour, 0.8 * stroke(joint, seam / 2, seam))

    return paint


def board(
    look: Look, piece: int, low: Sequence[float], high: Sequence[float], spacing: float, bevel: float = 0.0
) -> PaintedPart:
    """Build an axis-aligned board between two corners, m, its grain along its longest side.

    Vertices are about ``spacing`` apart; ``bevel`` is the width of chamfered edges, m.
    """
    size = np.subtract(high, low)
    thin = int(np.argmin(size))
    wide, long = sorted((k for k in range(3) if k != thin), key=lambda k: size[k])
    axes = np.eye(3)[:, [long, wide, thin]]
    axes[:, 1] *= np.linalg.det(axes)
    # Corners are twice as round as edges, so that they remain after edges are rounded.
    plate = prism([rectangle(size[long], size[wide], 2 * bevel, 3)], size[thin], spacing, bevel, 1)
    middle = np.add(low, high) / 2
    plate = plate.transform(np.column_stack([axes, middle - size[thin] / 2 * axes[:, 2]]))
    return PaintedPart.of(plate, timber(look, piece, middle, axes, size[wide]))


def leg(
    look: Look, piece: int, foot: Sequence[float], height: float, size: float, spacing: float, bevel: float,
    taper: float = 1.0,
) -> PaintedPart:  # fmt: skip
    """Build a square leg, m, standing on ``foot``, where it tapers to ``taper`` of its size."""
    post = prism([rectangle(size, size, 2 * bevel, 3)], height, spacing, bevel, 1)

    def narrow(points: np.ndarray) -> np.ndarray:
        scale = taper + (1 - taper) * points[:, 2:] / height
        return np.hstack([points[:, :2] * scale, points[:, 2:]])

    post = post.warp_batch(narrow).translate([float(x) for x in foot])
    middle = np.add(foot, [0, 0, height / 2])
    return PaintedPart.of(post, timber(look, piece, middle, np.eye(3)[:, [2, 0, 1]], size))
