"""Combine closed pieces into one solid: union, cavities, bridges over small gaps."""

import igl
import manifold3d
import numpy as np

from objectfolder.mesh.closing.contour import BLOCK, block_centres, contour
from objectfolder.mesh.closing.joints import make_joint
from objectfolder.mesh.scanline import winding_certificate
from objectfolder.mesh.topology import Mesh, compact, distance, face_components, face_volumes, signed_volume

SPECKS = 1e-3  #: volume fraction below which small bodies are dropped (broken-off rims of scans)
TOUCHING = 1e-3  #: pieces so near to each other, unit frame, are meant to touch: 1 mm of a cupboard
_NOTHING = 1e-12  # volume below which a piece is flat, unit frame
_MAX_CUTS = 24  # through a self-overlapping body
_BRIDGE_SPACING = 1 / 512  # grid spacing of a bridge, unit frame
_BRIDGE_DEPTH = 1.25 / 512  # overlap of a bridge with the pieces
_BRIDGE_ROUGHNESS = 1e-7  # by which its surface may move, unit frame; a grid leaves slivers by the thousand


def unite(pieces: list[Mesh]) -> tuple[Mesh, int]:
    """Unite closed pieces; an inner piece of opposite orientation is a cavity.

    A piece inside a cavity, oriented like the outermost one, is solid again. Returns the mesh, oriented
    outward and empty if nothing is enclosed, and the number of cavities.
    """
    volumes = [signed_volume(*piece) for piece in pieces]
    pieces = [piece for piece, volume in zip(pieces, volumes) if abs(volume) > _NOTHING]
    volumes = [volume for volume in volumes if abs(volume) > _NOTHING]
    # The sign alone does not suffice, because many meshes are inside out as a whole. A piece oriented like
    # the outermost piece around it is solid (also within a cavity), otherwise hollow.
    size = np.abs(volumes)
    lower, upper = (np.array([bound(v, axis=0) for v, _ in pieces]) for bound in (np.min, np.max))
    around = []
    for k, (v, _) in enumerate(pieces):
        larger = (size > size[k]) & (lower <= lower[k]).all(1) & (upper >= upper[k]).all(1)
        around.append([o for o in np.flatnonzero(larger) if _contains(pieces[o], v)])
    hollow = [
        bool(outer) and volume * volumes[max(outer, key=size.__getitem__)] < 0
        for outer, volume in zip(around, volumes)
    ]
    solids = [to_manifold((v, f if volume > 0 else f[:, ::-1])) for (v, f), volume in zip(pieces, volumes)]
    for k in np.flatnonzero(hollow).tolist():
        for o in around[k]:
            solids[o] = solids[o] if hollow[o] else solids[o] - solids[k]
    shells = [solid for solid, inner in zip(solids, hollow) if not inner]
    return to_arrays(manifold3d.Manifold.batch_boolean(shells, manifold3d.OpType.Add)), sum(hollow)


def untangle(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Unite a self-overlapping surface with itself, so that it encloses space once.

    Boolean operations work between solids, so the body is cut by planes until no part overlaps itself, and
    the parts are united. Empty if that takes too many cuts.
    """
    pending, parts, cuts = [to_manifold((vertices, faces))], [], 0
    while pending:
        for part in pending.pop().decompose():
            mesh = to_arrays(part)
            if winding_certificate(*mesh).solid:
                parts.append(part)
                continue
            if cuts == _MAX_CUTS:
                return vertices, faces[:0]
            cuts += 1
            lower, upper = mesh[0].min(0), mesh[0].max(0)
            axis = int((upper - lower).argmax())
            # Off the middle, where symmetric meshes have vertices.
            place = lower[axis] + 0.5013 * (upper - lower)[axis]
            pending += part.split_by_plane(np.eye(3)[axis].tolist(), place)
    return to_arrays(manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add))


def label_bodies(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Label the solid bodies of a closed surface: shells with their cavities.

    Returns the body of each face, (F,), numbered by decreasing volume, and their volumes without cavities.
    """
    shell = face_components(faces, len(vertices))
    volume = np.bincount(shell, weights=face_volumes(vertices, faces))
    owner = np.arange(len(volume))
    outer = np.flatnonzero(volume > 0)
    for cavity in np.flatnonzero(volume < 0):
        inside = compact(vertices, faces[shell == cavity])[0]
        around = [o for o in outer if _contains(compact(vertices, faces[shell == o]), inside)]
        if around:
            owner[cavity] = min(around, key=lambda o: volume[o])
    label = np.unique(owner, return_inverse=True)[1]
    volumes = np.bincount(label, weights=volume)
    order = np.argsort(-volumes, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return rank[label[shell]], volumes[order]


def drop_specks(vertices: np.ndarray, faces: np.ndarray, across: float = np.inf) -> tuple[Mesh, int]:
    """Drop the smallest bodies that together hold at most `SPECKS` of the volume; returns their number.

    Bodies whose longest side is ``across`` or more are kept.
    """
    body, volumes = label_bodies(vertices, faces)
    after = volumes.sum() - np.cumsum(volumes)  # volume of the smaller ones
    small = np.arange(len(volumes)) > int(np.argmax(after <= SPECKS * volumes.sum()))
    for k in np.flatnonzero(small) if across < np.inf else ():
        small[k] = np.ptp(vertices[faces[body == k].ravel()], axis=0).max() < across
    return compact(vertices, faces[~small[body]]), int(small.sum())


def find_gaps(pieces: list[Mesh], reach: float) -> list[tuple[float, int, int]]:
    """Find gaps below ``reach`` between pieces: (gap, i, j), smallest first."""
    solids = [to_manifold(piece) for piece in pieces]
    lower, upper = (np.array([bound(v, axis=0) for v, _ in pieces]) for bound in (np.min, np.max))
    found = []
    for j in range(len(pieces)):
        for i in range(j):
            if (np.maximum(lower[i], lower[j]) - np.minimum(upper[i], upper[j])).max() < reach:
                gap = solids[i].min_gap(solids[j], reach)
                found += [(float(gap), i, j)] if gap < reach else []
    return sorted(found)


def bridge(vertices: np.ndarray, faces: np.ndarray, reach: float) -> tuple[Mesh, list[float]]:
    """Join bodies separated by gaps below ``reach`` with material in the gaps only.

    Bodies that touch, within `TOUCHING`, are bonded wherever they do; wider gaps are filled only until all
    bodies hang together. Returns the mesh and the widths of the filled gaps.
    """
    body, volumes = label_bodies(vertices, faces)
    pieces = [compact(vertices, faces[body == k]) for k in range(len(volumes))]
    solids = [to_manifold(piece) for piece in pieces]
    tree = np.arange(len(pieces))
    joined, bridged = [to_manifold((vertices, faces))], []
    for gap, i, j in find_gaps(pieces, reach):
        if gap <= TOUCHING or tree[i] != tree[j]:
            tree[tree == tree[j]] = tree[i]
            flat = make_joint(pieces[i], pieces[j], (solids[i], solids[j]), gap)
            joined.append(to_manifold(_filler(pieces[i], pieces[j], gap)) if flat is None else flat)
            bridged.append(gap)
    if not bridged:
        return (vertices, faces), []
    whole = manifold3d.Manifold.batch_boolean(joined, manifold3d.OpType.Add)
    return to_arrays(whole.simplify(_BRIDGE_ROUGHNESS)), bridged


def subtract(solid: Mesh, hollow: Mesh) -> Mesh:
    """Return a closed solid less another one."""
    return to_arrays(to_manifold(solid) - to_manifold(hollow))


def to_manifold(piece: Mesh) -> manifold3d.Manifold:
    """Convert a piece to a manifold3d solid; empty if it is not closed."""
    vertices, faces = (np.ascontiguousarray(part) for part in piece)
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))


def to_arrays(solid: manifold3d.Manifold) -> Mesh:
    """Convert a manifold3d solid to vertices and faces."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3].copy(), np.asarray(mesh.tri_verts, np.int64)


def _contains(piece: Mesh, points: np.ndarray) -> bool:
    """Test whether a closed piece encloses all points."""
    v, f = piece
    if (points.min(0) < v.min(0)).any() or (points.max(0) > v.max(0)).any():
        return False
    return bool((np.abs(igl.fast_winding_number(v, f, np.ascontiguousarray(points))) > 0.5).all())


def _filler(a: Mesh, b: Mesh, gap: float) -> Mesh:
    """Build the bridge between two pieces: points whose distances to both sum to little more than the gap."""
    near, spacing = gap + 2 * _BRIDGE_DEPTH, _BRIDGE_SPACING
    lower = np.maximum(a[0].min(0), b[0].min(0)) - near - 2 * spacing
    upper = np.minimum(a[0].max(0), b[0].max(0)) + near + 2 * spacing
    blocks = np.ceil((upper - lower) / (BLOCK * spacing)).astype(int) + 1
    centres, radius = block_centres(lower, spacing, blocks)
    chosen = np.flatnonzero(np.maximum(distance(a, centres), distance(b, centres)) < near + spacing + radius)
    return contour(
        lambda points: distance(a, points) + distance(b, points) - near, lower, spacing, blocks, chosen, near
    )
