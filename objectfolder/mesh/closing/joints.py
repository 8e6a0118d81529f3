"""Joints between the flat faces of pieces, such as boards: exact prisms, without a grid."""

import manifold3d
import numpy as np

from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.topology import Mesh

DEPTH = 2e-4  #: a joint sinks so deep into both pieces, unit frame
MAX_FACETS = 128  #: triangles of a piece near the other; scans have more
_NOTHING = 1e-14  # volume that does not join, unit frame
_FLAT = 1e-15  # twice the area of a triangle without a direction
_SMOOTH = np.cos(np.radians([30, 0.1]))  # of the angle between neighbours on a round surface


def make_joint(
    a: Mesh, b: Mesh, solids: tuple[manifold3d.Manifold, manifold3d.Manifold], gap: float
) -> manifold3d.Manifold | None:
    """Fill the gap where faces of two closed pieces, given also as solids, lie opposite each other.

    Each triangle of a piece near the other is extruded across the gap. The joint is the intersection of the
    extrusions of both pieces, so it ends where either face ends. None if no faces lie opposite each other
    there, there are more than `MAX_FACETS`, or they are round: their extrusions part from each other.
    """
    sides = []
    for piece, other, solid in ((a, b, solids[1]), (b, a, solids[0])):
        chosen, prisms = _prisms(piece, other, gap)
        if not 0 < len(prisms) <= MAX_FACETS:
            return None
        extruded = [manifold3d.Manifold.hull_points(prism) for prism in prisms]
        if _is_round(piece, chosen[[(prism ^ solid).volume() > _NOTHING for prism in extruded]]):
            return None
        sides.append(manifold3d.Manifold.batch_boolean(extruded, manifold3d.OpType.Add))
    # Beside the joint, extrusions of other faces may meet without reaching both pieces.
    parts = [
        part
        for part in (sides[0] ^ sides[1]).decompose()
        if all((part ^ solid).volume() > _NOTHING for solid in solids)
    ]
    return manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add) if parts else None


def _is_round(piece: Mesh, rows: np.ndarray) -> bool:
    """Return whether some of the triangles (T,) meet at an angle as on a round surface."""
    vertices, faces = piece
    normals = unit_vectors(area_vectors(vertices, faces[rows]))
    cosines = normals @ normals.T
    meet = (faces[rows][:, None, :, None] == faces[rows][None, :, None, :]).any((2, 3))
    return bool((meet & (cosines > _SMOOTH[0]) & (cosines < _SMOOTH[1])).any())


def _prisms(piece: Mesh, other: Mesh, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a piece's triangles (T,) near another and the corners (T, 6, 3) of their extrusions."""
    vertices, faces = piece
    corners = vertices[faces]
    reach = gap + DEPTH
    near = (corners.min(1) - reach <= other[0].max(0)).all(1) & (
        corners.max(1) + reach >= other[0].min(0)
    ).all(1)
    normals = area_vectors(vertices, faces)
    area = np.linalg.norm(normals, axis=1)
    chosen = near & (area > _FLAT)
    outward = (normals[chosen] / area[chosen, None])[:, None]
    prisms = np.concatenate([corners[chosen] - DEPTH * outward, corners[chosen] + reach * outward], axis=1)
    return np.flatnonzero(chosen), prisms
