"""Surface for boundary elements: triangles of one size, and the modes' motion on them."""

import igl
import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.closing.solids import to_arrays, to_manifold
from objectfolder.mesh.topology import Mesh, face_areas
from objectfolder.sound.radiation.triangles import Triangles

_NEIGHBOURS = 12  # points from which a vertex's motion is interpolated
_SPLIT_EDGE = 0.4  # of the final length of edges, to which long ones are split first
_NORMAL_WEIGHT = 0.5  # edges for which a turn of the normal by one radian counts
_REGULARISATION = 1e-3  # share of the neighbours' spread that keeps slopes across flat neighbourhoods at 0


def even_surface(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> Mesh:
    """Remesh a closed surface with about so many triangles of one size, smaller where it bends.

    Long edges are split, then the shortest are collapsed, and vertices return to the surface. Lengths are
    those in the space of positions and normals (Levy and Bonneel, International Meshing Roundtable 21, 2012),
    so that rims of walls, from which much of the sound comes, keep their shape. A surface with many pieces or
    holes may need more triangles. Raises ObjectFolderError if nothing of the surface is left.
    """
    edge = np.sqrt(face_areas(vertices, faces).sum() / triangles * 4 / np.sqrt(3))
    fine = finer_surface(vertices, faces, _SPLIT_EDGE * edge)
    normals = igl.per_vertex_normals(*(np.ascontiguousarray(each) for each in fine))
    places = np.concatenate([fine[0], _NORMAL_WEIGHT * edge * np.nan_to_num(normals)], axis=1)
    points, kept, *_ = igl.decimate(
        np.asfortranarray(places, np.float64), np.asfortranarray(fine[1], np.int32), max_m=triangles
    )
    kept = np.asarray(kept, np.int64)
    points = igl.point_mesh_squared_distance(np.ascontiguousarray(points[:, :3]), vertices, faces)[2]
    area = face_areas(points, kept)
    kept = kept[area > 1e-6 * area.max(initial=0)]
    if not len(kept):
        raise ObjectFolderError(
            f"a surface of {len(faces)} triangles, reduced to {triangles} for radiation, has none left; "
            "raise radiation.triangles"
        )
    return np.asarray(points), kept


def finer_surface(vertices: np.ndarray, faces: np.ndarray, edge: float) -> Mesh:
    """Return a closed surface whose long edges are split to at most a length."""
    return to_arrays(to_manifold((vertices, faces)).refine_to_length(edge))


def interpolate_motion(points: np.ndarray, values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Interpolate values (P, K) at points (P, 3) by moving least squares with linear functions; (N, K)."""
    distance, rows = cKDTree(points).query(places, k=min(_NEIGHBOURS, len(points)))
    reach = distance[:, -1:] + 1e-12
    weight = np.maximum(1 - (distance / reach) ** 2, 0) ** 2 + 1e-6
    away = (points[rows] - places[:, None]) / reach[:, :, None]
    basis = np.concatenate([np.ones((*away.shape[:2], 1)), away], axis=2)
    normal = np.einsum("nk,nka,nkb->nab", weight, basis, basis)
    normal[:, 1:, 1:] += _REGULARISATION * weight.sum(1)[:, None, None] * np.eye(3)
    first = np.linalg.solve(normal, np.broadcast_to(np.eye(4)[:, :1], (len(places), 4, 1)))[:, :, 0]
    share = weight * np.einsum("nka,na->nk", basis, first)
    out = np.zeros((len(places), values.shape[1]))
    for column in range(rows.shape[1]):
        out += share[:, column, None] * values[rows[:, column]]
    return out


def outward_motion(vertices: np.ndarray, faces: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the mean outward motion of triangles, (N, M), of their vertices' motions (V, 3, M).

    Times the areas it sums to the change of the enclosed volume, exactly.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return sum(np.einsum("nd,ndm->nm", normal, motion[corner]) for corner in faces.T) / 3


def transfer_flow(fine: Triangles, flow: np.ndarray, coarse: Triangles) -> np.ndarray:
    """Sum what flows out of fine triangles, (N, M), over the coarse ones (K, M) that stand for them.

    A fine triangle belongs to the coarse one with the nearest place and direction, so that the two sides of a
    wall stay apart. All of the flow is kept.
    """
    edge = np.sqrt(coarse.area.mean() * 4 / np.sqrt(3))
    places = [np.concatenate([each.centroid / edge, each.normal], axis=1) for each in (coarse, fine)]
    owner = cKDTree(places[0]).query(places[1])[1]
    count = len(owner)
    return csr_array((np.ones(count), (owner, np.arange(count))), (len(coarse.area), count)) @ flow
