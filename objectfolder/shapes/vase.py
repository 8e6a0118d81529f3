"""A vase with a curved profile, standing on z = 0."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Checks
from objectfolder.shapes.section import half_outline, ring_under, soften, wall_about
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.vessel import build_vessel, lobe_warp, vessel_finish


def vase(
    radius: float = 0.055,
    height: float = 0.20,
    wall: float = 0.004,
    base_radius: float = 0.034,
    neck_radius: float = 0.024,
    lip_radius: float = 0.034,
    belly: float = 0.40,
    neck: float = 0.82,
    lobes: int = 0,
    lobe_depth: float = 0.05,
    twist: float = 0.0,
    finish: str = "glaze",
    color: str | None = None,
    accent: str | None = None,
    seed: int = 0,
    texture_size: int = 1024,
) -> TexturedMesh:
    """Build a vase.

    One closed surface of genus 0; a round one has x and y from -radius to radius, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Largest outer radius, height and thickness of the wall and the floor, m.
    base_radius, neck_radius, lip_radius : float
        Outer radii at the base, at the neck and at the lip, m.
    belly, neck : float
        Heights of the largest radius and of the neck, in heights of the vase.
    lobes : int
        Number of lobes of the body, 0 for a round one.
    lobe_depth : float
        Depth of the lobes, in radii; unused for a round vase.
    twist : float
        Rotation of the lobes from the base to the lip, turns.
    accent : str, optional
        On a glazed vase the colour inside.
    """
    check = Checks("vase", texture_size)
    check.positive(radius=radius, height=height, wall=wall, base_radius=base_radius, neck_radius=neck_radius)
    check.positive(lip_radius=lip_radius)
    check.between(1.2 * radius, 8 * radius, "1.2 to 8 radii", height=height)
    others = {"base_radius": base_radius, "neck_radius": neck_radius, "lip_radius": lip_radius}
    check.between(0.2 * radius, radius, "20 % to 100 % of the radius", **others)
    narrow = min(others.values())
    check.between(0.02 * radius, 0.25 * narrow, "2 % of the radius to a quarter of the narrowest", wall=wall)
    check.between(0.2, 0.8, "a share of the height", belly=belly)
    check.between(belly + 0.1, 0.95, "a share of the height above the belly", neck=neck)
    check.between(-1.0, 1.0, "turns", twist=twist)

    recess = 0.5 * wall
    floor, top = recess + wall / 2, height - wall / 2
    levels = floor + (top - floor) * np.array([0, belly, neck, 1])
    radii = np.array([base_radius, radius, neck_radius, lip_radius]) - wall / 2
    curve = PchipInterpolator(levels, radii)
    # The bend from floor to wall is a quarter circle, sheared along the curve to fit it.
    bend = min(0.25 * base_radius, 0.3 * (levels[1] - floor))
    angle = np.linspace(0, np.pi / 2, 40)
    z = np.concatenate([floor + bend * (1 - np.cos(angle)), np.linspace(floor + bend, top, 400)[1:]])
    inset = bend * (1 - np.sqrt(1 - np.clip(1 - (z - floor) / bend, 0, 1) ** 2))
    middle = np.concatenate([[[0, floor]], np.stack([curve(z) - inset, z], 1)])
    section = wall_about(middle, wall) + ring_under(
        middle, base_radius - wall / 2 - 0.6 * bend, 0.15 * base_radius
    )
    section = soften(section, concave=0.8 * recess, convex=0.45 * recess)

    def weight(points: np.ndarray) -> np.ndarray:
        return smoothstep(0.05 * height, 0.4 * height, points[:, 2])

    look = vessel_finish(finish, height, height, recess, color, accent, seed)
    warp = lobe_warp(check, lobes, lobe_depth, weight, twist / height)
    return build_vessel(half_outline(section, "vase"), look, texture_size, warp)
