"""A plate in the shape of a U, with caps of eight corners, and areas of meshes."""

import numpy as np

OUTLINE = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], float)
HEIGHT = 0.5
AREA = 22.0  # two caps of 7, and 16 x 0.5 around
VOLUME = 3.5


def u_plate():
    """Vertices (16, 3) and polygons, outward."""
    bottom, top = (np.column_stack([OUTLINE, np.full(8, z)]) for z in (0.0, HEIGHT))
    sides = [[i, (i + 1) % 8, (i + 1) % 8 + 8, i + 8] for i in range(8)]
    return np.concatenate([bottom, top]), [list(range(8))[::-1], list(range(8, 16)), *sides]


def area(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
