"""20-node hexahedron on the reference cube [-1, 1]^3, vectorised over points.

Nodes: the eight corners, then the midpoints of the twelve edges (serendipity element; Zienkiewicz and
Taylor, The Finite Element Method, vol. 1, ch. 8).
"""

import numpy as np

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
_CORNERS = 2.0 * _CORNERS - 1
_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
NODES = np.concatenate([_CORNERS, [(_CORNERS[a] + _CORNERS[b]) / 2 for a, b in _EDGES]])  #: (20, 3)


def shape_functions(points: np.ndarray) -> np.ndarray:
    """Evaluate the shape functions at reference points; (Q, 3) -> (Q, 20)."""
    return _with_gradients(points)[0]


def shape_gradients(points: np.ndarray) -> np.ndarray:
    """Evaluate the derivatives by the reference coordinates; (Q, 3) -> (Q, 20, 3)."""
    return _with_gradients(points)[1]


def _with_gradients(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = np.asarray(points, np.float64)[:, None, :]
    # Along each axis a node's factor is 1 + s x at a corner coordinate s, and 1 - x^2 at a midpoint.
    middle = NODES[None] == 0
    factor = np.where(middle, 1 - x * x, 1 + NODES * x)
    slope = np.where(middle, -2 * x, NODES[None] + 0 * x)
    product = factor.prod(-1)
    (fx, fy, fz), (sx, sy, sz) = np.moveaxis(factor, -1, 0), np.moveaxis(slope, -1, 0)
    gradient = np.stack([sx * fy * fz, fx * sy * fz, fx * fy * sz], -1)
    corner = (~middle).all(-1)
    reach = (NODES * x).sum(-1) - 2
    value = np.where(corner, product * reach / 8, product / 4)
    corner_gradient = (gradient * reach[..., None] + product[..., None] * NODES) / 8
    return value, np.where(corner[..., None], corner_gradient, gradient / 4)
