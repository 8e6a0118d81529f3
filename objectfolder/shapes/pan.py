"""A pan with a long handle: a skillet, or deeper a saucepan, standing on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.section import half_outline, round_polyline, round_solid, soften, wall_about
from objectfolder.shapes.sweep import tube
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.turning import revolve_solid

HOLE = 0.24  #: radius of the hanging hole, in widths of the handle


@generator("brushed")
def pan(
    order: Order, radius: Size = 0.125, height: Size = 0.045, wall: Size = 0.003, base_radius: Size = 0.095,
    rounding: Size = 0.018, handle_length: Size = 0.17, handle_width: Size = 0.027,
    handle_thickness: Size = 0.012, handle_rise: float = 0.035, handle_finish: str | None = None,
    handle_color: str | None = None,
) -> TexturedMesh:  # fmt: skip
    """Build a pan.

    One closed surface of genus 1; x from -radius to about radius + handle_length, the lip at z = height.

    Parameters
    ----------
    radius, height, wall : float
        Outer radius at the lip, height and thickness of the wall and the floor, m.
    base_radius : float
        Radius of the wall extended to the floor, m.
    rounding : float
        Radius of the bend between floor and wall, m.
    handle_length, handle_width, handle_thickness : float
        Protrusion of the handle from the lip, and its section, m; it has a hole near its end.
    handle_rise : float
        Height of the handle's end above its root, m.
    handle_finish, handle_color : str, optional
        Default: those of the pan.
    """
    order.between(0.2 * radius, 1.6 * radius, "0.2 to 1.6 radii", height=height)
    order.between(0.6 * radius, 1.0 * radius, "60 % to 100 % of the radius", base_radius=base_radius)
    order.between(0.01 * radius, 0.08 * radius, "1 % to 8 % of the radius", wall=wall)
    order.between(wall, 0.6 * height, "the wall to 60 % of the height", rounding=rounding)
    order.between(radius / 2, 3 * radius, "0.5 to 3 radii", handle_length=handle_length)
    widest = min(0.4 * radius, 0.3 * handle_length)
    order.between(0.08 * radius, widest, "a bar that the wall can hold", handle_width=handle_width)
    thickest = min(handle_width, 0.35 * height)
    order.between(1.2 * wall, thickest, "flat and low", handle_thickness=handle_thickness)
    order.between(0.0, 0.5 * handle_length, "less than half its length", handle_rise=handle_rise)

    floor, lip = wall / 2, height - wall / 2
    corners = np.array([[0, floor], [base_radius - wall / 2, floor], [radius - wall / 2, lip]])
    middle = round_polyline(corners, np.array([rounding]))
    shell = revolve_solid(half_outline(soften(wall_about(middle, wall), convex=0.45 * wall), "pan"))
    core = revolve_solid(half_outline(round_solid(np.append(middle, [[0, lip]], axis=0)), "pan"))

    # The root is below the lip by the handle's thickness; the core cuts it off in the middle of the wall.
    root = height - wall - handle_thickness
    start = np.interp(root, *middle[1:, ::-1].T) - 0.5 * handle_width - 2 * handle_thickness
    stop = radius + handle_length
    t = np.sin(np.linspace(0, np.pi / 2, 60))  # closer towards the rounded end
    bow = handle_rise * smoothstep(0, 1, t) + 0.12 * handle_rise * np.sin(np.pi * t)
    path = np.stack([start + (stop - start) * t, 0 * t, root + bow], 1)
    left = (stop - path[:, 0]) / (0.5 * handle_width)
    blunt = np.sqrt(np.maximum(1 - np.maximum(1 - left, 0) ** 2, 0.03))
    width = handle_width * (0.72 + 0.28 * smoothstep(0.25, 0.85, t)) * blunt
    thickness = handle_thickness * (1 - 0.25 * smoothstep(0.3, 0.9, t)) * np.sqrt(blunt)
    handle = tube(path, width, thickness, (0.0, 1.0, 0.0), segments=32, squareness=2.6)
    eye = stop - 0.75 * handle_width
    drill = manifold3d.Manifold.cylinder(4 * handle_width, HOLE * handle_width, -1.0, 48, center=True)
    drill = drill.translate((eye, 0.0, float(np.interp(eye, path[:, 0], path[:, 2]))))

    size = 2 * radius + handle_length
    look = Look.of(order, size)
    own = order.color if handle_finish is None else None
    grip = Look(handle_finish or order.finish, size, handle_color or own, None, order.seed)
    # The pan has the rings of turned metal, the handle is brushed lengthwise.
    paint = grip.paint((1.0, 0.0, 0.0))
    body = PaintedPart.of(shell, look.paint())
    bar, hole = PaintedPart.of(handle - core, paint), PaintedPart.of(drill, paint)
    return assemble(body.solid + bar.solid - hole.solid, [body, bar, hole], look, order.texture_size)
