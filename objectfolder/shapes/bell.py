"""A steel hand-bell without a clapper, in metres, standing on its lip at z = 0."""

import numpy as np
from scipy.interpolate import CubicSpline

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.atlas import pack_charts
from objectfolder.shapes.parameters import Order, Size, generator
from objectfolder.shapes.revolution import arc, arc_length, disc, polyline, sleeve
from objectfolder.shapes.solid import bake_mesh, weld_patches
from objectfolder.shapes.texture import lattice, noise, over, rgb, smoothstep, stroke

SEED = 1887
RIM = 1.5  #: thickness at the lip, in thicknesses of the wall
SHELL = 0.66  #: height of the shell, in heights of the bell
STEM, KNOB = 0.11, 0.21  #: radii of the handle, in radii of the bell


@generator()
def bell(order: Order, height: Size = 0.09, radius: Size = 0.045, wall: Size = 0.003) -> TexturedMesh:
    """Build a hand-bell: a flared shell, open below, with a stem and a ball to hold.

    One closed surface of genus 0; x and y from -radius to radius, z from 0 to height.

    Parameters
    ----------
    height : float
        Height from the lip to the top of the ball, m.
    radius : float
        Outer radius at the lip, m.
    wall : float
        Thickness of the shell, m; half as much again at the lip.
    """
    order.between(1.4 * radius, 4.0 * radius, "1.4 to 4 radii", height=height)
    order.between(0.02 * radius, 0.10 * radius, "2 % to 10 % of the radius", wall=wall)

    decor = _Decor(height, radius)
    dome, inside, outside, crown, stem, ball = profiles(height, radius, wall)
    parts = [
        disc(dome, 0, decor.inside),
        sleeve(inside, 1, decor.inside),
        sleeve(outside, 2, decor.outside),
        disc(crown, 3, decor.outside),
        sleeve(stem, 4, decor.outside),
        disc(ball, 5, decor.outside),
    ]
    atlas = pack_charts([chart for _, chart in parts], order.texture_size)
    return bake_mesh(weld_patches([patch for patch, _ in parts], atlas), atlas, roughness=0.35)


def profiles(height: float, radius: float, wall: float) -> list[np.ndarray]:
    """Return half of the bell's section, m, from the axis inside, around the lip, to the axis on top.

    Polylines (N, 2), one per chart: dome and wall inside, wall and crown outside, stem, ball.
    """
    lip = RIM * wall / 2
    shell = SHELL * height
    r = np.array([1.00, 0.96, 0.87, 0.75, 0.64, 0.54, 0.40, 0.20, 0.00])
    z = np.array([0.0, 0.09, 0.19, 0.34, 0.58, 0.80, 0.94, 0.99, 1.00])
    knots = np.stack([r * radius, z * (shell - lip) + lip], 1)
    chord = arc_length(knots)
    # Vertical at the lip and level on the axis, so that both sides of the wall meet them squarely.
    curve = CubicSpline(chord, knots, bc_type=((1, [0.0, 1.0]), (1, [-1.0, 0.0])))
    t = np.linspace(0, chord[-1], 29)
    outer, slope = curve(t), curve(t, 1)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    normal = np.stack([-slope[:, 1], slope[:, 0]], 1)  # to the left: into the metal
    thickness = wall * (1 + (RIM - 1) * np.exp(-((t / (0.16 * shell)) ** 2)))
    inner = outer + thickness[:, None] * normal
    inner[-1, 0] = 0.0
    forward = np.sum(np.diff(inner, axis=0) * slope[1:], axis=1)
    if forward.min() <= 0 or inner[:-1, 0].min() <= 0:
        raise ObjectFolderError(
            f"bell: wall={wall!r}: expected a wall thin enough for the bend of a shell of height {shell:.4g} "
            f"and radius {radius:.4g}; make the wall thinner"
        )

    shoulder = _shoulder(slope)
    rim = arc((radius - lip, lip), lip, -np.pi, 0, 8)
    neck, grip = STEM * radius, KNOB * radius
    foot = int(np.argmax(outer[:, 0] < 1.9 * neck))
    collar_r, collar_z = outer[foot]
    middle = height - grip
    join = np.arcsin(neck / grip)
    # A quarter ellipse carries the crown into the stem.
    bend = np.linspace(-np.pi / 2, -np.pi, 7)
    span = np.array([collar_r - neck, 0.9 * (collar_r - neck)])
    collar = [collar_r, collar_z + span[1]] + np.stack([np.cos(bend), np.sin(bend)], 1) * span
    return [
        inner[shoulder:][::-1],
        np.concatenate([inner[: shoulder + 1][::-1], rim[1 : len(rim) // 2 + 1]]),
        np.concatenate([rim[len(rim) // 2 : -1], outer[: shoulder + 1]]),
        outer[shoulder : foot + 1],
        polyline(collar, arc((0.0, middle), grip, join - np.pi / 2, 0, 7), step=0.03 * height),
        np.concatenate([arc((0.0, middle), grip, 0, np.pi / 2, 8)[:-1], [[0.0, height]]]),
    ]


def _shoulder(slope: np.ndarray) -> int:
    """Return the index above the flare from which the shell leans in by more than 45 degrees."""
    steep = np.flatnonzero(slope[:, 1] > -slope[:, 0])
    return int(steep[-1]) + 1


class _Decor:
    """Brushed and engraved steel for a bell of one size; methods map points (N, 3) to sRGB (N, 3)."""

    def __init__(self, height: float, radius: float):
        self.height, self.radius = height, radius
        self.values = lattice(SEED)

    def _brushed(self, points: np.ndarray, base: np.ndarray) -> np.ndarray:
        """Steel with the fine circular marks of a lathe and warm, cloudy patina."""
        r = np.hypot(points[:, 0], points[:, 1]) / self.radius
        z = points[:, 2] / self.height
        turn = points[:, :2] / np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)[:, None]
        # r falls as z rises
        lathe = np.column_stack([1.5 * turn * np.minimum(r, 1)[:, None] ** 0.5, 130 * z - 100 * r])
        marks = noise(lathe, self.values, 3)
        cloud = noise(points / self.radius * 1.7, self.values, 4)
        colour = base * (1 + 0.065 * marks + 0.03 * cloud)[:, None]
        return over(colour, rgb("6f6250"), 0.38 * smoothstep(0.2, 2.2, cloud))

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Darker and duller than the outside, but the same at the lip."""
        deep = smoothstep(0.0, 0.25 * self.height, points[:, 2])
        base = over(np.broadcast_to(rgb("9ba2a9"), points.shape), rgb("5c5e61"), deep)
        return self._brushed(points, base)

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Engraved rings, and a frieze of lozenges between two of them."""
        z = points[:, 2] / (SHELL * self.height)
        angle = np.arctan2(points[:, 1], points[:, 0])
        colour = self._brushed(points, np.broadcast_to(rgb("9ba2a9"), points.shape))
        groove, glint = rgb("35363a"), rgb("e4e7ea")
        for level, half in ((0.085, 0.006), (0.115, 0.004), (0.33, 0.005), (0.50, 0.005), (0.84, 0.006)):
            colour = over(colour, glint, 0.7 * stroke(z - level - 1.7 * half, 0.6 * half, half))
            colour = over(colour, groove, 0.85 * stroke(z - level, half, 0.6 * half))
        count = 20
        x = np.abs((angle / (2 * np.pi) * count) % 1.0 - 0.5)
        y = np.abs(z - 0.415) / 0.17
        lozenge = x + y
        colour = over(colour, groove, 0.8 * stroke(lozenge - 0.40, 0.022, 0.02))
        colour = over(colour, rgb("7d6a4c"), 0.75 * smoothstep(0.27, 0.24, lozenge))
        corner = np.hypot(x - 0.5, 1.2 * (y - 0.30))
        colour = over(colour, groove, 0.75 * smoothstep(0.07, 0.05, corner))
        seat = np.abs(points[:, 2] - SHELL * self.height) / self.height
        near = smoothstep(0.35 * self.radius, 0.1 * self.radius, np.hypot(points[:, 0], points[:, 1]))
        return over(colour, rgb("4d463c"), 0.5 * near * smoothstep(0.05, 0.0, seat))
