"""Sections swept along a path: handles, rungs, wires."""

import manifold3d
import numpy as np

from objectfolder.shapes.extrusion import solid


def tube(
    path: np.ndarray, width: np.ndarray | float, thickness: np.ndarray | float,
    side: np.ndarray | tuple[float, float, float], segments: int = 24, squareness: float = 2.0,
) -> manifold3d.Manifold:  # fmt: skip
    """Sweep a superellipse along a path (N, 3), m, in a plane whose unit normal is ``side`` (3,).

    ``width`` and ``thickness`` are full sizes of the section along and across ``side``, m, one or (N,);
    ``segments``, a multiple of 4, are facets around it; a ``squareness`` of 2 is an ellipse, 4 nearly a
    rectangle.
    """
    side = np.asarray(side, np.float64)
    path = np.asarray(path, np.float64)
    rows = len(path)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.cross(tangent, side)
    half = np.stack([np.broadcast_to(width, rows), np.broadcast_to(thickness, rows)], 1) / 2
    angle = 2 * np.pi * np.arange(segments) / segments
    round_ = np.stack([np.cos(angle), np.sin(angle)], 1)
    # Radial at each angle, so that facets stay even at tight corners.
    section = round_ / (np.abs(round_) ** squareness).sum(1, keepdims=True) ** (1 / squareness)
    axes = np.stack([np.broadcast_to(side, path.shape), normal], 1)
    offset = (half[:, None] * section)[..., None] * axes[:, None]
    vertices = (path[:, None] + offset.sum(2)).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(rows - 1), np.arange(segments), indexing="ij"))
    a, b = i * segments + j, i * segments + (j + 1) % segments
    wall = np.concatenate([np.stack([a, b, b + segments], 1), np.stack([a, b + segments, a + segments], 1)])
    ring, around = np.arange(segments), np.roll(np.arange(segments), -1)
    first, last = rows * segments, rows * segments + 1
    last_ring = (rows - 1) * segments
    ends = [
        np.stack([np.full(segments, first), around, ring], 1),
        np.stack([np.full(segments, last), last_ring + ring, last_ring + around], 1),
    ]
    return solid(np.concatenate([vertices, path[:1], path[-1:]]), np.concatenate([wall, *ends]))


def bar(
    start: np.ndarray | tuple[float, float, float], stop: np.ndarray | tuple[float, float, float],
    diameters: tuple[float, float], spacing: float, segments: int = 32,
) -> manifold3d.Manifold:  # fmt: skip
    """Build a straight round bar, m, whose diameter changes linearly from the first to the second."""
    ends = np.array([start, stop], np.float64)
    along = ends[1] - ends[0]
    length = np.linalg.norm(along)
    side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 * length else [0.0, 1.0, 0.0])
    t = np.linspace(0, 1, int(np.ceil(length / spacing)) + 1)[:, None]
    diameter = diameters[0] + t[:, 0] * (diameters[1] - diameters[0])
    return tube(ends[0] + t * along, diameter, diameter, side / np.linalg.norm(side), segments)
