"""Cross-sections of turned vessels: walls of even thickness, feet and stems, with rounded edges.

Lengths are in m; x is the radius and y the height. Sections are mirrored about the axis, which keeps them
smooth there.
"""

from itertools import pairwise

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from objectfolder.base.errors import ObjectFolderError
from objectfolder.shapes.revolution import arc_length, points_along

SLIVER = 1e-6  #: width, m, of the strip that represents a curve before it is thickened
ARC = 160  #: segments of a full circle in rounded corners
COARSE = 4e-4  #: largest distance between chords and curve, in sizes of the section
STEP = 0.055  #: longest segment of a profile, in sizes of the section


def round_polyline(corners: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Round the inner corners of a polyline ``corners`` (N, 2) with arcs of ``radii`` (N - 2,).

    An arc uses at most half of each adjacent segment.
    """
    pieces = [corners[:1]]
    for before, corner, after, radius in zip(corners, corners[1:], corners[2:], radii):
        back, on = before - corner, after - corner
        reach = np.linalg.norm(back), np.linalg.norm(on)
        back, on = back / reach[0], on / reach[1]
        half = np.arccos(np.clip(back @ on, -1, 1)) / 2
        if half > np.pi / 2 - 1e-6:  # straight on
            continue
        tangent = min(radius / np.tan(half), 0.499 * min(reach))
        radius = tangent * np.tan(half)
        middle = (back + on) / np.linalg.norm(back + on)
        centre = corner + radius / np.sin(half) * middle
        # From one tangent point to the other, about the centre.
        sweep = np.linspace(-1, 1, 25) * (np.pi / 2 - half)
        across = np.array([-middle[1], middle[0]])
        side = np.sign(across @ on)
        away = -np.cos(sweep)[:, None] * middle + side * np.sin(sweep)[:, None] * across
        pieces.append(centre + radius * away)
    return np.concatenate([*pieces, corners[-1:]])


def resample_evenly(curve: np.ndarray, pieces: int = 400) -> np.ndarray:
    """Resample a polyline (N, 2) at even distances; (pieces + 1, 2)."""
    return points_along(curve, np.linspace(0, arc_length(curve)[-1], pieces + 1))


def round_solid(half: np.ndarray) -> manifold3d.CrossSection:
    """Build the section between the axis and a polyline (N, 2) that starts and ends at or near it."""
    ring = np.concatenate([half * [-1, 1], half[::-1]])
    return manifold3d.CrossSection([ring], manifold3d.FillRule.NonZero)


def ring(corners: ArrayLike) -> manifold3d.CrossSection:
    """Build the section of a ring from a polygon (N, 2) off the axis."""
    polygon = np.asarray(corners, np.float64)
    return manifold3d.CrossSection([polygon, polygon * [-1, 1]], manifold3d.FillRule.NonZero)


def wall_about(middle: np.ndarray, thickness: float) -> manifold3d.CrossSection:
    """Build a wall of even thickness about a curve (N, 2) that starts on the axis, its free end round."""
    middle = resample_evenly(middle)
    whole = np.concatenate([middle[:0:-1] * [-1, 1], middle])
    along = np.gradient(whole, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
    left, right = whole + normal * SLIVER / 2, whole - normal * SLIVER / 2
    thin = manifold3d.CrossSection([np.concatenate([left, right[::-1]])], manifold3d.FillRule.NonZero)
    return offset(thin, (thickness - SLIVER) / 2)


def ring_under(middle: np.ndarray, radius: float, width: float) -> manifold3d.CrossSection:
    """Build a foot ring of outer ``radius`` and ``width`` from z = 0 up to the wall's curve (N, 2)."""
    r = np.linspace(radius - width, radius, 24)
    below = np.stack([r, np.interp(r, *middle[: int(np.argmax(middle[:, 0])) + 1].T)], 1)
    return ring(np.concatenate([[[radius - width, 0.0], [radius, 0.0]], below[::-1]]))


def soften(
    section: manifold3d.CrossSection, concave: float = 0.0, convex: float = 0.0
) -> manifold3d.CrossSection:
    """Round inner corners with radius ``concave``, then outer corners with radius ``convex``, m."""
    if concave > 0:
        section = offset(offset(section, concave), -concave)
    if convex > 0:
        section = offset(offset(section, -convex), convex)
    return section


def offset(section: manifold3d.CrossSection, distance: float) -> manifold3d.CrossSection:
    """Offset the outline outward by a distance, m, inward if negative; convex corners become round."""
    return section.offset(distance, manifold3d.JoinType.Round, 2.0, ARC).simplify(SLIVER / 5)


def half_outline(section: manifold3d.CrossSection, generator: str) -> np.ndarray:
    """Return the dense profile (N, 2) of the half at positive radius, from the lower to the upper axis.

    Raises `ObjectFolderError` if the section is not one piece without holes that meets the axis once.
    """
    left, low, right, high = section.bounds()
    span = max(right - left, high - low)
    box = manifold3d.CrossSection.square((span, 3 * span)).translate((0, low - span))
    polygons = (section ^ box).to_polygons()
    points = np.asarray(polygons[0], np.float64) if len(polygons) == 1 else np.zeros((0, 2))
    on_axis = np.abs(points[:, 0]) < 1e-7
    # The axis is the edge that runs down; rounding may leave extra points on it.
    start = np.flatnonzero(on_axis & ~np.roll(on_axis, -1))
    if len(start) != 1:
        raise ObjectFolderError(
            f"{generator}: the parts of the wall meet or fall apart at these dimensions; "
            "expected a thinner wall or a wider body"
        )
    profile = np.roll(points, -start[0], axis=0)[: len(points) + 2 - on_axis.sum()]
    profile[[0, -1], 0] = 0.0
    profile[np.abs(profile[:, 1]) < SLIVER, 1] = 0.0  # exactly on the table
    return profile


def split_at_lip(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split a vessel's profile at the top of its lip into outside and inside, each with even rows."""
    lip = int(np.argmax(profile[:, 1]))
    return resample_rows(profile[: lip + 1], profile), resample_rows(profile[lip:], profile)


def resample_rows(part: np.ndarray, whole: np.ndarray, coarse: float = COARSE) -> np.ndarray:
    """Resample ``part`` (N, 2), denser where it bends, keeping its lowest and widest points; (M, 2).

    Chords deviate from the curve by about ``coarse`` times the size of ``whole``.
    """
    size = np.ptp(whole * [2, 1], axis=0).max()
    stops = {0, len(part) - 1, int(np.argmin(part[:, 1])), int(np.argmax(part[:, 0]))}
    ends = sorted(stops)
    pieces = [_resample_piece(part[a : b + 1], size, coarse) for a, b in pairwise(ends)]
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def _resample_piece(curve: np.ndarray, size: float, coarse: float) -> np.ndarray:
    chord = np.diff(curve, axis=0)
    keep = np.append(True, np.linalg.norm(chord, axis=1) > 1e-9 * size)
    keep[-1] = True
    curve = curve[keep]
    chord = np.diff(curve, axis=0)
    length = np.linalg.norm(chord, axis=1)
    heading = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    turn = np.zeros(len(curve))
    turn[1:-1] = np.abs(np.diff(heading)) * np.minimum(length[1:], length[:-1])
    # A chord of length d deviates by a d / 8 from a curve that turns by a.
    bend = np.sqrt(turn / (8 * coarse * size))
    weight = np.maximum(length / (STEP * size), (bend[1:] + bend[:-1]) / 2)
    travelled = np.append(0.0, np.cumsum(weight))
    rows = np.linspace(0, travelled[-1], max(1, round(travelled[-1])) + 1)
    even = np.stack([np.interp(rows, travelled, curve[:, k]) for k in (0, 1)], 1)
    even[[0, -1]] = curve[[0, -1]]
    return even
