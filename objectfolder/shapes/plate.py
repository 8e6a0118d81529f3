"""A plate: from a flat saucer to a soup plate, with or without a rim, standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Checks
from objectfolder.shapes.section import (
    half_outline,
    ring_under,
    round_polyline,
    soften,
    wall_about,
)
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.vessel import build_vessel, lobe_warp, vessel_finish


def plate(
    radius: float = 0.13,
    height: float = 0.024,
    wall: float = 0.005,
    well_radius: float = 0.085,
    rim: float = 0.032,
    foot_height: float = 0.003,
    lobes: int = 0,
    lobe_depth: float = 0.04,
    finish: str = "glaze",
    color: str | None = None,
    accent: str | None = None,
    seed: int = 0,
    texture_size: int = 1024,
) -> TexturedMesh:
    """Build a plate.

    One closed surface of genus 0; a round one has x and y from -radius to radius, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Outer radius, height and thickness, m.
    well_radius : float
        Radius of the flat middle, m.
    rim : float
        Width of the rim, m; 0 for a straight rise from the well to the edge.
    foot_height : float
        Height of the foot ring, m.
    lobes : int
        Number of lobes of the rim, 0 for a round one; 4 approximate a square.
    lobe_depth : float
        Depth of the lobes, in radii; unused for a round plate.
    accent : str, optional
        On a glazed plate the colour of the upper side.
    """
    check = Checks("plate", texture_size)
    check.positive(radius=radius, height=height, wall=wall, well_radius=well_radius, foot_height=foot_height)
    check.between(0.4 * radius, 0.85 * radius, "40 % to 85 % of the radius", well_radius=well_radius)
    room = 0.8 * (radius - well_radius)
    check.between(0.0, room, "0 to 80 % of what the well leaves", rim=rim)
    check.between(0.01 * radius, 0.08 * radius, "1 % to 8 % of the radius", wall=wall)
    check.between(0.2 * wall, wall, "a fifth of the wall to the wall", foot_height=foot_height)
    lowest = 1.2 * wall + foot_height
    check.between(lowest, 0.5 * radius, "above the well, below half the radius", height=height)

    low, top, edge = foot_height + wall / 2, height - wall / 2, radius - wall / 2
    corners = [[0, low], [well_radius, low], [edge, top]]
    if rim:
        corners.insert(2, [edge - rim, low + 0.72 * (top - low)])
    bend = 0.5 * (radius - well_radius)
    middle = round_polyline(np.array(corners), np.array([bend] * (len(corners) - 2)))
    section = soften(
        wall_about(middle, wall) + ring_under(middle, 0.96 * well_radius, max(wall, 0.06 * well_radius)),
        concave=0.8 * foot_height,
        convex=0.4 * foot_height,
    )

    def weight(points: np.ndarray) -> np.ndarray:
        return smoothstep(0.8 * well_radius, radius, np.hypot(points[:, 0], points[:, 1]))

    look = vessel_finish(finish, 2 * radius, height, 0.5 * foot_height, color, accent, seed)
    warp = lobe_warp(check, lobes, lobe_depth, weight)
    return build_vessel(half_outline(section, "plate"), look, texture_size, warp)
