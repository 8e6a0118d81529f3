"""Decomposition of the stored surface into a few convex hulls, for collisions in physics engines."""

import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from objectfolder.base.arrays import read_npz, write_npz
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.solid import merge_meshes, missing_library, simplify

MAX_HULLS = 16
MAX_VERTICES = 128  #: of a hull; the time per simulation step hardly depends on it
_THRESHOLD = 0.05  # remaining concavity, coacd's default
_HULL_TOLERANCE = 0.002  # shrinkage of a hull in exchange for fewer vertices, fraction of the longest side
# Tolerances of simplifications before, fractions of the longest side; coarse at once leaves more triangles.
_SIMPLIFICATION = (0.0005, 0.001, 0.002, 0.003)
# A shallow search: three times the iterations take twice as long for hulls a tenth smaller.
_SEARCH = {"mcts_iterations": 20, "mcts_nodes": 10, "mcts_max_depth": 2, "resolution": 1000}
_COPLANAR = 1e-6  # height below which points are coplanar, fraction of the longest side


def convex_hulls(mesh: trimesh.Trimesh, max_hulls: int = MAX_HULLS) -> tuple[trimesh.Trimesh, ...]:
    """Cut a solid into nearly convex parts and return their convex hulls (CoACD, Wei et al. 2022).

    They are closed and convex, with at most `MAX_VERTICES` vertices, in the frame of the mesh. The same mesh
    gives the same hulls for any number of threads. Small holes are closed, and enclosed cavities are filled
    first. Raises ObjectFolderError if coacd or manifold3d is not installed, ``max_hulls`` is below 1, or the
    mesh is not closed.
    """
    if max_hulls < 1:
        raise ObjectFolderError(f"max_hulls is {max_hulls}, expected at least 1")
    try:
        import coacd
    except ImportError as error:
        raise missing_library("coacd") from error
    coacd.set_log_level("error")
    size = float(mesh.extents.max())
    shape = mesh
    for tolerance in _SIMPLIFICATION:
        outer = [shell for shell in simplify(shape, tolerance * size) if shell.volume > 0]
        if not outer:
            break
        shape = merge_meshes(outer)
    if not outer:
        raise ObjectFolderError(
            f"a mesh of {len(mesh.faces)} faces has no hulls: expected a closed surface oriented outward, "
            "such as ObjectFile.to_mesh() returns"
        )
    parts = coacd.run_coacd(
        coacd.Mesh(shape.vertices, shape.faces), threshold=_THRESHOLD, max_convex_hull=max_hulls,
        preprocess_mode="off", **_SEARCH,
    )  # fmt: skip
    hulls = tuple(hull for points, _ in parts if (hull := _convex_hull(np.asarray(points), size)) is not None)
    for k, hull in enumerate(hulls):
        _check(hull, f"hull {k}", "check that the surface is closed")
    return hulls


def write_hulls(path: str | Path, hulls: Sequence[trimesh.Trimesh], source: str = "") -> None:
    """Write hulls as ``.npz``; ``source`` is the digest of object and settings, for `cached_hulls`."""
    write_npz(
        path, vertices=np.concatenate([hull.vertices for hull in hulls]),
        faces=np.concatenate([hull.faces for hull in hulls]).astype(np.int32),
        vertex_counts=np.array([len(hull.vertices) for hull in hulls], np.int32),
        face_counts=np.array([len(hull.faces) for hull in hulls], np.int32), source=np.array(source),
    )  # fmt: skip


def read_hulls(path: str | Path) -> tuple[trimesh.Trimesh, ...]:
    """Read hulls written by `write_hulls`; raises ObjectFolderError if one is not closed and convex."""
    return _parse(path, _read(path))


def hulls_digest(hulls: Sequence[trimesh.Trimesh]) -> str:
    """Return the SHA-256 of the vertices of hulls; hexadecimal."""
    vertices = (np.ascontiguousarray(hull.vertices).tobytes() for hull in hulls)
    return hashlib.sha256(b"".join(vertices)).hexdigest()


def cached_hulls(
    file: ObjectFile, folder: str | Path, max_hulls: int = MAX_HULLS
) -> tuple[trimesh.Trimesh, ...]:
    """Return the hulls of an Object File, object frame, metres, cached in ``folder/<key>.npz``.

    They are computed (seconds to half a minute) if the cache has none of this surface and these settings.
    Raises ObjectFolderError if the file holds no geometry, the cached file is damaged, or coacd is missing.
    """
    path = Path(folder) / f"{file.key}.npz"
    source = _source(file, max_hulls)
    if path.exists():
        arrays = _read(path)
        if str(arrays["source"]) == source:
            return _parse(path, arrays)
    hulls = convex_hulls(file.to_mesh(), max_hulls)
    write_hulls(path, hulls, source)
    return hulls


def _convex_hull(points: np.ndarray, size: float) -> trimesh.Trimesh | None:
    """Return the convex hull of a few of the points, or None if they are coplanar.

    Starts with a tetrahedron and adds the point furthest outside, again and again. coacd's own choice of
    vertices shaves a round cube by 2 % of its size.
    """
    chosen = _tetrahedron(points)
    first, second, third, fourth = points[chosen]
    normal = np.cross(second - first, third - first)
    if abs((fourth - first) @ normal) <= _COPLANAR * size * np.linalg.norm(normal):
        return None
    while len(chosen) < MAX_VERTICES:
        faces = ConvexHull(points[chosen]).equations
        heights = (points @ faces[:, :3].T + faces[:, 3]).max(1)
        if heights.max() <= _HULL_TOLERANCE * size:
            break
        chosen.append(int(heights.argmax()))
    return trimesh.convex.convex_hull(points[chosen])


def _tetrahedron(points: np.ndarray) -> list[int]:
    """Choose four points, each the furthest from the point, line or plane of the previous ones."""
    chosen = [int(points[:, 0].argmin())]
    away = points - points[chosen[0]]
    for _ in range(3):
        length = np.linalg.norm(away, axis=1)
        chosen.append(int(length.argmax()))
        along = away[chosen[-1]] / max(length.max(), np.finfo(float).tiny)
        away = away - (away @ along)[:, None] * along
    return chosen


def _check(hull: trimesh.Trimesh, name: str, remedy: str) -> None:
    """Raise unless a hull is closed, oriented outward and convex."""
    if not np.isfinite(hull.vertices).all():
        raise ObjectFolderError(f"{name} has vertices that are not finite; {remedy}")
    if not (hull.is_watertight and hull.is_winding_consistent and hull.volume > 0):
        raise ObjectFolderError(f"{name} is not a closed surface oriented outward; {remedy}")
    heights = hull.vertices @ hull.face_normals.T - (hull.triangles[:, 0] * hull.face_normals).sum(1)
    if heights.max() > _COPLANAR * hull.extents.max():
        raise ObjectFolderError(f"{name} is not convex; {remedy}")


def _read(path: str | Path) -> dict[str, np.ndarray]:
    return read_npz(path, "vertices", "faces", "vertex_counts", "face_counts", "source")


def _parse(path: str | Path, arrays: dict[str, np.ndarray]) -> tuple[trimesh.Trimesh, ...]:
    vertices, faces = arrays["vertices"], arrays["faces"]
    vertex_counts, face_counts = arrays["vertex_counts"], arrays["face_counts"]
    remedy = "delete it to compute the hulls again"
    if not (
        [array.dtype.kind for array in (vertices, faces, vertex_counts, face_counts)] == ["f", "i", "i", "i"]
        and vertex_counts.ndim == face_counts.ndim == 1
        and len(vertex_counts) == len(face_counts) > 0
        and min(vertex_counts.min(), face_counts.min()) > 0
        and vertices.shape == (vertex_counts.sum(), 3)
        and faces.shape == (face_counts.sum(), 3)
    ):
        raise ObjectFolderError(f"{path} does not hold as many hulls as it counts; {remedy}")
    hulls = []
    parts = np.split(vertices, vertex_counts.cumsum()[:-1]), np.split(faces, face_counts.cumsum()[:-1])
    for k, (points, triangles) in enumerate(zip(*parts)):
        name = f"{path}: hull {k}"
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise ObjectFolderError(f"{name} has faces with missing vertices; {remedy}")
        hulls.append(trimesh.Trimesh(points, triangles, process=False))
        _check(hulls[-1], name, remedy)
    return tuple(hulls)


def _source(file: ObjectFile, max_hulls: int) -> str:
    """Return the digest of everything that determines the hulls of an Object File."""
    if "geometry" not in file.header:
        raise ObjectFolderError(f"{file.key}: the file holds no geometry, so it has no hulls")
    try:
        release = version("coacd")
    except PackageNotFoundError as error:
        raise missing_library("coacd") from error
    settings = (max_hulls, MAX_VERTICES, _THRESHOLD, _HULL_TOLERANCE, _SIMPLIFICATION, _SEARCH, release)
    described = json.dumps([file.header["geometry"], file.scale, settings], sort_keys=True)
    digest = hashlib.sha256(described.encode())
    digest.update(np.ascontiguousarray(file.tensors["geometry.distances"]).tobytes())
    return digest.hexdigest()
