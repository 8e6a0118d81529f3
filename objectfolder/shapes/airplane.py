"""Airplanes: a round body with thin, tapering wings, a tail plane and a fin; standing on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import tube

TIP = 0.55  #: chord at the tip of a wing, in chords at its root
TAIL = 0.36  #: span of the tail plane, in spans of the wings
FIN = 0.17  #: height of the fin above the body's axis, in lengths
BLUNT = 0.06  #: rounded end of a wing, in half spans
STATIONS = 24  #: sections of half a wing


@generator("plastic", color="e9e4d6", accent="c8412f")
def airplane(
    order: Order, length: Size = 0.22, span: Size = 0.24, body: Size = 0.034, chord: Size = 0.05,
    wing: Size = 0.003, sweep: float = 0.02,
) -> TexturedMesh:  # fmt: skip
    """Build an airplane.

    One closed surface of genus 0, facing +x, with the body's lowest point at z = 0.

    Parameters
    ----------
    length, span : float
        Length of the body along x, and of the wings along y from tip to tip, m.
    body : float
        Diameter of the body, m.
    chord : float
        Width of a wing at its root, m.
    wing : float
        Thickness of the wings in the middle of the root, m; they are lenses in section, and half as thick
        at the tip. The tail plane and the fin are three quarters as thick.
    sweep : float
        Distance by which the tips lie behind the root, m.
    accent : str, optional
        Colour of the wings.
    """
    order.between(0.5 * length, 2 * length, "0.5 to 2 lengths", span=span)
    order.between(0.08 * length, 0.25 * length, "8 % to 25 % of the length", body=body)
    order.between(0.1 * length, 0.35 * length, "10 % to 35 % of the length", chord=chord)
    order.between(0.02 * chord, 0.4 * body, "2 % of the chord to 40 % of the body", wing=wing)
    order.between(0, 0.3 * length, "30 % of the length", sweep=sweep)

    look = Look.of(order, max(length, span))
    nose = length / 2
    t = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 48))  # closer towards both ends
    thick = body * np.sqrt(np.maximum(1 - t**2, 0.004)) * (0.72 + 0.28 * t)
    axis = np.stack([nose * t, 0 * t, body / 2 + 0.25 * (body - thick) * (t < 0)], 1)
    hull = tube(axis, thick, thick, (0.0, 1.0, 0.0), segments=40)
    hull = hull.translate((0.0, 0.0, -hull.bounding_box()[2]))

    place = np.array([0.08 * length, 0.0, 0.42 * body])
    wings = _pair(span, chord, wing, sweep).translate(tuple(place))
    stern = np.array([-nose + 0.12 * length, 0.0, 0.62 * body])
    tail = _pair(TAIL * span, 0.6 * chord, 0.75 * wing, 0.5 * sweep).translate(tuple(stern))
    # The upper half of a pair that stands on its side.
    fin = _pair(2 * FIN * length, 0.65 * chord, 0.75 * wing, 0.08 * length).rotate((90.0, 0.0, 0.0))
    fin = fin.trim_by_plane((0.0, 0.0, 1.0), 0.0).translate((stern[0], 0.0, 0.5 * body))

    fuselage = look.paint((1.0, 0.0, 0.0))
    trim = look.dye(look.accent)
    parts = [
        PaintedPart.of(hull, fuselage),
        PaintedPart.of(wings, trim.paint((0.0, 1.0, 0.0), 1)),
        PaintedPart.of(tail, trim.paint((0.0, 1.0, 0.0), 2)),
        PaintedPart.of(fin, trim.paint((0.0, 0.0, 1.0), 3)),
    ]
    return assemble(union(parts), parts, look, order.texture_size)


def _pair(span: float, chord: float, thickness: float, sweep: float) -> manifold3d.Manifold:
    """Build a pair of wings along y about the origin, in one piece."""
    half = np.sin(np.linspace(0, np.pi / 2, STATIONS))  # closer towards the tips
    y = np.concatenate([-half[::-1], half[1:]])
    out = np.abs(y)
    end = np.sqrt(np.maximum(1 - np.clip((out - 1 + BLUNT) / BLUNT, 0, 1) ** 2, 0.02))
    path = np.stack([0 * y, span / 2 * y, 0 * y], 1)
    width, height = chord * (1 - (1 - TIP) * out) * end, thickness * (1 - 0.5 * out) * np.sqrt(end)
    made = tube(path, width, height, (1.0, 0.0, 0.0), segments=36)
    return made.warp_batch(lambda p: p - np.outer(2 * sweep / span * np.abs(p[:, 1]), [1, 0, 0]))
