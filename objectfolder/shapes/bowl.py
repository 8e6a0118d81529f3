"""A bowl: an open, turned vessel from a shallow dish to a straight-sided ramekin, standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Checks
from objectfolder.shapes.section import half_outline, ring_under, soften, wall_about
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.vessel import build_vessel, lobe_warp, vessel_finish


def bowl(
    radius: float = 0.075,
    height: float = 0.065,
    wall: float = 0.004,
    foot_radius: float = 0.034,
    foot_height: float = 0.006,
    fullness: float = 2.2,
    flare: float = 0.0,
    lobes: int = 0,
    lobe_depth: float = 0.05,
    finish: str = "glaze",
    color: str | None = None,
    accent: str | None = None,
    seed: int = 0,
    texture_size: int = 1024,
) -> TexturedMesh:
    """Build a bowl.

    One closed surface of genus 0; a round one has x and y from -radius to radius, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Largest outer radius, height and thickness of the wall, m.
    foot_radius, foot_height : float
        Outer radius and height of the foot ring, m.
    fullness : float
        1.6 (nearly a cone) through 2 (an ellipsoid) to 8 (nearly a cylinder).
    flare : float
        -0.4 (drawn in at the lip) to 0.6 (lip bent outward).
    lobes : int
        Number of lobes of the lip, 0 for a round one.
    lobe_depth : float
        Depth of the lobes, in radii; unused for a round bowl.
    accent : str, optional
        On a glazed bowl the colour inside.
    """
    check = Checks("bowl", texture_size)
    check.positive(radius=radius, height=height, wall=wall, foot_radius=foot_radius, foot_height=foot_height)
    check.positive(fullness=fullness)
    check.between(0.25 * radius, 2.5 * radius, "a quarter to 2.5 radii", height=height)
    thickest = min(0.15 * radius, 0.2 * height)
    check.between(0.015 * radius, thickest, "1.5 % to 15 % of the radius", wall=wall)
    check.between(0.25 * radius, 0.7 * radius, "25 % to 70 % of the radius", foot_radius=foot_radius)
    check.between(0.2 * wall, 0.2 * height, "a low ring", foot_height=foot_height)
    check.between(1.6, 8.0, "cone to cylinder", fullness=fullness)
    check.between(-0.4, 0.6, "drawn in to bent out", flare=flare)

    # A superellipse: level on the axis, upright at the lip before the flare.
    angle = np.linspace(0, np.pi / 2, 600)
    rise = 1 - np.cos(angle) ** (2 / fullness)
    r = np.sin(angle) ** (2 / fullness) * (1 + flare * (rise**3 - 1))
    base = foot_height + wall / 2
    middle = np.stack([(radius - wall / 2) * r / r.max(), base + (height - wall / 2 - base) * rise], 1)

    ring = max(1.2 * wall, 0.12 * foot_radius)
    section = soften(
        wall_about(middle, wall) + ring_under(middle, foot_radius, ring),
        concave=0.4 * foot_height,
        convex=0.3 * min(wall, foot_height),
    )
    warp = lobe_warp(check, lobes, lobe_depth, lambda p: smoothstep(0.3 * height, height, p[:, 2]))
    size = max(2 * radius, height)
    look = vessel_finish(finish, size, height, 0.6 * foot_height, color, accent, seed)
    return build_vessel(half_outline(section, "bowl"), look, texture_size, warp)
