"""Close open pieces: cap holes, and thicken visible sheets.

Back faces alone do not show whether a piece is a solid with a missing face or a thin sheet (scans lack their
underside, furniture its hidden faces). A boundary loop is an opening if its cap would be large and visible
from outside, otherwise a hole; a piece with an opening is a sheet.
"""

from collections.abc import Iterator

import igl
import manifold3d
import numpy as np
from scipy.sparse import coo_matrix

from objectfolder.mesh.normals import area_vectors
from objectfolder.mesh.polygon import area_vector, in_plane
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sampling import sample_surface
from objectfolder.mesh.topology import Mesh, boundary_loops, face_areas, signed_volume

SEEN = 0.3  #: unoccluded fraction of the hemisphere above which a cap is visible from outside
LARGE = 0.05  #: area of a loop, as a fraction of the piece's, above which it is large
FLAT = 1e-6  #: volume of a capped piece over its area and extent, below which it has no inner side
NO_ROOM = 0.5  #: area fraction of faces inverted by a wall above which it has no room
_RAYS = 1024
_OFFSET = 1e-4  # start of the rays above the cap, unit frame


def close_piece(
    piece: Mesh, scene: RayCaster | None, wall: float, least: float = LARGE
) -> tuple[Mesh, int, int]:
    """Close an open manifold piece, consistently oriented, in the unit frame.

    A visible loop whose area is more than ``least`` of the piece's is an opening, others are capped;
    without a ``scene`` of all pieces, for visibility, all are. A piece with an opening is a sheet, which
    gets a wall: it becomes the outer side; of a flat one, the side to which its winding points. Where there
    is no room for the wall, the openings are capped instead.

    Returns the closed piece, the number of capped loops, and that of openings of a sheet.
    """
    vertices, faces, loops, flat = _turn_outward(piece)
    area = face_areas(vertices, faces).sum()
    openings = [
        loop
        for loop in loops
        if scene is not None
        and np.linalg.norm(area_vector(vertices[loop])) > least * area
        and _is_visible(vertices, loop, scene, flat)
    ]
    chosen = {int(loop[0]) for loop in openings}
    holes = [loop for loop in loops if int(loop[0]) not in chosen]
    closed = cap(vertices, faces, holes)
    if not openings:
        return closed, len(holes), 0
    sheet = thicken(*closed, wall)
    if _inverted_share(closed[0], sheet[0][len(closed[0]) :], closed[1]) > NO_ROOM:
        return cap(vertices, faces, loops), len(loops), 0
    return sheet, len(holes), len(openings)


def visible_loops(piece: Mesh, scene: RayCaster, least: float = 0) -> Iterator[float]:
    """Yield the areas of the visible loops, as fractions of the piece's, from the largest to ``least``."""
    vertices, faces, loops, flat = _turn_outward(piece)
    area = face_areas(vertices, faces).sum()
    shares = [float(np.linalg.norm(area_vector(vertices[loop])) / area) for loop in loops]
    for k in np.argsort(shares, kind="stable")[::-1]:
        if shares[k] < least:
            return
        if _is_visible(vertices, loops[k], scene, flat):
            yield shares[k]


def _turn_outward(piece: Mesh) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], bool]:
    """Return vertices, faces that show outward once capped, boundary loops, and whether the piece is flat."""
    vertices, faces = piece
    loops = boundary_loops(faces)
    area = face_areas(vertices, faces).sum()
    volume = signed_volume(*cap(vertices, faces, loops))
    flat = abs(volume) < FLAT * area * np.ptp(vertices[faces.ravel()], axis=0).max()
    if volume < 0 and not flat:
        faces = np.ascontiguousarray(faces[:, ::-1])
        loops = boundary_loops(faces)
    return vertices, faces, loops, bool(flat)


def _is_visible(vertices: np.ndarray, loop: np.ndarray, scene: RayCaster, flat: bool) -> bool:
    """Test whether a loop's cap would be seen from outside; of a flat piece, from either side."""
    return (
        max(_measure_visibility(vertices[side], scene) for side in ([loop, loop[::-1]] if flat else [loop]))
        > SEEN
    )


def cap(vertices: np.ndarray, faces: np.ndarray, loops: list[np.ndarray]) -> Mesh:
    """Close loops, given along their boundary half edges, with flat or nearly flat caps."""
    new_vertices, new_faces, count = [vertices], [faces], len(vertices)
    for loop in loops:
        points = vertices[loop]
        normal = area_vector(points)
        centre = points.mean(0)
        fan = np.cross(points - centre, np.roll(points, -1, 0) - centre) @ normal
        if len(loop) > 3 and (fan <= 0).any():  # not star-shaped about its centre
            local = manifold3d.triangulate([in_plane(points, normal)])
            new_faces.append(loop[local][:, ::-1])
        else:
            new_faces.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), count)], 1))
            new_vertices.append(centre[None])
            count += 1
    return np.concatenate(new_vertices), np.concatenate(new_faces).astype(np.int64)


def thicken(vertices: np.ndarray, faces: np.ndarray, wall: float) -> Mesh:
    """Add an inner side to a sheet at a distance ``wall``, joined along the boundary."""
    count = len(vertices)
    inner = vertices - wall * _offset_directions(vertices, faces)
    border = np.concatenate(
        [np.stack([loop, np.roll(loop, -1)], 1) for loop in boundary_loops(faces)]
    )  # from a to b along the sheet
    a, b = border.T
    rim = np.concatenate([np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)])
    return np.concatenate([vertices, inner]), np.concatenate([faces, faces[:, ::-1] + count, rim])


def _inverted_share(vertices: np.ndarray, inner: np.ndarray, faces: np.ndarray) -> float:
    """Compute the area fraction of faces with an edge reversed on the inner side."""
    outward, inward = (np.roll(side[faces], -1, 1) - side[faces] for side in (vertices, inner))
    area = face_areas(vertices, faces)
    return float(area[(np.einsum("ijk,ijk->ij", outward, inward) < 0).any(1)].sum() / area.sum())


def _offset_directions(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Compute vertex normals, longer at creases so that offset faces keep their distance; (V, 3)."""
    normal = np.asarray(
        igl.per_vertex_normals(vertices, faces, igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE), np.float64
    )
    normal = np.nan_to_num(normal)
    face_normal = area_vectors(vertices, faces)
    face_normal /= np.maximum(np.linalg.norm(face_normal, axis=1, keepdims=True), 1e-30)
    cosine = np.einsum("ikj,ij->ik", normal[faces], face_normal)
    incidence = coo_matrix((cosine.ravel(), (faces.ravel(), np.zeros(faces.size, int))), (len(vertices), 1))
    mean = np.asarray(incidence.todense()).ravel() / np.maximum(np.bincount(faces.ravel()), 1)
    return normal / np.clip(mean, 0.5, 1)[:, None]


def _measure_visibility(loop: np.ndarray, scene: RayCaster) -> float:
    """Compute the fraction of cosine-weighted outward rays from a cap that hit nothing."""
    rng = np.random.default_rng(0)
    count = len(loop)
    fan = np.stack([np.full(count, count), np.arange(count), (np.arange(count) + 1) % count], 1)
    # The loop follows the surface's boundary, so its cap faces the other way.
    outward = -area_vector(loop)
    outward /= np.linalg.norm(outward)
    points = sample_surface(np.concatenate([loop, loop.mean(0, keepdims=True)]), fan, _RAYS, rng)
    direction = rng.normal(size=(_RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction += outward  # cosine-weighted
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    _, face = scene.first_hit(points + _OFFSET * outward, direction)
    return float((face < 0).mean())
