"""A cup without a handle: a tumbler, or with a stem a goblet, standing on z = 0."""

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Checks
from objectfolder.shapes.section import (
    half_outline,
    resample_evenly,
    ring_under,
    round_polyline,
    round_solid,
    soften,
    wall_about,
)
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.vessel import build_vessel, lobe_warp, vessel_finish


def cup(
    radius: float = 0.036,
    height: float = 0.095,
    wall: float = 0.003,
    base_radius: float = 0.028,
    rounding: float = 0.008,
    bulge: float = 0.0,
    stem: float = 0.0,
    foot_radius: float = 0.034,
    lobes: int = 0,
    lobe_depth: float = 0.05,
    finish: str = "plastic",
    color: str | None = None,
    accent: str | None = None,
    seed: int = 0,
    texture_size: int = 1024,
) -> TexturedMesh:
    """Build a cup.

    One closed surface of genus 0; z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Outer radius at the lip, height of the whole, and thickness of the wall and the floor, m.
    base_radius : float
        Radius of the wall extended to the floor, m; larger than ``radius`` narrows the mouth.
    rounding : float
        Radius of the bend between floor and wall, m; large for a goblet.
    bulge : float
        Bulge of the wall at half height, in radii; negative for a waist.
    stem : float
        Height of the bowl above the table, m; 0 for a tumbler, which stands on its own low ring.
    foot_radius : float
        Radius of the foot under a stem, m; unused without a stem.
    lobes : int
        Number of lobes of the lip, 0 for a round one.
    lobe_depth : float
        Depth of the lobes, in radii; unused for a round cup.
    accent : str, optional
        On a glazed cup the colour inside.
    """
    check = Checks("cup", texture_size)
    check.positive(radius=radius, height=height, wall=wall, base_radius=base_radius, rounding=rounding)
    check.between(0.5 * radius, 1.5 * radius, "0.5 to 1.5 radii", base_radius=base_radius)
    narrow = min(radius, base_radius)
    check.between(0.02 * radius, 0.2 * narrow, "2 % of the radius to 20 % at the narrowest", wall=wall)
    check.between(wall, 0.95 * base_radius, "the wall to the radius of the base", rounding=rounding)
    check.between(-0.25, 0.4, "waisted to swollen", bulge=bulge)
    if stem:
        check.positive(stem=stem, foot_radius=foot_radius)
        check.between(4 * wall, 0.65 * height, "4 walls to 65 % of the height", stem=stem)
        check.between(0.5 * radius, 1.3 * radius, "0.5 to 1.3 radii", foot_radius=foot_radius)
    deep = height - stem
    check.between(radius + stem, 6 * radius + stem, "1 to 6 radii above any stem", height=height)

    recess = 0.5 * wall
    floor = (stem or recess) + wall / 2
    top = height - wall / 2
    corners = np.array([[0, floor], [base_radius - wall / 2, floor], [radius - wall / 2, top]])
    middle = resample_evenly(round_polyline(corners, np.array([rounding])))
    up = (middle[:, 1] - floor) / (top - floor)
    middle[:, 0] *= 1 + bulge * np.sin(np.pi * up) ** 2 * smoothstep(0, 0.1, up)
    section = wall_about(middle, wall)
    if stem:
        section = soften(section + _stem(stem + wall / 2, foot_radius, wall), concave=0.35 * stem)
        section = soften(section, convex=0.45 * wall)
    else:
        flat = max(base_radius - wall / 2 - 0.8 * rounding, 0.45 * base_radius)
        section += ring_under(middle, flat, min(2 * wall, 0.25 * base_radius))
        section = soften(section, concave=0.8 * recess, convex=0.45 * recess)

    def weight(points: np.ndarray) -> np.ndarray:
        return smoothstep(stem + 0.2 * deep, height, points[:, 2])

    size = max(2 * radius, height)
    look = vessel_finish(finish, size, height, 0.0 if stem else recess, color, accent, seed)
    warp = lobe_warp(check, lobes, lobe_depth, weight)
    return build_vessel(half_outline(section, "cup"), look, texture_size, warp)


def _stem(top: float, foot_radius: float, wall: float) -> manifold3d.CrossSection:
    """Build the foot and stem of a goblet up to the height `top`, m."""
    slim = max(1.3 * wall, 0.1 * foot_radius)
    t = np.linspace(0, 1, 80)
    side = np.stack([slim + (foot_radius - slim) * (1 - t) ** 3, wall + (0.35 * top - wall) * t], 1)
    return round_solid(np.concatenate([[[0.0, 0.0], [foot_radius, 0.0]], side, [[slim, top], [0.0, top]]]))
