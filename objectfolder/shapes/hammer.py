"""Hammers: a head with a claw, a forged club or a round mallet, on its handle; lying flat on z = 0."""

from dataclasses import replace

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble, union
from objectfolder.shapes.boards import timber
from objectfolder.shapes.extrusion import polygon, prism, rectangle
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import bar, tube

HEADS = ("claw", "club", "mallet")


@generator("brushed")
def hammer(
    order: Order, length: Size = 0.32, head_length: Size = 0.13, head_diameter: Size = 0.030,
    handle_width: Size = 0.030, head: str = "claw",
) -> TexturedMesh:  # fmt: skip
    """Build a hammer in one piece.

    One closed surface, the handle along x, its lowest point on z = 0.

    Parameters
    ----------
    length : float
        Distance from the centre of the head to the end of the handle, m.
    head_length, head_diameter : float
        Length of the head along y, and diameter of its face, m.
    handle_width : float
        Width of the grip, m.
    head : str
        "claw", "club" (eight sides, two faces) or "mallet" (a round block).
    accent : str, optional
        Colour of the handle; default: that of the head.
    """
    order.choice(HEADS, head=head)
    low, high = {"claw": (3.2, 5.5), "club": (1.6, 4.0), "mallet": (1.2, 3.0)}[head]
    d = head_diameter
    order.between(low * d, high * d, f"{low} to {high} diameters of a {head}", head_length=head_length)
    order.between(head_length, 5 * head_length, "1 to 5 lengths of the head", length=length)
    order.between(0.25 * d, 1.1 * d, "25 % to 110 % of the head's diameter", handle_width=handle_width)
    order.between(0.04 * length, 0.2 * length, "4 % to 20 % of the length", handle_width=handle_width)

    look = Look.of(order, max(length, head_length), accent=None)
    spacing = look.size / 70
    parts = {"claw": _claw, "club": _club, "mallet": _mallet}[head](look, head_length, d, spacing)
    cuts = []
    if head == "claw":
        notch = [[-0.16 * head_length, 0], [-head_length, 0.34 * d], [-head_length, -0.34 * d]]
        wedge = prism([np.array(notch)[::-1] @ np.array([[0, 1], [1, 0]])], 4 * d, spacing)
        # Outline in z and y; extruded along x.
        wedge = wedge.transform(np.array([[0, 0, 1.0, -2 * d], [0, 1.0, 0, 0], [-1.0, 0, 0, 0]]))
        cuts = [PaintedPart.of(wedge, parts[0].paint)]
    material = "wood" if look.finish == "wood" else "plastic"
    grip = look if order.accent is None else replace(look, finish=material, color=order.accent)
    handle = _handle(grip, length, 0.62 * d if head != "mallet" else 0.5 * d, handle_width, spacing)
    whole = union(parts) - union(cuts) if cuts else union(parts)
    whole = union([PaintedPart(whole, parts[0].paint), handle])
    floor = whole.bounding_box()[2]
    return assemble(whole.translate((0, 0, -floor)), [*parts, *cuts, handle], look, order.texture_size)


def _handle(look: Look, length: float, top: float, width: float, spacing: float) -> PaintedPart:
    """Build an oval handle through the head, wider at the grip, with a rounded end."""
    x = np.linspace(-0.58 * top, length, int(length / spacing) + 1)
    x = np.append(x[:-1], length - 0.28 * width * (1 - np.sin(np.linspace(0, np.pi / 2, 7)[1:])) ** 1.0)
    x = np.unique(x)
    t = np.clip(x / length, 0, 1)
    swell = 0.80 + 0.20 * np.sin(np.pi * np.clip((t - 0.30) / 0.7, 0, 1)) ** 2 + 0.12 * t**6
    wide = np.where(t < 0.3, 0.8, swell) * width
    wide = np.minimum(wide, top + (wide - top) * np.clip((x - 0.6 * top) / (0.3 * length), 0, 1))
    end = np.clip((length - x) / (0.28 * width), 0, 1)
    rounding = np.sqrt(np.maximum(1 - (1 - end) ** 2, 0.0)) * 0.45 + 0.55
    path = np.column_stack([x, np.zeros((len(x), 2))])
    # Wider in the plane of the blow, along y, than across it.
    handle = tube(path, 0.74 * wide * rounding, wide * rounding, (0, 0, 1), 32, 2.5)
    return PaintedPart.of(handle, timber(look, 1, path.mean(0), np.eye(3), width))


def _upright(
    outline: np.ndarray, start: float, stop: float, spacing: float, bevel: float
) -> manifold3d.Manifold:
    """Build a prism along y between two positions, its outline in x and z."""
    block = prism([outline], stop - start, spacing, bevel)
    return block.transform(np.array([[1.0, 0, 0, 0], [0, 0, 1.0, start], [0, -1.0, 0, 0]]))


def _mallet(look: Look, length: float, diameter: float, spacing: float) -> list[PaintedPart]:
    block = _upright(polygon(64, diameter / 2), -length / 2, length / 2, spacing, 0.08 * diameter)
    axes = np.eye(3)[:, [1, 2, 0]]
    return [PaintedPart.of(block, timber(look, 2, np.zeros(3), axes, diameter), axes)]


def _club(look: Look, length: float, diameter: float, spacing: float) -> list[PaintedPart]:
    cheek = 0.97 * diameter
    octagon = polygon(8, diameter / 2 / np.cos(np.pi / 8), np.pi / 8)
    body = _upright(octagon, -length / 2, length / 2, spacing, 0.13 * diameter)
    block = rectangle(cheek, 1.12 * cheek, 0.2 * cheek)
    waist = _upright(block, -0.17 * length, 0.17 * length, spacing, 0.06 * diameter)
    metal = look.paint((0, 1, 0), 2)
    return [PaintedPart.of(body, metal), PaintedPart.of(waist, metal)]


def _claw(look: Look, length: float, diameter: float, spacing: float) -> list[PaintedPart]:
    """Build the head: face towards +y, claw towards -y and bent towards the handle."""
    front, rear = 0.46 * length, 0.54 * length
    metal = look.paint((0, 1, 0), 2)
    face = _upright(polygon(48, diameter / 2), front - 0.55 * diameter, front, spacing, 0.07 * diameter)
    neck = bar((0, 0, 0), (0, front - 0.3 * diameter, 0), (0.78 * diameter, 0.72 * diameter), spacing, 40)
    block = rectangle(0.98 * diameter, 0.92 * diameter, 0.18 * diameter)
    cheek = _upright(block, -0.55 * diameter, 0.55 * diameter, spacing, 0.1 * diameter)
    t = np.linspace(0, 1, 28)
    y = -rear * (0.02 + 0.98 * np.sin(t * np.pi / 2 * 0.92) / np.sin(np.pi / 2 * 0.92))
    bend = 0.95 * diameter * t**2.2
    path = np.column_stack([bend - 0.05 * diameter, y, np.zeros_like(y)])
    claw = tube(path, diameter * (0.80 + 0.22 * t), diameter * (0.72 - 0.60 * t), (0, 0, 1), 40, 3.5)
    return [PaintedPart.of(solid, metal) for solid in (face, neck, cheek, claw)]
