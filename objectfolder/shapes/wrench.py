"""Wrenches: a forged bar with open jaws, a ring, or one of each, in metres, lying flat on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.extrusion import polygon, prism, rectangle
from objectfolder.shapes.parameters import Order, Size, generator

ENDS = ("combination", "open", "ring")
JAW_ANGLE = np.deg2rad(15)  #: between open jaws and the bar
JAW, RING = 1.08, 0.82  #: radii of the heads, in widths across the flats
HEAD = 1.3  #: thickness of a head, in thicknesses of the bar
RECESS = 0.14  #: depth of the panels in the bar, in its thicknesses
SMALL = 0.85  #: relative size of the second of two like ends


@generator("brushed")
def wrench(
    order: Order, length: Size = 0.18, flats: Size = 0.015, thickness: Size = 0.006,
    ends: str = "combination",
) -> TexturedMesh:  # fmt: skip
    """Build a wrench.

    One closed surface along x about the origin, its lower side on z = 0.

    Parameters
    ----------
    length : float
        Distance between the centres of the heads, m.
    flats : float
        Width across flats of the matching nut, m; the second of two like ends is smaller.
    thickness : float
        Thickness of the bar outside its recessed panels, m; heads are thicker.
    ends : str
        "combination" of open jaws and a ring, "open" or "ring" at both ends.
    """
    order.choice(ENDS, ends=ends)
    order.between(6 * flats, 30 * flats, "6 to 30 widths of the nut", length=length)
    order.between(0.2 * flats, 0.7 * flats, "20 % to 70 % of the nut's width", thickness=thickness)

    look = Look.of(order, length + 2 * flats)
    spacing = length / 60
    kinds = {"combination": ("open", "ring"), "open": ("open", "open"), "ring": ("ring", "ring")}[ends]
    sizes = (flats, flats if ends == "combination" else SMALL * flats)
    middles = (-length / 2, length / 2)
    radii = [(JAW if kind == "open" else RING) * s for kind, s in zip(kinds, sizes)]

    # Silhouette: two heads and a tapering bar, hollow corners rounded.
    half = 0.40 * flats, 0.34 * sizes[1]
    (left, right), (thick, slim) = middles, half
    bar = np.array([[left, -thick], [right, -slim], [right, slim], [left, thick]])
    shape = manifold3d.CrossSection([bar])
    for x, radius in zip(middles, radii):
        shape += manifold3d.CrossSection([polygon(72, radius) + np.array([x, 0])])
    fillet = 0.8 * flats
    shape = shape.offset(fillet, manifold3d.JoinType.Round, circular_segments=64)
    shape = shape.offset(-fillet, manifold3d.JoinType.Round, circular_segments=64).simplify(1e-3 * flats)
    lift = (HEAD - 1) / 2 * thickness
    body = prism(_rings(shape), thickness, spacing, 0.22 * thickness).translate((0, 0, lift))
    metal = look.paint((1, 0, 0))
    parts, cuts = [PaintedPart.of(body, metal)], []
    for k, (kind, x, radius, s) in enumerate(zip(kinds, middles, radii, sizes)):
        head = prism([polygon(72, 1.03 * radius)], HEAD * thickness, spacing, 0.2 * thickness, 2)
        parts.append(PaintedPart.of(head.translate((x, 0, 0)), metal))
        outline = _jaws(s, radius, k) if kind == "open" else _star(s)
        bite = prism(_rings(outline), 2 * HEAD * thickness, spacing)
        cuts.append(PaintedPart.of(bite.translate((x, 0, -0.5 * HEAD * thickness)), metal))
    # Panels on both sides of the bar.
    ends_of_bar = middles[0] + 1.6 * radii[0], middles[1] - 1.6 * radii[1]
    span, across = ends_of_bar[1] - ends_of_bar[0], 0.8 * min(half)
    depth = RECESS * thickness
    panel = prism([rectangle(span, across, 0.45 * across)], 2 * depth, spacing)
    dull = look.dye(look.accent or "5f6468").paint((1, 0, 0), 1)
    for z in (lift - depth, lift + thickness - depth):
        cuts.append(PaintedPart.of(panel.translate((np.mean(ends_of_bar), 0, z)), dull))
    return assemble(union(parts) - union(cuts), [*parts, *cuts], look, order.texture_size)


def _rings(shape: manifold3d.CrossSection) -> list[np.ndarray]:
    return [np.asarray(ring, np.float64) for ring in shape.to_polygons()]


def _jaws(size: float, radius: float, end: int) -> manifold3d.CrossSection:
    """Build the slot of the first (0) or second (1) end, open away from the bar."""
    turn = np.pi * (1 - end) + JAW_ANGLE
    shift = np.array([1.25 * radius - 0.1 * size, 0])
    slot = manifold3d.CrossSection([rectangle(2.5 * radius, size) + shift])
    seat = manifold3d.CrossSection([polygon(6, size / np.sqrt(3))])
    return (slot + seat).rotate(np.rad2deg(turn))


def _star(size: float) -> manifold3d.CrossSection:
    """Build a hole with twelve points, for hexagons in two orientations."""
    hexagons = [manifold3d.CrossSection([polygon(6, size / np.sqrt(3), k * np.pi / 6)]) for k in (0, 1)]
    return hexagons[0] + hexagons[1]
