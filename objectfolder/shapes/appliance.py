"""Appliances in metres, standing on z = 0: a toaster, a lantern, a clothes iron and a hair dryer."""

from itertools import product

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.extrusion import deepest_inset, extrude_y, inset, prism, rectangle, round_corners
from objectfolder.shapes.fittings import (
    DARK,
    METAL,
    SPACING,
    Kit,
    bars,
    build_kind,
    knob,
    loop,
    rounded_disc,
    torus,
    turn_profile,
)
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.section import resample_evenly, round_polyline
from objectfolder.shapes.sweep import bar, tube
from objectfolder.shapes.texture import over, rgb, smoothstep


@generator("plastic")
def appliance(order: Order, kind: str = "toaster", span: Size = 0.295, plump: Size = 1.0) -> TexturedMesh:
    """Build a toaster with two slots, a lantern, a clothes iron or a hair dryer.

    One closed surface. Toasters and dryers are hollow and open, with walls of 3 % of the span or more.

    Parameters
    ----------
    kind : str
        "toaster", "lantern", "iron" or "dryer".
    span : float
        Length of a toaster or iron along x; height of a lantern or dryer, m.
    plump : float
        Width or diameter relative to the default, 0.8 to 1.25.
    accent : str, optional
        Colour of the toaster's base and lever, of the lantern's lamp, or of the handle.
    """
    return build_kind(order, kind, MAKERS, span, plump, "usual widths")


def _face_x(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """Turn what `extrude_y` extrudes by 90 degrees, so that -y becomes +x."""
    return solid.rotate((0.0, 0.0, 90.0))


def _toaster(kit: Kit, plump: float) -> None:
    """Build a toaster with slots into a hollow body; lever and dial are on its end at +x."""
    half, shift = 0.25 * plump, -0.035  # half the width; the body's centre along x
    x, z = [-1, 1, 1, 0.66, -0.66, -1], [0.05, 0.05, 0.44, 0.60, 0.60, 0.44]
    outline = round_corners(np.stack([x, z], 1) * [half, 1], 0.10)
    deepest = deepest_inset(outline)  # some widths leave short sides in the corners
    bevel = 0.075 if deepest > 0.075 else 0.95 * deepest
    body = _face_x(extrude_y([outline], 0.90, SPACING, bevel, 4)).translate((shift, 0, 0))
    hollow = _face_x(extrude_y([inset(outline, 0.04)], 0.78, 2 * SPACING)).translate((shift - 0.02, 0, 0))
    base = prism([rectangle(0.93, 2.1 * half, 0.11)], 0.055, SPACING, 0.015).translate((shift, 0, 0.03))
    foot, corners = rounded_disc(0.05, 0.06, 0.008, 28), product((-1, 1), repeat=2)
    feet = [foot.translate((shift + x * 0.36, y * 0.66 * half, 0)) for x, y in corners]
    sides = [0.42 * half, -0.42 * half]
    rim = prism([rectangle(0.71, 0.155 * plump, 0.05)], 0.10, SPACING, 0.010, 2)
    rims = [rim.translate((shift, y, 0.515)) for y in sides]
    opening = prism([rectangle(0.64, 0.085 * plump, 0.03)], 0.30, SPACING)
    openings = [opening.translate((shift, y, 0.40)) for y in sides]
    ribs = bars([0.56, 0.60, 0.56], 0.028, 0.056, 2 * half + 0.024, 0.008).translate((shift, 0, 0.235))

    end = shift + 0.45
    track = _face_x(extrude_y([rectangle(0.034, 0.27, 0.016, 3)], 0.08, SPACING)).translate((end, 0, 0.37))
    paddle = prism([rectangle(0.13, 0.17, 0.05)], 0.05, SPACING, 0.015).translate((0.5 - 0.065, 0, 0.43))
    dial = _face_x(knob(0.065, 0.05, turn=35.0)).translate((end, 0, 0.165))

    dark = kit.look.accent
    kit.body(kit.look.color, body)
    kit.body(dark, base)
    kit.body(kit.look.color, ribs, piece=1)
    kit.body("8d939a", *rims, piece=2)
    kit.body(dark, *feet, piece=3)
    kit.cut("26272a", hollow, *openings, track)
    kit.detail(dark, paddle)
    kit.detail(dark, dial, piece=4)


def _lantern(kit: Kit, plump: float) -> None:
    """Build a lantern: a tank, a ribbed lamp behind four posts with guard rings, a cap and a ring."""
    w = plump
    r = np.array([0, 0.27, 0.27, 0.235, 0.235, 0.13, 0.13, 0]) * w
    z = [0, 0, 0.05, 0.06, 0.17, 0.25, 0.29, 0.29]
    tank = round_polyline(np.stack([r, z], 1), np.array([0.02, 0.02, 0.02, 0.06, 0.04, 0.015]))
    t = np.linspace(0, np.pi, 40)
    globe = np.stack([w * (0.115 + 0.07 * np.sin(t) ** 0.8), 0.28 + 0.31 * t / np.pi], 1)
    globe = turn_profile(np.concatenate([[[0, 0.28]], globe, [[0, 0.59]]]), 6e-4)

    def ribbed(points: np.ndarray) -> np.ndarray:
        turn = np.arctan2(points[:, 1], points[:, 0])
        swell = np.sin(np.pi * np.clip((points[:, 2] - 0.28) / 0.31, 0, 1))
        scale = 1 + 0.035 * swell * np.cos(14 * turn)
        return points * np.stack([scale, scale, np.ones_like(scale)], 1)

    r = np.array([0, 0.265, 0.265, 0.135, 0.115, 0.165, 0.15]) * w
    z = [0.575, 0.575, 0.615, 0.70, 0.765, 0.775, 0.81, 0.85, 0.885, 0.885]
    cap = np.stack([np.append(r, [0.04, 0.035, 0]), z], 1)
    cap = round_polyline(cap, np.array([0.015, 0.015, 0.03, 0.02, 0.012, 0.02, 0.03, 0.012]))
    radius, wire = 0.222 * w, 0.027
    posts = []
    for a in np.pi / 4 + np.pi / 2 * np.arange(4):
        x, y = radius * np.cos(a), radius * np.sin(a)
        posts.append(bar((x, y, 0.14), (x, y, 0.60), (1.3 * wire, 1.3 * wire), SPACING, 16))
    guards = [torus(radius, wire, 12).translate((0, 0, z)) for z in (0.375, 0.495)]
    lug = 0.082
    ring = torus(lug, 0.04).rotate((90, 0, 0)).translate((0, 0, 0.98 - lug))
    burner = torus(0.13 * w, 0.03, 12).translate((0, 0, 0.27))
    drill, turns = manifold3d.Manifold.sphere(0.022, 20), 2 * np.pi * np.arange(8) / 8
    holes = [drill.translate((0.126 * w * np.cos(a), 0.126 * w * np.sin(a), 0.735)) for a in turns]
    wick = manifold3d.Manifold.sphere(1.0, 24).scale((0.035, 0.05, 0.05)).translate((0.24 * w, 0, 0.115))

    def glow(points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        far = np.abs(points[:, 2] - 0.42) / 0.15
        return over(colour, rgb("fff0b8"), 0.85 * smoothstep(1.1, 0.1, far))

    brass = "b08a4a"
    kit.body(kit.look.color, turn_profile(tank), axis=None)
    kit.body(kit.look.color, turn_profile(cap), axis=None, piece=1)
    kit.cut(DARK, *holes)
    kit.detail(kit.look.accent, globe.warp_batch(ribbed), decor=glow)
    kit.detail(kit.look.color, *posts, axis=(0, 0, 1), piece=2)
    kit.detail(kit.look.color, *guards, axis=None, piece=3)
    kit.detail(brass, ring, axis=(0, 0, 1))
    kit.detail(brass, burner, axis=None)
    kit.detail(brass, wick)


def _iron(kit: Kit, plump: float) -> None:
    """Build a clothes iron whose tip points to +x, with steam holes in its sole and a cord at its rear."""
    t = np.linspace(0, 1, 60)
    x, y = -0.40 + 0.90 * t, 0.20 * plump * (1 - t**2.4) ** 0.8 * np.minimum(1, (t / 0.10 + 0.05)) ** 0.3
    half = np.stack([x, y], 1)
    whole = np.concatenate([half * [1, -1], half[-2::-1]])
    whole[:, 0] += 0.5 - round_corners(whole, 0.03)[:, 0].max()

    def boat(radius: float, margin: float) -> np.ndarray:
        """Return the outline with corners of a radius, moved inwards by a margin."""
        ring = round_corners(whole, radius)
        return inset(resample_evenly(np.append(ring, ring[:1], axis=0), 80)[:-1], margin)

    sole = prism([boat(0.03, 0.0)], 0.05, SPACING, 0.014)
    skirt = prism([boat(0.05, 0.016)], 0.06, SPACING, 0.008).translate((0, 0, 0.03))
    body = prism([boat(0.09, 0.022)], 0.22, SPACING, 0.05, 5).translate((0, 0, 0.045))

    def lean(points: np.ndarray) -> np.ndarray:
        up = np.clip((points[:, 2] - 0.09) / 0.175, 0, 1)
        front = np.clip((points[:, 0] + 0.10) / 0.5, 0, 1)
        x = -0.28 + (points[:, 0] + 0.28) * (1 - 0.20 * up)
        z = 0.045 + (points[:, 2] - 0.045) * (1 - 0.42 * up * front)
        return np.stack([x, points[:, 1] * (1 - 0.34 * up), z], 1)

    body = body.warp_batch(lean)
    grip = loop([(-0.29, 0.20), (-0.32, 0.44), (0.10, 0.425), (0.17, 0.16)], 0.09, 0.105 * plump, 0.085, 2.6)
    drill = manifold3d.Manifold.cylinder(0.05, 0.014, circular_segments=16)
    holes = [
        drill.translate((0.40 - 0.075 * k, s * y, -0.025))
        for k, y in enumerate([0.0, 0.035, 0.065, 0.09, 0.105, 0.115])
        for s in ((-1, 1) if y > 0 else (1,))
    ]
    dial = rounded_disc(0.075, 0.06, 0.014, 40).translate((-0.08, 0, 0.235))
    mark = prism([rectangle(0.06, 0.018, 0.006, 2)], 0.02, SPACING).translate((-0.055, 0, 0.285))
    button = rounded_disc(0.035, 0.06, 0.012, 28).translate((0.06, 0, 0.42))
    nozzle = manifold3d.Manifold.sphere(0.032, 28).translate((0.285, 0, 0.165))
    cord = bar((-0.28, 0, 0.385), (-0.52, 0, 0.412), (0.060, 0.042), SPACING, 20)
    cord = cord.trim_by_plane((1.0, 0, 0), -0.5)
    rings = [torus(0.026 - 0.002 * k, 0.022, 10).rotate((0, 84, 0)) for k in range(3)]
    rings = [one.translate((-0.375 - 0.035 * k, 0, 0.397 + 0.004 * k)) for k, one in enumerate(rings)]
    accent = kit.look.accent
    kit.body(METAL, sole)
    kit.body(accent, skirt)
    kit.body(kit.look.color, body)
    kit.body(accent, grip, piece=1)
    kit.cut(DARK, *holes)
    kit.detail(accent, dial, piece=2)
    kit.detail("d23b30", mark, button)
    kit.detail(METAL, nozzle)
    kit.detail(DARK, cord, *rings)


def _dryer(kit: Kit, plump: float) -> None:
    """Build a hair dryer upright on its grip: a barrel along x, open in front, slotted at the rear."""
    w, axis = plump, 0.98 - 0.175 * plump

    def along(solid: manifold3d.Manifold) -> manifold3d.Manifold:
        """Turn a solid of revolution from z to +x, at the height of the barrel."""
        return solid.rotate((0, 90, 0)).translate((0, 0, axis))

    r = np.array([0, 0.115, 0.175, 0.175, 0.115, 0.115, 0]) * w
    at = np.array([-0.27, -0.27, -0.19, 0.0, 0.26, 0.44, 0.44])
    barrel = round_polyline(np.stack([r, at], 1), np.array([0.03, 0.12, 0.25, 0.12, 0.012]))
    r = np.array([0, 0.085, 0.135, 0.135, 0.080, 0.080, 0]) * w
    at = np.array([-0.225, -0.225, -0.18, 0.0, 0.26, 0.60, 0.60])
    bore = round_polyline(np.stack([r, at], 1), np.array([0.02, 0.08, 0.2, 0.1, 0.01]))
    places = ((0.113, 0.425), (0.175, 0.02), (0.175, -0.03))
    collars = [along(torus(w * r, 0.04, 12).translate((0, 0, x))) for r, x in places]
    grille = bars([0.10 * w, 0.15 * w, 0.15 * w, 0.10 * w], 0.026, 0.05 * w, 0.10)
    grille = _face_x(grille).translate((-0.26, 0, axis))

    path = np.array([[0.0, 0, axis], [-0.01, 0, 0.60], [-0.03, 0, 0.40], [-0.05, 0, 0.20], [-0.06, 0, -0.02]])
    fine = np.linspace(0, 1, 40)
    path = np.stack([np.interp(fine, np.linspace(0, 1, 5), path[:, k]) for k in range(3)], 1)
    swell = 1 + 0.10 * np.sin(np.pi * fine) + 0.25 * smoothstep(0.3, 0.0, fine)
    grip = tube(path, 0.125 * w * swell, 0.15 * w * swell, (0.0, 1.0, 0.0), 32, 2.5)
    grip = grip.trim_by_plane((0, 0, 1.0), 0.0)
    ribs = []
    for z in (0.07, 0.12, 0.17, 0.22, 0.27):
        x = -0.052 - 0.07 * (0.2 - z)
        ends = np.array([[x, 0, z - 0.013], [x, 0, z + 0.013]])
        ribs.append(tube(ends, 0.150 * w, 0.175 * w, (0.0, 1.0, 0.0), 32, 2.5))
    switch = _face_x(extrude_y([rectangle(0.07, 0.085, 0.02, 4)], 0.08, SPACING, 0.012))
    dark = kit.look.accent
    kit.body(kit.look.color, along(turn_profile(barrel)))
    kit.body(kit.look.color, grip, axis=(0, 0, 1), piece=1)
    kit.body(dark, *collars, axis=None)
    kit.cut(DARK, along(turn_profile(bore)), grille)
    kit.detail(dark, *ribs, axis=(0, 0, 1))
    kit.detail("eef0ea", switch.translate((0.045, 0, 0.52)), axis=(0, 0, 1))
    kit.detail("d23b30", switch.translate((0.035, 0, 0.40)), axis=(0, 0, 1))


#: By kind: its maker, and its colour and accent where none is asked for.
MAKERS = {
    "toaster": (_toaster, "b4bac0", "2e2f33"),
    "lantern": (_lantern, "4a4b50", "f4b740"),
    "iron": (_iron, "2f7fc1", "eef0ea"),
    "dryer": (_dryer, "e9b93a", "2e2f33"),
}
