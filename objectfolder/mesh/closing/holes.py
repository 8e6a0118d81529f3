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

from objectfolder.mesh.closing.solids import to_arrays
from objectfolder.mesh.normals import area_vectors, unit_vectors
from objectfolder.mesh.polygon import area_vector, in_plane, split_tightly
from objectfolder.mesh.raycast import RayCaster
from objectfolder.mesh.sampling import sample_faces, sample_surface
from objectfolder.mesh.scanline import MAX_OUTSIDE, winding_certificate
from objectfolder.mesh.topology import Mesh, boundary_loops, face_areas, half_edges, is_closed, signed_volume

SEEN = 0.3  #: unoccluded fraction of the hemisphere above which a cap is visible from outside
LARGE = 0.05  #: area of a loop, as a fraction of the piece's, above which it is large
THIN = 5e-4  #: depth behind the faces of a capped piece, unit frame, at which there is material, or nothing
EMPTY = 0.5  #: area fraction of a capped piece's faces with nothing behind above which it is a sheet, if seen
NARROW = 0.05  #: longest side of a piece, unit frame, below which it is no such sheet but a crumb
NOTED_HOLE = 1e-3  #: of a piece's area; smaller holes are gaps of a scan
FLAT = 1e-6  #: volume of a capped piece over its area and extent, below which it has no inner side
NO_ROOM = 0.5  #: area fraction of faces inverted by a wall above which it has no room
MAX_TIGHT = 512  #: corners of a loop that may get a cap of least area
_SHARE_OF_GAP = 0.45  # of the way to the next surface behind a sheet that its wall may fill
_STRAIGHT = 0.1  # area of a face on the inner side, over that outside, below which the wall is too thick
_FACING = 0.9  # cosine between an outer and inner rim of a frame
_BESIDE = 0.25  # of an inner rim's width: how far it may lie from the plane of the outer one
_RECESS = 0.5  # share of the rays into a hole that meet the front of a face, above which it is a recess
_FLOOR = 0.9  # quantile of their lengths at which the recess ends
_FITS = 24  # times that a wall is made thinner
_RAYS = 1024
_OFFSET = 1e-4  # start of the rays above the cap, unit frame


def close_piece(
    piece: Mesh, scene: RayCaster | None, wall: float, least: float = LARGE
) -> tuple[Mesh, int, int]:
    """Close an open manifold piece, consistently oriented, in the unit frame.

    A visible loop whose area is more than ``least`` of the piece's is an opening, others are capped;
    without a ``scene`` of all pieces, for visibility, all are. A piece with an opening is a sheet, which
    gets a wall: it becomes the outer side; of a flat one, the side to which its winding points. Where there
    is no room for the wall, the openings are capped instead. A piece that is seen, but whose faces the caps
    would lie against, is a sheet, too.

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
    for outer, inner in _nest(vertices, loops).items():  # a frame is open as a whole
        if int(loops[outer][0]) in chosen:
            openings += [loops[k] for k in inner if int(loops[k][0]) not in chosen]
            chosen |= {int(loops[k][0]) for k in inner}
    holes = [loop for loop in loops if int(loop[0]) not in chosen]
    if openings:
        closed = cap(vertices, faces, holes)
        sheet = thicken(*closed, wall)
        room = _inverted_share(closed[0], sheet[0][len(closed[0]) :], closed[1]) <= NO_ROOM
        if room and _overlap(sheet) > MAX_OUTSIDE:
            room = not _is_shallow(vertices, faces, loops, openings, wall)
            sheet = _build_wall(*closed, fit_wall(*closed, wall)) if room else sheet
        if room:
            return sheet, len(holes), len(openings)
    solid = cap(vertices, faces, loops)
    if not flat and _overlap(solid) > MAX_OUTSIDE:
        solid = min(solid, cap(vertices, faces, loops, tight=True), key=_overlap)
    if scene is not None and _empty_share(solid, len(faces)) > EMPTY:
        seen = _find_seen_side(piece, scene)
        if seen is not None:
            return _build_wall(*seen, np.full(len(seen[0]), wall)), 0, len(loops)
    if scene is not None and (sunk := _sink(vertices, faces, loops, scene)) is not None:
        recessed = cap(*sunk, boundary_loops(sunk[1]))
        solid = recessed if _overlap(recessed) <= MAX_OUTSIDE else solid
    return solid, len(loops), 0


def _empty_share(solid: Mesh, count: int) -> float:
    """Compute the area fraction of the first ``count`` faces of a capped piece that a cap lies against."""
    vertices, faces = solid
    if not np.any(face_areas(vertices, faces[:count])):
        return 0.0
    points, face = sample_faces(vertices, faces[:count], _RAYS, np.random.default_rng(0))
    inward = -unit_vectors(area_vectors(vertices, faces))[face] * np.sign(signed_volume(*solid))
    winding = np.abs(igl.fast_winding_number(vertices, faces, points + THIN * inward))
    return float((np.asarray(winding) < 0.5).mean())


def _find_seen_side(piece: Mesh, scene: RayCaster) -> Mesh | None:
    """Turn a piece that caps do not fill to the side from which it is seen; None if it is hidden or small.

    Seen from both sides, it keeps its winding.
    """
    vertices, faces = piece
    if np.ptp(vertices[faces.ravel()], axis=0).max() < NARROW:
        return None
    rng = np.random.default_rng(0)
    points, face = sample_faces(vertices, faces, _RAYS, rng)
    normals = unit_vectors(area_vectors(vertices, faces))[face]
    direction = unit_vectors(rng.normal(size=points.shape))
    front, back = (
        1 - scene.occluded(points + _OFFSET * outward, unit_vectors(direction + outward)).mean()
        for outward in (normals, -normals)
    )
    if max(front, back) <= SEEN:
        return None
    return (vertices, faces) if front > SEEN else (vertices, np.ascontiguousarray(faces[:, ::-1]))


def _sink(vertices: np.ndarray, faces: np.ndarray, loops: list[np.ndarray], scene: RayCaster) -> Mesh | None:
    """Add the sides of recesses behind visible holes through which the fronts of other pieces are seen.

    A cap would hide them, such as a carved panel behind the opening of a frame. None if there are none.
    """
    new_vertices, new_faces, count = [vertices], [faces], len(vertices)
    least = NOTED_HOLE * face_areas(vertices, faces).sum()
    for loop in loops:
        inward = area_vector(vertices[loop])
        size = np.linalg.norm(inward)
        if size < least or not _is_visible(vertices, loop, scene, flat=False):
            continue
        inward /= size
        points = _sample_fan(vertices[loop], np.random.default_rng(0))
        rays = points + _OFFSET * inward, np.tile(inward, (len(points), 1))
        depth, behind = scene.first_crossing(*rays)
        other = depth < RayCaster(vertices, faces).first_hit(*rays)[0]
        front = depth[other & ~behind] + _OFFSET
        if len(front) > _RECESS * len(points):
            new_vertices.append(vertices[loop] + np.quantile(front, _FLOOR) * inward)
            a, b = loop, np.roll(loop, -1)
            lower = count + np.arange(len(loop))
            below = np.roll(lower, -1)
            new_faces += [np.stack([b, a, lower], 1), np.stack([b, lower, below], 1)]
            count += len(loop)
    return (np.concatenate(new_vertices), np.concatenate(new_faces)) if count > len(vertices) else None


def _is_shallow(
    vertices: np.ndarray, faces: np.ndarray, loops: list[np.ndarray], openings: list[np.ndarray], wall: float
) -> bool:
    """Tell whether a wall would fill a piece, which is less deep behind its openings on average."""
    across = np.linalg.norm(sum(area_vector(vertices[loop]) for loop in openings))
    return bool(abs(signed_volume(*cap(vertices, faces, loops))) < wall * across)


def _overlap(piece: Mesh) -> float:
    """Compute the share of a closed piece, of either orientation, that overlaps itself; 1 if it is open."""
    vertices, faces = piece
    if not is_closed(faces):
        return 1.0
    outward = faces if signed_volume(*piece) > 0 else faces[:, ::-1]
    return winding_certificate(vertices, outward).outside_fraction


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


def cap(vertices: np.ndarray, faces: np.ndarray, loops: list[np.ndarray], tight: bool = False) -> Mesh:
    """Close loops, given along their boundary half edges, with caps of no edge that the faces have.

    They are flat or nearly flat, or if ``tight``, of the least area: such as three sides of a board.
    """
    new_vertices, new_faces, count = [vertices], [faces], len(vertices)
    frames = {
        outer: ring
        for outer, inner in _nest(vertices, loops).items()
        if (ring := _cap_frame(vertices, faces, [loops[outer], *(loops[k] for k in inner)])) is not None
    }
    capped = {int(vertex) for ring in frames.values() for vertex in ring.ravel()}
    new_faces += frames.values()
    for loop in loops:
        if int(loop[0]) in capped:
            continue
        points = vertices[loop]
        normal = area_vector(points)
        centre = points.mean(0)
        fan = np.cross(points - centre, np.roll(points, -1, 0) - centre) @ normal
        local = None
        if not tight and len(loop) > 3 and (fan <= 0).any():  # not star-shaped about its centre
            local = manifold3d.triangulate([in_plane(points, normal)])
        if len(loop) > 3 and (tight or local is not None):
            local = _split_apart(points, local, _edges_between(faces, loop))
        if local is not None:
            new_faces.append(loop[local][:, ::-1])
        else:
            new_faces.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), count)], 1))
            new_vertices.append(centre[None])
            count += 1
    return np.concatenate(new_vertices), np.concatenate(new_faces).astype(np.int64)


def _nest(vertices: np.ndarray, loops: list[np.ndarray]) -> dict[int, list[int]]:
    """Find frames: loops with others beside them in the same cap, which are its inner rims.

    An inner rim runs the other way round within the outer one, and is as near to its plane as its own width.
    """
    areas = np.array([area_vector(vertices[loop]) for loop in loops]).reshape(-1, 3)
    sizes = np.linalg.norm(areas, axis=1)
    frames: dict[int, list[int]] = {}
    free = np.ones(len(loops), bool)
    for outer in np.argsort(-sizes, kind="stable") if len(loops) > 1 else ():
        facing = areas @ areas[outer] < -_FACING * sizes * sizes[outer]
        for inner in np.flatnonzero(facing & free & (sizes < sizes[outer])) if free[outer] else ():
            rim, around = vertices[loops[inner]], vertices[loops[outer]]
            height, bounds = (points @ areas[outer] / sizes[outer] for points in (rim, around))
            slack = _BESIDE * np.sqrt(sizes[inner])
            level = height.min() > bounds.min() - slack and height.max() < bounds.max() + slack
            if level and _encloses(around, rim, areas[outer]):
                frames.setdefault(int(outer), []).append(int(inner))
                free[inner] = False
    return frames


def _encloses(around: np.ndarray, points: np.ndarray, normal: np.ndarray) -> bool:
    """Tell whether points (N, 3) lie within a loop (n, 3), seen along a normal."""
    outline, inner = in_plane(around, normal), in_plane(points, normal)
    a, b = outline[:, None], np.roll(outline, -1, 0)[:, None]
    above = (a[..., 1] > inner[:, 1]) != (b[..., 1] > inner[:, 1])
    rise = np.where(above, b[..., 1] - a[..., 1], 1)
    right = a[..., 0] + (inner[:, 1] - a[..., 1]) * (b[..., 0] - a[..., 0]) / rise > inner[:, 0]
    return bool(((above & right).sum(0) % 2 == 1).all())


def _cap_frame(vertices: np.ndarray, faces: np.ndarray, rims: list[np.ndarray]) -> np.ndarray | None:
    """Close the ring between an outer and inner rims; None if that needs an edge which the faces have."""
    normal = area_vector(vertices[rims[0]])
    corners = np.concatenate(rims)
    ring = manifold3d.triangulate([in_plane(vertices[rim], normal) for rim in rims])
    if len(ring) != len(corners) + 2 * len(rims) - 4:
        return None
    own = np.concatenate([np.stack([rim, np.roll(rim, -1)], 1) for rim in rims])
    place = np.full(int(corners.max()) + 1, -1)
    place[corners] = np.arange(len(corners))
    between = _edges_between(faces, corners)
    between[place[own[:, 0]], place[own[:, 1]]] = between[place[own[:, 1]], place[own[:, 0]]] = False
    return None if between[ring, np.roll(ring, -1, 1)].any() else corners[ring][:, ::-1]


def _split_apart(points: np.ndarray, local: np.ndarray | None, between: np.ndarray) -> np.ndarray | None:
    """Return a split of a loop (n, 3) that has no edge ``between`` its corners, or else one of least area."""
    count = len(points)
    if local is not None and len(local) == count - 2:
        own = np.zeros_like(between)
        own[np.arange(count), np.arange(count) - 1] = True
        if not (between & ~(own | own.T))[local, np.roll(local, -1, 1)].any():
            return local
    return split_tightly(points, between) if count <= MAX_TIGHT else None


def _edges_between(faces: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Tell which vertices of a loop (n,) are joined by an edge of the faces; (n, n) bool."""
    place = np.full(int(faces.max()) + 1, -1)
    place[loop] = np.arange(len(loop))
    ends = place[half_edges(faces)]
    ends = ends[(ends >= 0).all(1)]
    between = np.zeros((len(loop), len(loop)), bool)
    between[ends[:, 0], ends[:, 1]] = between[ends[:, 1], ends[:, 0]] = True
    return between


def fit_wall(vertices: np.ndarray, faces: np.ndarray, wall: float) -> np.ndarray:
    """Compute how thick a wall fits behind each vertex of a sheet, at most ``wall``; (V,).

    It ends before the middle of the way to the next surface behind, and where it would turn faces around it
    is thinner: at ridges and ornaments finer than the wall.
    """
    inward = -_offset_directions(vertices, faces)
    caster = RayCaster(vertices, faces)
    behind, _ = caster.first_hit(vertices + _OFFSET * inward, inward)
    thickness = np.minimum(wall, _SHARE_OF_GAP * (behind + _OFFSET))
    normal = area_vectors(vertices, faces)
    for _ in range(_FITS):
        turned = area_vectors(vertices + thickness[:, None] * inward, faces)
        crossed = np.einsum("ij,ij->i", turned, normal) < _STRAIGHT * (normal**2).sum(1)
        if not crossed.any():
            break
        thickness[np.unique(faces[crossed])] *= 0.75
    return thickness


def _build_wall(vertices: np.ndarray, faces: np.ndarray, thickness: np.ndarray) -> Mesh:
    """Thicken a sheet; where that overlaps itself, as the union of the hulls over the faces."""
    sheet = thicken(vertices, faces, thickness)
    if _overlap(sheet) <= MAX_OUTSIDE:
        return sheet
    corners = np.concatenate([vertices[faces], sheet[0][faces + len(vertices)]], 1)
    hulls = [manifold3d.Manifold.hull_points(points) for points in corners]
    return to_arrays(manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add))


def thicken(vertices: np.ndarray, faces: np.ndarray, wall: float | np.ndarray) -> Mesh:
    """Add an inner side to a sheet at a distance ``wall``, (V,) or of all, joined along the boundary."""
    count = len(vertices)
    inner = vertices - np.reshape(wall, (-1, 1)) * _offset_directions(vertices, faces)
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
    # The loop follows the surface's boundary, so its cap faces the other way.
    outward = -area_vector(loop)
    outward /= np.linalg.norm(outward)
    points = _sample_fan(loop, rng)
    direction = rng.normal(size=(_RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction += outward  # cosine-weighted
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    _, face = scene.first_hit(points + _OFFSET * outward, direction)
    return float((face < 0).mean())


def _sample_fan(loop: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sample points on the triangles between a loop (n, 3) and its centre; (_RAYS, 3)."""
    count = len(loop)
    fan = np.stack([np.full(count, count), np.arange(count), (np.arange(count) + 1) % count], 1)
    return sample_surface(np.concatenate([loop, loop.mean(0, keepdims=True)]), fan, _RAYS, rng)
