"""A hollow bottle, flask or jar with an open neck, standing on z = 0."""

import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Checks
from objectfolder.shapes.section import (
    half_outline,
    ring,
    ring_under,
    round_polyline,
    soften,
    wall_about,
)
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.vessel import build_vessel, lobe_warp, vessel_finish


def bottle(
    radius: float = 0.036,
    height: float = 0.22,
    wall: float = 0.0025,
    neck_radius: float = 0.013,
    neck_height: float = 0.055,
    shoulder: float = 0.050,
    collar: float = 0.002,
    waist: float = 0.0,
    lobes: int = 0,
    lobe_depth: float = 0.05,
    finish: str = "glass",
    color: str | None = None,
    accent: str | None = None,
    seed: int = 0,
    texture_size: int = 1024,
) -> TexturedMesh:
    """Build a bottle.

    One closed surface of genus 0; a round one has x and y from -radius to radius, z from 0 to height.

    Parameters
    ----------
    radius, height, wall : float
        Outer radius of the body, height of the whole and thickness of the wall and the floor, m.
    neck_radius, neck_height : float
        Outer radius and height of the neck, m.
    shoulder : float
        Height of the shoulder between body and neck, m.
    collar : float
        Protrusion of the ring at the mouth, m; 0 for none.
    waist : float
        Constriction of the body at half height, in radii.
    lobes : int
        Number of lobes of the body, 0 for a round one; 4 approximate a square.
    lobe_depth : float
        Depth of the lobes, in radii; unused for a round bottle.
    accent : str, optional
        On a glazed bottle the colour inside.
    """
    check = Checks("bottle", texture_size)
    check.positive(radius=radius, height=height, wall=wall, neck_radius=neck_radius, neck_height=neck_height)
    check.positive(shoulder=shoulder)
    check.between(0.2 * radius, 0.9 * radius, "20 % to 90 % of the radius", neck_radius=neck_radius)
    check.between(0.02 * radius, 0.35 * neck_radius, "2 % of the radius to 35 % of the neck's", wall=wall)
    check.between(0.0, radius - neck_radius, "no wider than the body", collar=collar)
    lowest = max(0.5 * (radius - neck_radius), 2 * wall)
    check.between(lowest, 0.7 * height, "half of its width to 70 % of the height", shoulder=shoulder)
    check.between(3 * wall, 0.6 * height, "3 walls to 60 % of the height", neck_height=neck_height)
    tallest = 12 * radius
    room = neck_height + shoulder + 0.8 * radius
    check.between(room, tallest, "neck, shoulder and a body; up to 12 radii", height=height)
    check.between(0.0, 0.35, "a share of the radius", waist=waist)

    recess = 0.4 * wall
    floor, side, bore = recess + wall / 2, radius - wall / 2, neck_radius - wall / 2
    hip = height - neck_height - shoulder
    foot = round_polyline(np.array([[0, floor], [side, floor], [side, hip]]), np.array([0.2 * radius]))
    up = np.linspace(0, 1, 200)
    body = np.stack([np.full(200, side), foot[-2, 1] + (hip - foot[-2, 1]) * up], 1)
    body[:, 0] -= waist * radius * np.sin(np.pi * up) ** 2
    slope = np.stack([bore + (side - bore) * smoothstep(1, 0, up), hip + shoulder * up], 1)
    mouth = [[bore, height - wall / 2]]
    middle = np.concatenate([foot[:-2], body, slope[1:], mouth])

    section = wall_about(middle, wall)
    section += ring_under(middle, 0.78 * radius, 0.12 * radius)
    if collar:
        thick = min(0.35 * neck_height, 3 * collar + wall)
        # Below the rounded lip, which stays the highest.
        low, high, out = height - wall / 2 - thick, height - wall / 2, neck_radius + collar
        section += ring([[bore, low], [out, low], [out, high], [bore, high]])
    section = soften(section, concave=0.8 * recess, convex=0.45 * recess)

    def weight(points: np.ndarray) -> np.ndarray:
        return smoothstep(hip + shoulder, hip, points[:, 2])

    look = vessel_finish(finish, height, height, recess, color, accent, seed)
    warp = lobe_warp(check, lobes, lobe_depth, weight)
    return build_vessel(half_outline(section, "bottle"), look, texture_size, warp)
