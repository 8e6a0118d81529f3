"""A teapot, hollow down its spout, with its lid on, standing on z = 0."""

from collections.abc import Callable

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.assembly import Look, PaintedPart, assemble
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.section import half_outline, offset, ring, round_solid, soften
from objectfolder.shapes.sweep import tube
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.turning import revolve_solid

BODY = 0.74  #: height of the body without lid, in heights of the teapot
HIDDEN = 0.002  #: allowed deviation of the inside from its curve, in its sizes
SUNK = 0.10  #: fraction of the body's curve below the table, where it is cut level


@generator("glaze")
def teapot(
    order: Order, radius: Size = 0.068, height: Size = 0.135, wall: Size = 0.004, fullness: Size = 2.3,
    lid_radius: Size = 0.034, spout_reach: Size = 0.055, handle_reach: Size = 0.045,
) -> TexturedMesh:  # fmt: skip
    """Build a teapot.

    One closed surface of genus 1: the inside is open through the spout, which points along x. x from
    about -radius - handle_reach to about radius + spout_reach, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Largest outer radius of the body, height with the knob, and thickness of the wall, m.
    fullness : float
        1.8 (nearly a double cone) through 2 (an ellipsoid) to 5 (nearly a cylinder).
    lid_radius : float
        Radius of the lid, m; it is fused with the body.
    spout_reach, handle_reach : float
        Protrusion of the spout's tip and of the handle from the body, m.
    accent : str, optional
        On a glazed teapot the colour of lid, handle and spout's tip.
    """
    order.between(1.3 * radius, 3.0 * radius, "1.3 to 3 radii", height=height)
    order.between(0.03 * radius, 0.09 * radius, "3 % to 9 % of the radius", wall=wall)
    order.between(1.8, 5.0, "double cone to cylinder", fullness=fullness)
    order.between(0.35 * radius, 0.65 * radius, "35 % to 65 % of the radius", lid_radius=lid_radius)
    order.between(0.5 * radius, 1.3 * radius, "0.5 to 1.3 radii", spout_reach=spout_reach)
    order.between(0.45 * radius, 1.2 * radius, "0.45 to 1.2 radii", handle_reach=handle_reach)

    tall = BODY * height
    half = tall * (1 + SUNK) / 2
    middle = tall - half

    def width(z: np.ndarray | float) -> np.ndarray:
        """Return the outer radius of the body's curve at a height, m."""
        return radius * (1 - np.abs((np.asarray(z) - middle) / half) ** fullness).clip(0) ** (1 / fullness)

    angle = np.linspace(-np.pi / 2, np.pi / 2, 401)
    z = middle + half * np.sign(angle) * np.abs(np.sin(angle)) ** (2 / fullness)
    curve = np.stack([radius * np.cos(angle) ** (2 / fullness), z], 1)[z > 0]
    base = [[0.0, 0.0], [float(width(0.0)), 0.0]]
    bulb = soften(round_solid(np.concatenate([base, curve])), convex=0.08 * radius)
    cavity = offset(bulb, -wall)
    knob = 0.5 * (height - tall) * 0.62
    seat = middle + half * (1 - (lid_radius / radius) ** fullness) ** (1 / fullness)
    t = np.linspace(0, np.pi / 2, 60)
    dome = np.stack([lid_radius * np.cos(t), seat + (tall + 0.25 * knob - seat) * np.sin(t)], 1)
    brim = 0.6 * wall
    lid = round_solid(np.concatenate([[[0.0, seat - wall]], [[lid_radius, seat - wall]], dome]))
    inner, outer = 0.5 * lid_radius, lid_radius + brim
    under, over = seat - 0.5 * wall, seat + wall
    lid += ring([[inner, under], [outer, under], [outer, over], [inner, over]])
    turn = 2 * t - np.pi / 2
    ball = np.stack([1.15 * knob * np.cos(turn), height - knob + knob * np.sin(turn)], 1)
    slim, foot, head = 0.55 * knob, tall - wall, height - knob
    stalk = np.array([[0.0, foot], [slim, foot], [slim, head], [0.0, head]])
    whole = bulb + lid + round_solid(ball) + round_solid(stalk)
    outline = soften(whole, concave=0.4 * wall, convex=0.25 * wall)

    spout, bore = _spout(radius, tall, spout_reach, wall)
    handle = _handle(width, radius, tall, handle_reach)

    size = 2 * radius + spout_reach + handle_reach
    accent, glazed = order.accent, order.finish == "glaze"
    look = Look.of(order, size, accent=None if glazed else accent)
    trim = look.dye(accent) if glazed and accent is not None else look
    plain, second = look.paint(), trim.paint()

    def dipped(points: np.ndarray) -> np.ndarray:
        """Return the paint with trim on the lid and on the spout's tip."""
        r = np.hypot(points[:, 0], points[:, 1])
        on_lid = (r < lid_radius + 1.6 * brim) & (points[:, 2] > seat - 0.5 * wall)
        share = np.where(on_lid, 1.0, smoothstep(0.62, 0.64, (points[:, 0] - radius) / spout_reach))
        return plain(points) + share[:, None] * (second(points) - plain(points))

    body = PaintedPart.of(revolve_solid(half_outline(outline, "teapot")), dipped)
    pipe, grip = PaintedPart.of(spout, dipped), PaintedPart.of(handle, second)
    hollow = PaintedPart.of(revolve_solid(half_outline(cavity, "teapot"), HIDDEN), plain)
    drill = PaintedPart.of(bore, plain)
    solid = body.solid + pipe.solid + grip.solid - hollow.solid - drill.solid
    return assemble(solid, [body, pipe, grip, hollow, drill], look, order.texture_size)


def _bezier(x: list[float], z: list[float], pieces: int) -> np.ndarray:
    """Sample a cubic Bezier curve with four control points in the x-z plane; (pieces + 1, 3)."""
    t = np.linspace(0, 1, pieces + 1)[:, None]
    weights = np.concatenate([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], 1)
    across, up = (weights @ np.stack([x, z], 1)).T
    return np.stack([across, 0 * across, up], 1)


def _spout(
    radius: float, tall: float, reach: float, wall: float
) -> tuple[manifold3d.Manifold, manifold3d.Manifold]:
    """Build the spout and its bore, which extends beyond the tip."""
    x = [0.45 * radius, radius + 0.50 * reach, radius + 0.30 * reach, radius + reach - 0.06 * radius]
    path = _bezier(x, [0.34 * tall, 0.30 * tall, 0.70 * tall, 0.93 * tall], 36)
    t = np.linspace(0, 1, len(path))
    across = 2 * min(radius, 0.64 * tall) * (0.125 + 0.25 * (1 - t) ** 1.6)
    spout = tube(path, 0.85 * across, across, (0.0, 1.0, 0.0), segments=32)
    tip = path[-1] - path[-2]
    beyond = np.concatenate([path, path[-1:] + tip])
    inner = np.append(across, across[-1])
    thin = np.minimum(2 * wall, 0.45 * 0.85 * inner)
    bore = tube(beyond, 0.85 * inner - thin, inner - thin, (0.0, 1.0, 0.0), segments=24)
    return spout, bore


def _handle(
    width: Callable[[float], np.ndarray], radius: float, tall: float, reach: float
) -> manifold3d.Manifold:
    """Build the handle's loop; both ends reach into the cavity, which cuts them off."""
    high, low = 0.80 * tall, 0.26 * tall
    deep = 0.12 * radius
    far = -(radius + reach)
    # The cubic reaches 3 / 4 of the way to its control points.
    bend = (far + 0.055 * radius) * 4 / 3 + (float(width(high)) + float(width(low)) - 2 * deep) / 2 / 3
    x = [-float(width(high)) + deep, bend, bend, -float(width(low)) + deep]
    path = _bezier(x, [high, high + 0.25 * tall, low - 0.02 * tall, low], 44)
    t = np.linspace(0, 1, len(path))
    swell = 1 + 0.45 * (smoothstep(0.2, 0.0, t) + smoothstep(0.8, 1.0, t))
    return tube(path, 0.20 * radius * swell, 0.11 * radius * swell, (0.0, 1.0, 0.0), segments=24)
