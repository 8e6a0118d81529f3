"""Parts that appliances have in common: turned bodies, knobs, slots, rings; in sizes of the object."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.extrusion import extrude_y, prism, rectangle
from objectfolder.shapes.parameters import Order
from objectfolder.shapes.section import resample_evenly, resample_rows, round_polyline
from objectfolder.shapes.sweep import tube

SPACING = 1 / 30  #: distance between vertices of flats
DARK, METAL = "2e2f33", "b9bdc2"
SEGMENTS = 56  #: facets of a full circle

#: Points (N, 3) in sizes of the object and colours (N, 3) -> decorated colours (N, 3).
Decor = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass
class Kit:
    """Parts of an object, in its sizes: what is cut from the bodies leaves the details whole.

    Each method takes a colour, hexadecimal or None for that of the finish, solids, and how to paint them:
    the ``axis`` of the grain, None to turn it about z; the number of the ``piece`` of material; and
    ``decor``, painted over the finish.
    """

    look: Look
    bodies: list[PaintedPart] = field(default_factory=list)
    cuts: list[PaintedPart] = field(default_factory=list)
    details: list[PaintedPart] = field(default_factory=list)

    def body(self, color: str | None, *solids: manifold3d.Manifold, **how: Any) -> None:
        """Add solids to the bodies."""
        self.bodies += [self._paint(solid, color, **how) for solid in solids]

    def cut(self, color: str | None, *solids: manifold3d.Manifold, **how: Any) -> None:
        """Cut solids from the bodies; the cuts have their colour."""
        self.cuts += [self._paint(solid, color, **how) for solid in solids]

    def detail(self, color: str | None, *solids: manifold3d.Manifold, **how: Any) -> None:
        """Add solids that nothing is cut from."""
        self.details += [self._paint(solid, color, **how) for solid in solids]

    def _paint(
        self, solid: manifold3d.Manifold, color: str | None, axis: Sequence[float] | None = (1.0, 0.0, 0.0),
        piece: int = 0, decor: Decor | None = None,
    ) -> PaintedPart:  # fmt: skip
        """Scale a solid to m, and dye it."""
        size = self.look.size
        plain = self.look.dye(color).paint(axis, piece)

        def paint(points: np.ndarray) -> np.ndarray:
            colour = plain(points)
            return colour if decor is None else decor(points / size, colour)

        return PaintedPart.of(solid.scale((size, size, size)), paint)

    def build(self, texture_size: int) -> TexturedMesh:
        """Unite the bodies, cut them, add the details, and paint the surface."""
        whole = union(self.bodies)
        if self.cuts:
            whole = whole - union(self.cuts)
        added = [PaintedPart(whole, self.bodies[0].paint), *self.details]
        return assemble(union(added), [*self.bodies, *self.cuts, *self.details], self.look, texture_size)


Maker = Callable[[Kit, float], None]  #: adds the parts of an object, which may be plumper, to its kit


def build_kind(
    order: Order, kind: str, makers: Mapping[str, tuple[Maker, str, str]], span: float, plump: float, why: str
) -> TexturedMesh:
    """Build one of several kinds, each a maker with the colour and the accent where none is ordered."""
    order.choice(list(makers), kind=kind)
    order.between(0.8, 1.25, why, plump=plump)
    make, body, trim = makers[kind]
    kit = Kit(Look.of(order, span, color=order.color or body, accent=order.accent or trim))
    make(kit, plump)
    return kit.build(order.texture_size)


def turn_profile(profile: ArrayLike, coarse: float = 1e-3) -> manifold3d.Manifold:
    """Revolve a profile (N, 2) of radius and height, from the lower to the upper axis, about z.

    ``coarse`` is the allowed deviation from the profile, in its sizes.
    """
    dense = np.asarray(profile, np.float64)
    return manifold3d.CrossSection([resample_rows(dense, dense, coarse)]).revolve(SEGMENTS)


def torus(radius: float, wire: float, segments: int = 16) -> manifold3d.Manifold:
    """Build a ring about z, of a round wire of diameter ``wire``; ``radius`` is that of its middle."""
    middle = manifold3d.CrossSection.circle(wire / 2, segments).translate((radius, 0.0))
    return middle.revolve(SEGMENTS)


def loop(
    corners: ArrayLike, bend: float, width: float, thickness: float, squareness: float = 2.0
) -> manifold3d.Manifold:
    """Sweep a handle, ``width`` along y, along a polyline (N, 2) in x and z with bends of radius ``bend``."""
    corners = np.asarray(corners, np.float64)
    path = resample_evenly(round_polyline(corners, np.full(len(corners) - 2, bend)), 44)
    spatial = np.stack([path[:, 0], 0 * path[:, 0], path[:, 1]], 1)
    return tube(spatial, width, thickness, (0.0, 1.0, 0.0), 20, squareness)


def bars(
    lengths: Sequence[float], width: float, pitch: float, depth: float, bevel: float = 0.0
) -> manifold3d.Manifold:
    """Build level bars with round ends, one above the other, about the origin, ``depth`` long along y."""
    rise = pitch * (np.arange(len(lengths)) - (len(lengths) - 1) / 2)
    tools = []
    for length, z in zip(lengths, rise):
        tool = extrude_y([rectangle(length, width, width / 2, 4)], depth, SPACING, bevel, 2)
        tools.append(tool.translate((0.0, 0.0, float(z))))
    return manifold3d.Manifold.batch_boolean(tools, manifold3d.OpType.Add)


def knob(radius: float, height: float, flutes: int = 10, turn: float = 0.0) -> manifold3d.Manifold:
    """Build a fluted knob on the plane y = 0 that faces -y, its pointer turned by degrees from upright.

    It reaches one tenth of its height below the plane.
    """
    angle = 2 * np.pi * np.arange(6 * flutes) / (6 * flutes)
    r = radius * (0.97 + 0.03 * np.cos(flutes * angle))
    outline = np.stack([r * np.cos(angle), r * np.sin(angle)], 1)
    base = extrude_y([outline], height, SPACING, min(0.12 * radius, 0.3 * height), 2)
    ridge = extrude_y([rectangle(0.22 * radius, 0.8 * radius, 0.1 * radius, 3)], 0.4 * height, SPACING)
    ridge = ridge.translate((0.0, -0.5 * height, 0.45 * radius)).rotate((0.0, turn, 0.0))
    return (base + ridge).translate((0.0, -0.4 * height, 0.0))


def rounded_disc(radius: float, height: float, bevel: float, segments: int = SEGMENTS) -> manifold3d.Manifold:
    """Build a disc from z = 0 to ``height`` with rounded edges."""
    angle = 2 * np.pi * np.arange(segments) / segments
    return prism([radius * np.stack([np.cos(angle), np.sin(angle)], 1)], height, SPACING, bevel)
