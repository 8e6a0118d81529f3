"""Hollow vessels, turned or with lobes, standing on z = 0: a cup, a bowl, a plate, a bottle and a vase.

Each is one closed surface of genus 0, z from 0 to ``height``; round ones have x and y from ``-radius`` to
``radius``, unless a cup bulges. ``lobes`` is the number of lobes, 0 for none (4 approximate a square), and
``lobe_depth`` their depth in radii. ``accent`` is the colour inside a glazed vessel.
"""

import manifold3d
import numpy as np
from scipy.interpolate import PchipInterpolator

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.section import (
    resample_evenly,
    ring,
    ring_under,
    round_polyline,
    round_solid,
    soften,
    wall_about,
)  # fmt: skip
from objectfolder.shapes.texture import smoothstep
from objectfolder.shapes.turning import build_vessel, lobe_warp


@generator("plastic")
def cup(
    order: Order, radius: Size = 0.036, height: Size = 0.095, wall: Size = 0.003, base_radius: Size = 0.028,
    rounding: Size = 0.008, bulge: float = 0.0, stem: float = 0.0, foot_radius: float = 0.034, lobes: int = 0,
    lobe_depth: float = 0.05,
) -> TexturedMesh:  # fmt: skip
    """Build a cup.

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
    """
    order.between(0.5 * radius, 1.5 * radius, "0.5 to 1.5 radii", base_radius=base_radius)
    narrow = min(radius, base_radius)
    order.between(0.02 * radius, 0.2 * narrow, "2 % of the radius to 20 % at the narrowest", wall=wall)
    order.between(wall, 0.95 * base_radius, "the wall to the radius of the base", rounding=rounding)
    order.between(-0.25, 0.4, "waisted to swollen", bulge=bulge)
    if stem:
        order.positive(stem=stem, foot_radius=foot_radius)
        order.between(4 * wall, 0.65 * height, "4 walls to 65 % of the height", stem=stem)
        order.between(0.5 * radius, 1.3 * radius, "0.5 to 1.3 radii", foot_radius=foot_radius)
    deep = height - stem
    order.between(radius + stem, 6 * radius + stem, "1 to 6 radii above any stem", height=height)

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

    warp = lobe_warp(order, lobes, lobe_depth, lambda p: smoothstep(stem + 0.2 * deep, height, p[:, 2]))
    return build_vessel(order, section, max(2 * radius, height), height, 0.0 if stem else recess, warp)


def _stem(top: float, foot_radius: float, wall: float) -> manifold3d.CrossSection:
    """Build the foot and stem of a goblet up to the height `top`, m."""
    slim = max(1.3 * wall, 0.1 * foot_radius)
    t = np.linspace(0, 1, 80)
    side = np.stack([slim + (foot_radius - slim) * (1 - t) ** 3, wall + (0.35 * top - wall) * t], 1)
    return round_solid(np.concatenate([[[0.0, 0.0], [foot_radius, 0.0]], side, [[slim, top], [0.0, top]]]))


@generator("glaze")
def bowl(
    order: Order, radius: Size = 0.075, height: Size = 0.065, wall: Size = 0.004, foot_radius: Size = 0.034,
    foot_height: Size = 0.006, fullness: Size = 2.2, flare: float = 0.0, lobes: int = 0,
    lobe_depth: float = 0.05,
) -> TexturedMesh:  # fmt: skip
    """Build a bowl.

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
    """
    order.between(0.25 * radius, 2.5 * radius, "a quarter to 2.5 radii", height=height)
    thickest = min(0.15 * radius, 0.2 * height)
    order.between(0.015 * radius, thickest, "1.5 % to 15 % of the radius", wall=wall)
    order.between(0.25 * radius, 0.7 * radius, "25 % to 70 % of the radius", foot_radius=foot_radius)
    order.between(0.2 * wall, 0.2 * height, "a low ring", foot_height=foot_height)
    order.between(1.6, 8.0, "cone to cylinder", fullness=fullness)
    order.between(-0.4, 0.6, "drawn in to bent out", flare=flare)

    # A superellipse: level on the axis, upright at the lip before the flare.
    angle = np.linspace(0, np.pi / 2, 600)
    rise = 1 - np.cos(angle) ** (2 / fullness)
    r = np.sin(angle) ** (2 / fullness) * (1 + flare * (rise**3 - 1))
    base = foot_height + wall / 2
    middle = np.stack([(radius - wall / 2) * r / r.max(), base + (height - wall / 2 - base) * rise], 1)

    section = wall_about(middle, wall) + ring_under(middle, foot_radius, max(1.2 * wall, 0.12 * foot_radius))
    section = soften(section, concave=0.4 * foot_height, convex=0.3 * min(wall, foot_height))
    warp = lobe_warp(order, lobes, lobe_depth, lambda p: smoothstep(0.3 * height, height, p[:, 2]))
    return build_vessel(order, section, max(2 * radius, height), height, 0.6 * foot_height, warp)


@generator("glaze")
def plate(
    order: Order, radius: Size = 0.13, height: Size = 0.024, wall: Size = 0.005, well_radius: Size = 0.085,
    rim: float = 0.032, foot_height: Size = 0.003, lobes: int = 0, lobe_depth: float = 0.04,
) -> TexturedMesh:  # fmt: skip
    """Build a plate.

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
    """
    order.between(0.4 * radius, 0.85 * radius, "40 % to 85 % of the radius", well_radius=well_radius)
    room = 0.8 * (radius - well_radius)
    order.between(0.0, room, "0 to 80 % of what the well leaves", rim=rim)
    order.between(0.01 * radius, 0.08 * radius, "1 % to 8 % of the radius", wall=wall)
    order.between(0.2 * wall, wall, "a fifth of the wall to the wall", foot_height=foot_height)
    lowest = 1.2 * wall + foot_height
    order.between(lowest, 0.5 * radius, "above the well, below half the radius", height=height)

    low, top, edge = foot_height + wall / 2, height - wall / 2, radius - wall / 2
    corners = [[0, low], [well_radius, low], [edge, top]]
    if rim:
        corners.insert(2, [edge - rim, low + 0.72 * (top - low)])
    bend = 0.5 * (radius - well_radius)
    middle = round_polyline(np.array(corners), np.array([bend] * (len(corners) - 2)))
    section = wall_about(middle, wall)
    section += ring_under(middle, 0.96 * well_radius, max(wall, 0.06 * well_radius))
    section = soften(section, concave=0.8 * foot_height, convex=0.4 * foot_height)
    well = 0.8 * well_radius
    warp = lobe_warp(order, lobes, lobe_depth, lambda p: smoothstep(well, radius, np.hypot(*p[:, :2].T)))
    return build_vessel(order, section, 2 * radius, height, 0.5 * foot_height, warp)


@generator("glass")
def bottle(
    order: Order, radius: Size = 0.036, height: Size = 0.22, wall: Size = 0.0025, neck_radius: Size = 0.013,
    neck_height: Size = 0.055, shoulder: Size = 0.050, collar: float = 0.002, waist: float = 0.0,
    lobes: int = 0, lobe_depth: float = 0.05,
) -> TexturedMesh:  # fmt: skip
    """Build a bottle.

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
    """
    order.between(0.2 * radius, 0.9 * radius, "20 % to 90 % of the radius", neck_radius=neck_radius)
    order.between(0.02 * radius, 0.35 * neck_radius, "2 % of the radius to 35 % of the neck's", wall=wall)
    order.between(0.0, radius - neck_radius, "no wider than the body", collar=collar)
    lowest = max(0.5 * (radius - neck_radius), 2 * wall)
    order.between(lowest, 0.7 * height, "half of its width to 70 % of the height", shoulder=shoulder)
    order.between(3 * wall, 0.6 * height, "3 walls to 60 % of the height", neck_height=neck_height)
    tallest = 12 * radius
    room = neck_height + shoulder + 0.8 * radius
    order.between(room, tallest, "neck, shoulder and a body; up to 12 radii", height=height)
    order.between(0.0, 0.35, "a share of the radius", waist=waist)

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

    warp = lobe_warp(order, lobes, lobe_depth, lambda p: smoothstep(hip + shoulder, hip, p[:, 2]))
    return build_vessel(order, section, height, height, recess, warp)


@generator("glaze")
def vase(
    order: Order, radius: Size = 0.055, height: Size = 0.20, wall: Size = 0.004, base_radius: Size = 0.034,
    neck_radius: Size = 0.024, lip_radius: Size = 0.034, belly: float = 0.40, neck: float = 0.82,
    lobes: int = 0, lobe_depth: float = 0.05, twist: float = 0.0,
) -> TexturedMesh:  # fmt: skip
    """Build a vase.

    Parameters
    ----------
    radius, height, wall : float
        Largest outer radius, height and thickness of the wall and the floor, m.
    base_radius, neck_radius, lip_radius : float
        Outer radii at the base, at the neck and at the lip, m.
    belly, neck : float
        Heights of the largest radius and of the neck, in heights of the vase.
    twist : float
        Rotation of the lobes from the base to the lip, turns.
    """
    order.between(1.2 * radius, 8 * radius, "1.2 to 8 radii", height=height)
    others = {"base_radius": base_radius, "neck_radius": neck_radius, "lip_radius": lip_radius}
    order.between(0.2 * radius, radius, "20 % to 100 % of the radius", **others)
    narrow = min(others.values())
    order.between(0.02 * radius, 0.25 * narrow, "2 % of the radius to a quarter of the narrowest", wall=wall)
    order.between(0.2, 0.8, "a share of the height", belly=belly)
    order.between(belly + 0.1, 0.95, "a share of the height above the belly", neck=neck)
    order.between(-1.0, 1.0, "turns", twist=twist)

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
    flat = base_radius - wall / 2 - 0.6 * bend
    section = wall_about(middle, wall) + ring_under(middle, flat, 0.15 * base_radius)
    section = soften(section, concave=0.8 * recess, convex=0.45 * recess)

    low, high = 0.05 * height, 0.4 * height
    warp = lobe_warp(order, lobes, lobe_depth, lambda p: smoothstep(low, high, p[:, 2]), twist / height)
    return build_vessel(order, section, height, height, recess, warp)
