"""Hollow turned vessels: finish of both sides, lobes, and assembly."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import manifold3d
import numpy as np

from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes.atlas import Paint, pack_charts
from objectfolder.shapes.extrusion import solid
from objectfolder.shapes.finish import Finish, finish
from objectfolder.shapes.parameters import Order
from objectfolder.shapes.revolution import revolve
from objectfolder.shapes.section import COARSE, half_outline, resample_rows, split_at_lip
from objectfolder.shapes.solid import bake_mesh, group_coincident, weld_patches
from objectfolder.shapes.texture import lattice, noise, over, rgb, smoothstep

CLAY = rgb("b08a66")  #: bare clay at the foot of a glazed vessel and through the thin glaze at its lip

Warp = Callable[[np.ndarray], np.ndarray]  #: points (N, 3), m -> points (N, 3), m


@dataclass(frozen=True)
class VesselFinish(Finish):
    """Finish of a vessel; the paint of its inside continues that of its outside at the lip."""

    inside: Paint


def vessel_finish(order: Order, size: float, lip: float, foot: float) -> VesselFinish:
    """Return the finish of a vessel.

    A glazed vessel is dipped: the accent covers the inside and runs over the lip, and the foot stays bare.
    Any other finish is the same on both sides. ``size`` is the vessel's longest side, ``lip`` the height of
    its lip, and ``foot`` that up to which the foot is bare, m.
    """
    name, color, accent, seed = order.finish, order.color, order.accent, order.seed
    body = finish(name, size, color, accent if name != "glaze" else None, seed)
    if name != "glaze":
        return VesselFinish(body.paint, body.roughness, body.metallic, body.paint)
    lining = body if accent is None else finish(name, size, accent, None, seed + 1)
    values = lattice(seed)
    u = size / 0.1
    v = min(u, lip / 0.05)  # narrower on flat vessels

    def thin(points: np.ndarray, colour: np.ndarray) -> np.ndarray:
        """Let clay show through at the lip."""
        edge = lip - v * (0.0012 + 0.0004 * noise(points / (0.006 * u), values))
        return over(colour, CLAY, 0.7 * smoothstep(-0.001 * v, 0.001 * v, points[:, 2] - edge))

    def outside(points: np.ndarray) -> np.ndarray:
        z = points[:, 2]
        colour = body.paint(points)
        if lining is not body:
            drip = v * (0.013 + 0.0045 * noise(points * [1, 1, 0.2] / (0.016 * u) + 3, values, 2))
            dipped = smoothstep(-0.0006 * v, 0.0006 * v, z - lip + drip)
            wet = dipped > 0
            colour[wet] = over(colour[wet], lining.paint(points[wet]), dipped[wet])
        colour = thin(points, colour)
        stands = z < foot + 0.001 * u
        low = points[stands]
        bare = CLAY * (1 + 0.03 * noise(low / (0.0015 * u), values, 2))[:, None]
        edge = foot + 0.0002 * u * noise(low / (0.004 * u), values)
        colour[stands] = over(colour[stands], bare, smoothstep(0.0003 * u, -0.0003 * u, low[:, 2] - edge))
        return colour

    def inside(points: np.ndarray) -> np.ndarray:
        return thin(points, lining.paint(points))

    return VesselFinish(outside, body.roughness, body.metallic, inside)


def lobe_warp(
    order: Order, lobes: int, depth: float, weight: Callable[[np.ndarray], np.ndarray], twist: float = 0.0
) -> Warp | None:
    """Return the warp of a round vessel into ``lobes`` lobes, or None without lobes.

    ``depth`` is their amplitude in radii, on which ``weight`` maps points (N, 3) to factors (N,) in [0, 1];
    ``twist`` rotates them with height, in turns per metre.
    """
    whole = isinstance(lobes, int) and not isinstance(lobes, bool)
    if not whole or (lobes and not 3 <= lobes <= 12):
        order.refuse("lobes", lobes, "0 (round) or a whole number from 3 to 12")
    order.between(0.0, 0.1, "a share of the radius", lobe_depth=depth)
    if not lobes or not depth:
        return None

    def warp(points: np.ndarray) -> np.ndarray:
        angle = np.arctan2(points[:, 1], points[:, 0]) - 2 * np.pi * twist * points[:, 2]
        factor = 1 + depth * weight(points) * np.cos(lobes * angle)
        return points * np.stack([factor, factor, np.ones(len(points))], 1)

    return warp


def build_vessel(
    order: Order, section: manifold3d.CrossSection, size: float, lip: float, foot: float, warp: Warp | None
) -> TexturedMesh:
    """Build the textured mesh of a vessel from its cross-section; other lengths as of `vessel_finish`."""
    look = vessel_finish(order, size, lip, foot)
    outer, inner = split_at_lip(half_outline(section, order.generator))
    parts = revolve(outer, 0, look.paint)
    parts += revolve(inner, len(parts), look.inside)
    atlas = pack_charts([chart for _, chart in parts], order.texture_size)
    patches = [patch for patch, _ in parts]
    if warp is not None:
        patches = [replace(patch, vertices=warp(patch.vertices)) for patch in patches]
    return bake_mesh(weld_patches(patches, atlas), atlas, look.roughness, look.metallic)


def revolve_solid(profile: np.ndarray, coarse: float = COARSE) -> manifold3d.Manifold:
    """Revolve a dense profile (N, 2), m, that starts and ends on the axis, into an unpainted solid.

    ``coarse`` is the allowed deviation from the profile, in its sizes.
    """
    top = int(np.argmax(profile[:, 1]))
    halves = [half for half in (profile[: top + 1], profile[top:]) if len(half) > 1]
    rows = [resample_rows(half, profile, coarse) for half in halves]
    even = np.concatenate([rows[0], *(row[1:] for row in rows[1:])])
    patches = [patch for patch, _ in revolve(even, 0, lambda points: points)]
    vertices = np.concatenate([patch.vertices for patch in patches])
    starts = np.cumsum([0, *(len(patch.vertices) for patch in patches)])
    faces = np.concatenate([patch.faces + start for patch, start in zip(patches, starts)])
    first, group = group_coincident(vertices)
    return solid(vertices[first], group[faces])
