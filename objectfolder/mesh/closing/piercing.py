"""Self-intersections of a surface."""

import igl
import numpy as np

from objectfolder.mesh.raycast import RayCaster

_END = 1e-3  # share of an edge, at each end, that does not count: neighbours meet there
_NEIGHBOURS = 4  # faces of an edge's own vertices that a ray along it passes
_SHORT = 1e-6  # shorter edges are below the precision of the rays, unit frame
_LEVEL = 1e-9  # an edge whose ends are nearer to the plane of a face lies in it, unit frame


def self_intersections(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Count the edges of a surface, unit frame, that pierce a face which shares no vertex with them.

    Of two triangles that intersect, an edge of one pierces the other. Rays in single precision find the
    pairs; only the first other face along each edge is tested, in double precision.
    """
    edges = igl.edges(np.ascontiguousarray(faces, np.int64))
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    long = np.linalg.norm(along, axis=1) > _SHORT
    edges, along = edges[long], along[long]
    caster, begin, found = RayCaster(vertices, faces), np.full(len(edges), _END), 0
    for _ in range(_NEIGHBOURS):
        start = vertices[edges[:, 0]] + begin[:, None] * along
        distance, met = caster.first_hit(start, along, (1 - _END - begin).astype(np.float32))
        hit = np.flatnonzero(met >= 0)
        edges, along, begin, face = edges[hit], along[hit], begin[hit] + distance[hit] + _END, faces[met[hit]]
        shared = (face[:, :, None] == edges[:, None]).any((1, 2))
        found += int(np.count_nonzero(~shared & _pierce(vertices[edges], vertices[face])))
        # A ray along an edge may graze the faces on either side of it.
        more = shared & (begin < 1 - _END)
        edges, along, begin = edges[more], along[more], begin[more]
    return found


def _pierce(edge: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Test whether edges (N, 2, 3) pass through faces (N, 3, 3), from side to side; (N,) bool."""
    normal = np.cross(face[:, 1] - face[:, 0], face[:, 2] - face[:, 0])
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("nek,nk->ne", edge - face[:, :1], normal / np.maximum(area, 1e-300))
    across = (height.min(1) < -_LEVEL) & (height.max(1) > _LEVEL)
    share = height[:, 0] / np.where(across, height[:, 0] - height[:, 1], 1)
    point = edge[:, 0] + share[:, None] * (edge[:, 1] - edge[:, 0])
    turns = np.cross(np.roll(face, -1, 1) - face, point[:, None] - face)
    return across & (np.einsum("nek,nk->ne", turns, normal) > 0).all(1)
