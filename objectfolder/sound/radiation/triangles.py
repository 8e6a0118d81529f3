"""Flat triangles, and integrals of static kernels over them in closed form."""

from dataclasses import dataclass

import numpy as np

#: Barycentric coordinates of three points whose mean integrates quadratics exactly.
_POINTS = np.full((3, 3), 1 / 6) + np.eye(3) / 2


@dataclass(frozen=True)
class Triangles:
    """Triangles of a surface; metres."""

    corners: np.ndarray  #: (N, 3, 3)
    centroid: np.ndarray  #: (N, 3)
    normal: np.ndarray  #: (N, 3) outward
    area: np.ndarray  #: (N,)

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> "Triangles":
        """Return the triangles of a mesh, (V, 3) and (N, 3)."""
        corners = np.asarray(vertices, np.float64)[faces]
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(twice, axis=1) / 2
        return cls(corners, corners.mean(1), twice / (2 * area[:, None]), area)

    def quadrature(self) -> np.ndarray:
        """Return points of equal weight, (3, N, 3)."""
        return np.einsum("qc,ncd->qnd", _POINTS, self.corners)


def static_integrals(
    corners: np.ndarray, normals: np.ndarray, points: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Integrate 1 / (4 pi r) and its derivatives over triangles, each seen from one point off it; (4, P).

    The integral of 1 / (4 pi r); of its derivative along the triangle's normal; the derivatives of both along
    the direction at the point. Corners (P, 3, 3) and normals (P, 3) are of the triangles, directions (P, 3)
    unit vectors at the points (P, 3). Potential and solid angle: Wilton et al., IEEE Transactions on Antennas
    and Propagation 32, 1984. The gradient of the solid angle is the field of Biot and Savart of a current
    along the edges.
    """
    begin = corners - points[:, None]
    edge = np.roll(begin, -1, axis=1) - begin
    length = np.linalg.norm(edge, axis=2)
    along = edge / length[:, :, None]
    across = np.cross(along, normals[:, None])
    height = -(begin[:, 0] * normals).sum(1)[:, None]
    left = (begin * along).sum(2)
    right, offset = left + length, (begin * across).sum(2)
    square = np.maximum(offset**2 + height**2, 1e-24 * length**2)
    near, far = np.sqrt(left**2 + square), np.sqrt(right**2 + square)
    root = np.sqrt(square)
    log = np.arcsinh(right / root) - np.arcsinh(left / root)
    size = np.abs(height)
    angle = np.arctan2(offset * right, square + size * far) - np.arctan2(offset * left, square + size * near)
    seen = angle.sum(1) * np.sign(height[:, 0])
    potential = (offset * log - size * angle).sum(1)
    pull = -(across * log[:, :, None]).sum(1) - seen[:, None] * normals
    turn = (right / far - left / near) / square
    bend = -((height * turn)[:, :, None] * across).sum(1) - (offset * turn).sum(1)[:, None] * normals
    out = potential, seen, (pull * directions).sum(1), (bend * directions).sum(1)
    return np.stack(out) / (4 * np.pi)
