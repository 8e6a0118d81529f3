"""Electronics in metres, standing on z = 0 and facing -y: a television, a table radio and an alarm clock."""

from itertools import product

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.extrusion import extrude_y, inset, polygon, rectangle
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
    turn_profile,
)
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.sweep import bar
from objectfolder.shapes.texture import over, rgb, smoothstep, stroke


@generator("plastic")
def electronics(order: Order, kind: str = "television", span: Size = 0.6, plump: Size = 1.0) -> TexturedMesh:
    """Build a television with an antenna, a table radio or an alarm clock with two bells.

    One closed surface. Televisions and radios are hollow and open through their slots, with walls of 4 %
    of the span; the thinnest bars have 2.5 %, grooves and marks about 2 %.

    Parameters
    ----------
    kind : str
        "television", "radio" or "clock".
    span : float
        Width of a television or radio along x; height of a clock, m.
    plump : float
        Depth relative to the default, 0.8 to 1.25.
    accent : str, optional
        Colour of the bezel and the panel, of the radio's dial, or of the clock's face.
    """
    return build_kind(order, kind, MAKERS, span, plump, "usual depths")


def superellipse(half_width: float, half_height: float, power: float, points: int = 72) -> np.ndarray:
    """Return the outline (points, 2) of a superellipse about the origin."""
    angle = 2 * np.pi * np.arange(points) / points
    ray = np.stack([np.cos(angle), np.sin(angle)], 1)
    return ray / np.sum(np.abs(ray) ** power, 1, keepdims=True) ** (1 / power) * [half_width, half_height]


def _taper(solid: manifold3d.Manifold, length: float, end: float, middle: float) -> manifold3d.Manifold:
    """Shrink a solid about the height ``middle``, linearly in y from 1 at 0 to ``end`` at ``length``."""

    def narrow(points: np.ndarray) -> np.ndarray:
        scale = 1 + (end - 1) * points[:, 1] / length
        lift = [0.0, 0.0, middle]
        return lift + (points - lift) * np.stack([scale, np.ones_like(scale), scale], 1)

    return solid.warp_batch(narrow)


def _television(kit: Kit, plump: float) -> None:
    """Build a tube television on four legs, with knobs beside the screen and vents in its back."""
    deep, wall, middle = 0.38 * plump, 0.04, 0.37
    front, rear, tail = -deep / 2, deep / 2, 0.12
    at, half = -0.125, (0.30, 0.225)  # centre of the screen along x, its half width and height
    glass = superellipse(*half, 4.0)

    case = extrude_y([rectangle(1.0, 0.60, 0.08)], deep, SPACING, 0.035).translate((0, 0, middle))
    bump = extrude_y([rectangle(0.70, 0.46, 0.07)], tail + 0.02, SPACING, 0.02)
    bump = bump.translate((0, (tail - 0.02) / 2, middle))
    bump = _taper(bump, tail, 0.8, middle).translate((0, rear, 0))
    bezel = extrude_y([inset(glass, -0.035)], 0.03, SPACING, 0.01).translate((at, front, middle))
    panel = extrude_y([rectangle(0.24, 0.50, 0.04)], 0.03, SPACING, 0.006).translate((0.345, front, middle))

    cavity = extrude_y([rectangle(1 - 2 * wall, 0.60 - 2 * wall, 0.05)], deep - 0.09 - wall, 1.5 * SPACING)
    cavity = cavity.translate((0, (0.09 - wall) / 2, middle))
    deeper = extrude_y([rectangle(0.70 - 2 * wall, 0.46 - 2 * wall, 0.04)], tail + wall, 1.5 * SPACING)
    deeper = _taper(deeper.translate((0, tail / 2 - 1.5 * wall, middle)), tail, 0.8, middle)
    deeper = deeper.translate((0, rear, 0))
    vents = bars([0.36] * 5, 0.026, 0.054, 4 * wall).translate((0, rear + tail, middle))
    # The recess flares towards the viewer.
    recess = extrude_y([glass], 0.10, SPACING)
    recess = _taper(recess, 0.05, 0.95, 0.0).translate((at, front, middle))
    grille = bars([0.15] * 5, 0.018, 0.036, 0.06).translate((0.345, front - 0.015, 0.235))

    screen = extrude_y([inset(glass, -0.012)], 0.03, SPACING)

    def bulge(points: np.ndarray) -> np.ndarray:
        share = np.clip(1 - (points[:, [0, 2]] / half) ** 2, 0, 1)
        return points - np.outer(0.045 * share[:, 0] * share[:, 1] * (points[:, 1] < 0), [0, 1, 0])

    screen = screen.warp_batch(bulge).translate((at, front + 0.05, middle))

    def shine(points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        across_, up = (points[:, 0] - at) / half[0], (points[:, 2] - middle) / half[1]
        glow = smoothstep(1.15, 0.2, np.hypot(across_, up))
        lines = 1 - 0.10 * stroke((points[:, 2] / 0.012) % 1.0 - 0.5, 0.18, 0.2)
        return over(colour, rgb("a9c4b4"), 0.75 * glow) * lines[:, None]

    legs = [
        bar((x * 0.34, y * 0.30 * deep, 0.12), (x * 0.40, y * 0.40 * deep, -0.02), (0.065, 0.042), SPACING)
        for x, y in product((-1, 1), repeat=2)
    ]
    antenna = [bar((0.0, 0.05, 0.68), (x * 0.27, 0.05, 0.955), (0.028, 0.024), SPACING, 16) for x in (-1, 1)]
    tips = [manifold3d.Manifold.sphere(0.024, 24).translate((x * 0.27, 0.05, 0.956)) for x in (-1, 1)]
    foot = manifold3d.Manifold.sphere(1.0, 40).scale((0.10, 0.07, 0.05)).translate((0, 0.05, 0.665))

    body, trim = kit.look.color, kit.look.accent
    knobs = [
        knob(0.07, 0.045, turn=turn).translate((0.345, front - 0.013, z))
        for z, turn in ((0.53, 40.0), (0.37, -25.0))
    ]
    kit.body(body, case)
    kit.body(body, bump, piece=2)
    kit.body(trim, bezel, panel, piece=1)
    kit.cut(DARK, cavity + deeper, vents, grille)
    kit.cut(trim, recess, piece=1)
    kit.detail("39443f", screen, decor=shine)
    kit.detail(DARK, *(one.trim_by_plane((0, 0, 1.0), 0.0) for one in legs), axis=(0, 0, 1))
    kit.detail(METAL, *antenna, *tips)
    kit.detail(DARK, foot, *knobs)


def _radio(kit: Kit, plump: float) -> None:
    """Build a table radio: a slotted grille, a dial with a needle, knobs, and a handle."""
    deep, wall, middle, tall = 0.30 * plump, 0.045, 0.295, 0.50
    front = -deep / 2
    speaker, dial = (-0.22, middle), (0.245, 0.375)

    case = extrude_y([rectangle(1.0, tall, 0.13, 7)], deep, SPACING, 0.04, 4).translate((0, 0, middle))
    rim = extrude_y([polygon(64, 0.225)], 0.04, SPACING, 0.012).translate((speaker[0], front, speaker[1]))
    ring = extrude_y([polygon(64, 0.145)], 0.04, SPACING, 0.012).translate((dial[0], front, dial[1]))
    arch = [(-0.32, 0.50), (-0.32, 0.70), (0.32, 0.70), (0.32, 0.50)]
    handle = loop(arch, 0.11, 0.09, 0.05, 2.8)

    cavity = extrude_y([rectangle(1 - 2 * wall, tall - 2 * wall, 0.09)], deep - 2 * wall, SPACING)
    rise = 0.062 * (np.arange(6) - 2.5)
    grille = bars(list(2 * np.sqrt(0.185**2 - rise**2)), 0.025, 0.062, 0.14)
    vents = bars([0.30, 0.42, 0.42, 0.30], 0.025, 0.062, 0.14)
    basin = extrude_y([polygon(64, 0.195)], 0.04, SPACING).translate((speaker[0], front - 0.018, speaker[1]))
    cover = extrude_y([rectangle(0.62, 0.32, 0.06)], 0.03, SPACING, 0.01).translate((0, -front, middle))
    face = extrude_y([polygon(64, 0.12)], 0.04, SPACING).translate((dial[0], front - 0.018, dial[1]))

    pointer = np.array([[-0.013, -0.03], [0.013, -0.03], [0.009, 0.10], [-0.009, 0.10]])
    needle = extrude_y([pointer], 0.03, 0.02).rotate((0, 35, 0)).translate((dial[0], front + 0.005, dial[1]))
    hub = extrude_y([polygon(24, 0.028)], 0.05, SPACING, 0.01).translate((dial[0], front + 0.002, dial[1]))
    foot, corners = rounded_disc(0.045, 0.08, 0.01, 32), product((-1, 1), repeat=2)
    feet = [foot.translate((x * 0.36, y * 0.25 * deep, 0)) for x, y in corners]

    def scale(points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        x, z = points[:, 0] - dial[0], points[:, 2] - dial[1]
        r, turn = np.hypot(x, z), np.degrees(np.arctan2(x, z))
        on = (r < 0.118) & (points[:, 1] > front - 0.005)
        paper = over(colour, rgb(kit.look.accent or "e6d3a8"), 0.92 * on)
        fine = stroke((turn / 15 + 0.5) % 1.0 - 0.5, 0.06, 0.05) * stroke(r - 0.098, 0.010, 0.004)
        coarse = stroke((turn / 45 + 0.5) % 1.0 - 0.5, 0.035, 0.03) * stroke(r - 0.090, 0.020, 0.004)
        band = stroke(r - 0.066, 0.003, 0.003)
        inked = np.maximum(np.maximum(fine, coarse), band) * on * (np.abs(turn) < 140)
        return over(paper, rgb("3a2414"), inked)

    dark = "4a2a17"
    turns = ((0.15, -30.0), (0.34, 50.0))
    knobs = [knob(0.056, 0.05, turn=turn).translate((x, front, 0.155)) for x, turn in turns]
    kit.body(kit.look.color, case)
    kit.body(dark, rim, piece=1)
    kit.body(dark, ring, piece=2)
    kit.body(dark, cover, piece=8)
    kit.cut(dark, cavity.translate((0, 0, middle)), grille.translate((speaker[0], front, speaker[1])))
    kit.cut(dark, vents.translate((0, -front, middle)))
    kit.cut(kit.look.color, basin, piece=3)
    kit.cut(kit.look.accent, face, piece=4, decor=scale)
    kit.detail(dark, handle, piece=5)
    kit.detail("b3301f", needle, axis=(0, 0, 1))
    kit.detail(dark, hub)
    kit.detail(dark, *feet, axis=(0, 0, 1), piece=6)
    kit.detail("d9b27c", *knobs, axis=None, piece=7)


def _clock(kit: Kit, plump: float) -> None:
    """Build an alarm clock: a drum with raised marks and hands, two bells, a hammer, and three legs."""
    deep, middle, radius, inner = 0.22 * plump, 0.44, 0.30, 0.245
    front, face = -deep / 2, -deep / 2 + 0.035

    def facing(outline: np.ndarray, top: float, turn: float = 0.0) -> manifold3d.Manifold:
        """Extrude an outline about the centre of the face, from within the drum to above the face."""
        plate = extrude_y([outline], top + 0.02, SPACING, 0.2 * top, 1)
        return plate.translate((0, face + 0.01 - top / 2, 0)).rotate((0, turn, 0)).translate((0, 0, middle))

    drum = extrude_y([polygon(80, radius)], deep, SPACING, 0.03, 4).translate((0, 0, middle))
    lip = extrude_y([polygon(80, radius + 0.022)], 0.06, SPACING, 0.02, 4)
    lip = lip.translate((0, front + 0.025, middle))
    back = extrude_y([polygon(64, 0.22)], 0.04, SPACING, 0.012).translate((0, -front, middle))
    recess = extrude_y([polygon(80, inner)], 0.10, SPACING).translate((0, face - 0.05, middle))

    quarter, other = (
        rectangle(width, length, 0.25 * width, 2) + np.array([0.0, at])
        for width, length, at in ((0.030, 0.055, 0.195), (0.022, 0.034, 0.205))
    )
    marks = [facing(other, 0.018, 30.0 * k) if k % 3 else facing(quarter, 0.022, 30.0 * k) for k in range(12)]
    hour = facing(np.array([[-0.020, -0.03], [0.020, -0.03], [0.012, 0.11], [-0.012, 0.11]]), 0.022, -55.0)
    minute = facing(np.array([[-0.016, -0.04], [0.016, -0.04], [0.010, 0.165], [-0.010, 0.165]]), 0.034, 60.0)
    pin = facing(polygon(24, 0.026), 0.046)

    dome = _bell().translate((0, 0, 0.375))
    bells = [dome.rotate((0, turn, 0)).translate((0, 0, middle)) for turn in (-36.0, 36.0)]
    high = middle + 0.505 * np.cos(np.radians(36.0))
    out = 0.505 * np.sin(np.radians(36.0))
    arch = [(-out, high - 0.02), (-0.75 * out, 0.975), (0.75 * out, 0.975), (out, high - 0.02)]
    handle = loop(arch, 0.08, 0.07, 0.05)
    stem = bar((0, 0, 0.70), (0, 0, 0.83), (0.036, 0.036), SPACING, 20)
    head = extrude_y([rectangle(0.12, 0.06, 0.02, 4)], 0.07, SPACING, 0.015).translate((0, 0, 0.82))

    slant = np.radians(38.0)
    feet = [(-0.36 * np.sin(slant), -0.22 * deep), (0.36 * np.sin(slant), -0.22 * deep), (0.0, 0.75 * deep)]
    ball = 0.042
    legs = [bar((0.7 * x, 0.5 * y, 0.24), (x, y, ball), (0.05, 0.044), SPACING, 24) for x, y in feet]
    balls = [manifold3d.Manifold.sphere(ball, 24).translate((x, y, ball - 1e-3)) for x, y in feet]
    stand = [(leg + tip).trim_by_plane((0, 0, 1.0), 0.0) for leg, tip in zip(legs, balls)]
    key = knob(0.05, 0.06, 6).rotate((0, 0, 180))
    keys = [key.translate((x, -front + 0.018, middle + 0.03)) for x in (-0.1, 0.1)]

    def dial(points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        x, z = points[:, 0], points[:, 2] - middle
        r, turn = np.hypot(x, z), np.degrees(np.arctan2(x, z))
        within = 0.95 * smoothstep(inner + 0.001, inner - 0.004, r)
        paper = over(colour, rgb(kit.look.accent or "f3ecdd"), within)
        minutes = stroke((turn / 6 + 0.5) % 1.0 - 0.5, 0.08, 0.08) * stroke(r - 0.232, 0.006, 0.003)
        return over(paper, rgb(DARK), minutes * (np.abs(points[:, 1] - face) < 0.004))

    kit.body(kit.look.color, drum)
    kit.body(METAL, lip, back)
    kit.cut(kit.look.accent, recess, decor=dial)
    kit.detail(DARK, *marks, hour, minute)
    kit.detail(METAL, pin)
    kit.detail("d9b24c", *bells, axis=None)
    kit.detail(METAL, handle, stem, *keys)
    kit.detail(DARK, head)
    kit.detail(METAL, *stand)


def _bell() -> manifold3d.Manifold:
    """Build a bell open towards -z, on a post that reaches down from its crown, with a button on top."""
    t = np.linspace(0, np.pi / 2, 40)
    outer = np.stack([0.145 * np.cos(t), 0.12 * np.sin(t)], 1)
    inner = np.stack([0.115 * np.cos(t[::-1]), 0.09 * np.sin(t[::-1])], 1)
    shell = manifold3d.CrossSection([np.concatenate([outer[::3], inner[::3]])]).revolve(48)
    post = manifold3d.Manifold.cylinder(0.24, 0.024, circular_segments=24).translate((0, 0, -0.13))
    button = turn_profile([[0, 0.10], [0.032, 0.10], [0.030, 0.125], [0.018, 0.138], [0, 0.14]])
    return shell + post + button


#: By kind: its maker, and its colour and accent where none is asked for.
MAKERS = {
    "television": (_television, "5f8f8b", "d9cfb8"),
    "radio": (_radio, "a56b3c", "e6d3a8"),
    "clock": (_clock, "c8412f", "f3ecdd"),
}
