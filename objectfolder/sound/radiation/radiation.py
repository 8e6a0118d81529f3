"""Sound that each vibration mode of an object sends out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from objectfolder.mesh.topology import face_areas, outer_shells
from objectfolder.sound.click import AIR_DENSITY, SOUND_SPEED, Recoil
from objectfolder.sound.radiation.boundary import Boundary
from objectfolder.sound.radiation.farfield import MAX_ORDER, FarField, pack_far_field
from objectfolder.sound.radiation.harmonics import Radiator, degrees
from objectfolder.sound.radiation.meshing import (
    even_surface,
    finer_surface,
    interpolate_motion,
    outward_motion,
    transfer_flow,
)
from objectfolder.sound.radiation.triangles import Triangles

EDGES_PER_WAVE = 2.0  #: of sound; with fewer, a surface radiates as plane waves do
MODE_EDGES_PER_WAVE = 5.0  #: edges per wave that a mode's surface has, if it may have so many triangles
MIN_TRIANGLES = 2000  #: triangles of a surface, however long the waves are
_MOTION_EDGE = 0.5  # of a triangle's edge, on which modes' motions are read from the exact surface
_EXTRA_ORDERS = 4  # orders of harmonics beyond the wavenumber times the radius
_SHARED_SPAN = 0.04  # difference of wavenumbers, times the radius, within which modes share a matrix
_STEP = 1.0  # between the wavenumbers, times the radius, among which dense modes are interpolated
_NODES = np.arange(-3, 5)  # of these wavenumbers, those around a mode: polynomials of degree 7
_DELAY = 0.5  # radii of sound travel, whose phase is left out while matrices are interpolated
_MIN_SAVING = 2.0  # times as many matrices, at least, that interpolation must save; nodes are solved too
# Accepted difference, relative, of fields interpolated with degree 7 and 6
_MAX_INTERPOLATION_ERROR = 0.0075


def radiate(
    surface: tuple[np.ndarray, np.ndarray],
    points: np.ndarray,
    shapes: np.ndarray,
    frequencies: np.ndarray,
    triangles: int,
    fewest: int = MIN_TRIANGLES,
) -> FarField:
    """Compute the far field of each mode, per unit of modal acceleration: Pa m / (m kg^1/2 / s^2).

    The surface, (V, 3) and (F, 3), is closed, metres, object frame. Cavities send nothing out, and are left
    out: the air in one is a problem of its own, with resonances that the boundary elements would see.
    Mass-normalised mode shapes (P, 3, M), kg^-1/2, are known at points (P, 3) near the surface, metres;
    frequencies (M,) are angular, rad/s. Modes are solved on surfaces of at most so many triangles, see
    `even_surface`; those of long waves on a half or a quarter of them, but not fewer than ``fewest``.
    """
    surface = outer_shells(*surface)
    radius = float(np.linalg.norm(surface[0], axis=1).max(initial=0))
    area = float(face_areas(*surface).sum())
    edge = 2 * np.pi * SOUND_SPEED / (MODE_EDGES_PER_WAVE * np.asarray(frequencies))
    needed = area / (edge**2 * np.sqrt(3) / 4)
    counts = [triangles]
    while counts[-1] // 2 >= fewest:
        counts.append(counts[-1] // 2)
    levels = np.array([max(range(len(counts)), key=lambda n: (counts[n] >= each) * n) for each in needed])
    source, flow = _outward_flow(surface, points, shapes, np.sqrt(area / triangles * 4 / np.sqrt(3)))
    parts = []
    for level in np.unique(levels):
        modes = np.flatnonzero(levels == level)
        boundary = Boundary(*even_surface(*surface, counts[level]))
        motion = transfer_flow(source, flow[:, modes], boundary.triangles) / boundary.triangles.area[:, None]
        parts.append((modes, radiate_motion(boundary, motion, np.asarray(frequencies)[modes], radius)))
    return _joined(parts, len(needed), radius)


def _outward_flow(
    surface: tuple[np.ndarray, np.ndarray], points: np.ndarray, shapes: np.ndarray, edge: float
) -> tuple[Triangles, np.ndarray]:
    """Return fine triangles of a surface, and the outward motion of each mode times their areas."""
    fine, faces = finer_surface(*surface, _MOTION_EDGE * edge)
    faces = faces[face_areas(fine, faces) > 0]
    motion = interpolate_motion(points, shapes.reshape(len(points), -1), fine).reshape(len(fine), 3, -1)
    source = Triangles.of(fine, faces)
    return source, outward_motion(fine, faces, motion) * source.area[:, None]


def _joined(parts: list[tuple[np.ndarray, FarField]], count: int, radius: float) -> FarField:
    """Join the far fields of some modes each to one of all."""
    widest = max((field.coefficients.shape[1] for _, field in parts), default=1)
    orders, coefficients = np.zeros(count, int), np.zeros((count, widest), np.complex128)
    for modes, field in parts:
        orders[modes] = field.orders
        coefficients[modes, : field.coefficients.shape[1]] = field.coefficients
    return FarField(orders, coefficients, radius)


def radiate_motion(
    boundary: Boundary, motion: np.ndarray, frequencies: np.ndarray, radius: float
) -> FarField:
    """Compute the far field of motions (N, M) of a boundary's triangles in a ball of some radius.

    Where modes are dense, a mode's field is interpolated between those at equally spaced wavenumbers. Waves
    shorter than two edges are not solved for: the pressure is then that of a plane wave, the specific
    impedance of air times the velocity. Fields with more detail than `MAX_ORDER` keep their power.
    """
    slopes, k = -AIR_DENSITY * motion, np.asarray(frequencies) / SOUND_SPEED
    orders = np.minimum(np.ceil(k * radius).astype(int) + _EXTRA_ORDERS, MAX_ORDER)
    radiator = Radiator(boundary.triangles, int(orders.max(initial=0)))
    of_degree = degrees(radiator.order)

    def sent(wavenumber: float, modes: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Return coefficients of modes, and their power in a last column; (n, H + 1)."""
        found = radiator.coefficients(wavenumber, pressure, slopes[:, modes])
        flow = -boundary.triangles.area @ (pressure * slopes[:, modes]).imag / wavenumber
        return np.concatenate([found, flow[:, None]], axis=1)

    found = np.zeros((len(k), (radiator.order + 1) ** 2 + 1), np.complex128)
    short = k * boundary.mean_edge > 2 * np.pi / EDGES_PER_WAVE
    dense = _dense(k, radius, ~short)
    for modes in _alike(k, _SHARED_SPAN / radius, short):
        wavenumber = float(k[modes].mean())
        found[modes] = sent(wavenumber, modes, -1j * slopes[:, modes] / wavenumber)
    for modes in _alike(k, _SHARED_SPAN / radius, ~short & ~dense):
        wavenumber = float(k[modes].mean())
        found[modes] = sent(wavenumber, modes, boundary.pressure(wavenumber, slopes[:, modes]))
    for modes, each in _interpolated(boundary, slopes, k, radius, dense, sent):
        found[modes] = each
    coefficients, power = found[:, :-1], found[:, -1].real
    coefficients[of_degree > orders[:, None]] = 0
    kept = (abs(coefficients) ** 2).sum(1)
    capped = (orders == MAX_ORDER) & (kept > 0)
    coefficients[capped] *= np.sqrt(power[capped].clip(0) / kept[capped])[:, None]
    return FarField(orders, coefficients, radius)


def pack_radiation(
    field: FarField, surface: tuple[np.ndarray, np.ndarray], scale: float, limit: int
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return tensors and header of what an Object File stores of an object's radiation.

    The surface, (V, 3) and (F, 3), and the longest side, ``scale``, are in metres, the limit in bytes.
    """
    recoil = Recoil.of(surface[0], 1.0)
    header = {
        "kind": "spherical_harmonics",
        "radius": field.radius / scale,
        "recoil": {
            "centre": (recoil.centre / scale).tolist(),
            "axes": recoil.axes.tolist(),
            "radii": (recoil.radii / scale).tolist(),
        },
    }
    return pack_far_field(field, limit), header


def _alike(k: np.ndarray, span: float, chosen: np.ndarray) -> list[np.ndarray]:
    """Group the chosen numbers so that those of a group differ by at most a span; arrays of indices."""
    order = np.argsort(k, kind="stable")
    groups: list[list[int]] = []
    for index in order[chosen[order]]:
        if not groups or k[index] - k[groups[-1][0]] > span:
            groups.append([])
        groups[-1].append(int(index))
    return [np.array(group) for group in groups]


def _dense(k: np.ndarray, radius: float, chosen: np.ndarray) -> np.ndarray:
    """Return which of the chosen wavenumbers lie so densely that `_nodes` are far fewer; (M,) bool.

    The field of a motion changes smoothly with the wavenumber. The lowest modes are few.
    """
    apart, step = _alike(k, _SHARED_SPAN / radius, chosen), _STEP / radius
    if not apart:
        return chosen
    lowest = np.array([k[group].min() for group in apart])
    nodes = np.ceil((k[chosen].max() - lowest) / step) + len(_NODES) - 1
    saved = np.arange(len(apart), 0, -1) - _MIN_SAVING * nodes
    saved[lowest <= -_NODES[0] * step] = 0  # a node would be at a negative wavenumber
    return chosen & (k >= lowest[saved.argmax()]) if saved.max() > 0 else np.zeros_like(chosen)


@dataclass(frozen=True)
class _Node:
    """What is known at one of the equally spaced wavenumbers."""

    modes: np.ndarray  # (n,) modes that are interpolated from here, ascending
    matrix: np.ndarray  # (V, V), and
    right: np.ndarray  # (V, n): `Boundary.system`
    sent: np.ndarray  # (n, C) what the modes send out

    def of(self, modes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return right-hand sides (V, m) and what is sent out (m, C) of some of the modes."""
        rows = np.searchsorted(self.modes, modes)
        return self.right[:, rows], self.sent[rows]


def _interpolated(
    boundary: Boundary,
    slopes: np.ndarray,
    k: np.ndarray,
    radius: float,
    chosen: np.ndarray,
    sent: Callable[[float, np.ndarray, np.ndarray], np.ndarray],
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield modes, and what they send out, (n, C), interpolated between equally spaced wavenumbers.

    ``sent`` computes that of some modes from their pressure at a wavenumber. Near the narrow resonances of
    cavities, where polynomials of degree 7 and 6 differ halfway between two nodes, the matrices are
    interpolated instead, whose entries change smoothly everywhere: a matrix is made in a tenth of the time.
    """
    if not chosen.any():
        return
    step, lowest = _STEP / radius, k[chosen].min()
    place = (k - lowest) / step
    below = np.floor(place).astype(int)

    def solved(number: int) -> _Node:
        near = np.flatnonzero(chosen & (abs(below - number + 0.5) < len(_NODES) / 2))
        wavenumber = float(lowest + number * step)
        matrix, right = boundary.system(wavenumber, slopes[:, near])
        pressure = boundary.solve(matrix.copy(), right)
        return _Node(near, matrix, right, sent(wavenumber, near, pressure))

    halfway = np.array([0.5])
    doubt = lagrange(_NODES, halfway)[0] - np.append(lagrange(_NODES[:-1], halfway)[0], 0)
    known: dict[int, _Node] = {}
    for first in np.unique(below[chosen]) + _NODES[0]:
        known = {number: known.get(number) or solved(number) for number in range(first, first + len(_NODES))}
        nodes = list(known.values())
        modes = np.flatnonzero(chosen & (below + _NODES[0] == first))
        fields = np.stack([node.of(modes)[1] for node in nodes])
        values = np.einsum("ns,snc->nc", lagrange(_NODES, place[modes] - below[modes]), fields)
        difference = np.einsum("s,snc->nc", doubt, fields)
        errors, powers = ((abs(each[:, :-1]) ** 2).sum(1) for each in (difference, values))
        smooth = errors <= _MAX_INTERPOLATION_ERROR**2 * powers
        yield modes[smooth], values[smooth]
        doubtful = np.zeros(len(k), bool)
        doubtful[modes[~smooth]] = True
        for group in _alike(k, _SHARED_SPAN / radius, doubtful):
            wavenumber = float(k[group].mean())
            away = (wavenumber - lowest) / step - np.array(list(known))
            # The phase of some travel is left out of what is interpolated.
            phases = np.exp(1j * _DELAY * _STEP * away)
            shares = (lagrange(_NODES, away[None, -_NODES[0]])[0] * phases).astype(np.complex64)
            pairs = list(zip(shares, nodes, strict=True))
            matrix = sum(share * node.matrix for share, node in pairs)
            right = sum(share * node.of(group)[0] for share, node in pairs)
            yield group, sent(wavenumber, group, boundary.solve(matrix, right))


def lagrange(nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the weights (P, N) of values at N nodes for the values of their polynomial at P places."""
    others = [np.delete(nodes, i) for i in range(len(nodes))]
    factors = [(places[:, None] - rest) / (node - rest) for node, rest in zip(nodes, others, strict=True)]
    return np.stack([np.prod(factor, axis=1) for factor in factors], axis=1)
