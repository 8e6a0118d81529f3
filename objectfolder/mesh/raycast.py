"""Ray casting against triangles with Embree, and wall thickness by rays."""

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from objectfolder.mesh.normals import area_vectors

THIN_SHARE = 0.1  # quantile: thin parts with less surface than this do not count
_RAYS = 4096
_OFFSET = 1e-5  # start of the rays below the surface


class RayCaster:
    """Triangles in an Embree scene.

    Works in the frame of the vertices; distances are in multiples of the length of the ray direction.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self._scene = rtcore_scene.EmbreeScene()
        # Keeps the buffers that Embree reads alive.
        self._mesh = TriangleMesh(self._scene, np.asarray(vertices, np.float32), np.asarray(faces))

    def first_hit(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the first triangle along each ray, from origins (N, 3) or (3,).

        ``max_distance`` (N,) is the length of the rays; short rays are cheaper. Returns distances, (N,)
        float32, ``inf`` where nothing is hit, and faces, (N,) int64, -1 there.
        """
        hit = self._run(origins, directions, max_distance)
        face = hit["primID"].astype(np.int64)
        # Embree reports 1e37 on a miss.
        return np.where(face >= 0, hit["tfar"], np.float32(np.inf)).astype(np.float32), face

    def depths(self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray) -> np.ndarray:
        """Return `first_hit`'s distances alone, faster; (N,) float32, ``inf`` where nothing is hit."""
        distance = self._scene.run(
            *_rays(origins, directions), dists=_lengths(max_distance), query="DISTANCE"
        )
        distance[distance >= max_distance] = np.inf
        return distance

    def intersect(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Find the first hits of N rays as `first_hit`, of which H hit a triangle.

        Returns rays, (H,) int64; distances, (H,) float32; faces, (H,) int32; and barycentric weights of the
        faces' corners, (H, 3) float32.
        """
        hit = self._run(origins, directions, max_distance)
        ray = np.flatnonzero(hit["primID"] >= 0)
        u, v, distance, face = (hit[name].take(ray) for name in ("u", "v", "tfar", "primID"))
        return ray, distance, face, np.stack([1 - u - v, u, v], 1)

    def first_crossing(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the first triangle along each ray and the side from which the ray hits it.

        Returns distances, (N,) float32, ``inf`` where nothing is hit; and whether the ray hits the triangle
        from behind, on a closed surface from inside, (N,) bool.
        """
        hit = self._run(origins, directions)
        met = hit["primID"] >= 0
        leaving = met & (np.einsum("ni,ni->n", hit["Ng"], directions) > 0)
        return np.where(met, hit["tfar"], np.float32(np.inf)), leaving

    def occluded(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> np.ndarray:
        """Test whether each ray hits anything, within ``max_distance`` if given; (N,) bool."""
        rays = _rays(origins, directions)
        return self._scene.run(*rays, dists=_lengths(max_distance), query="OCCLUDED") >= 0

    def _run(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        rays = _rays(origins, directions)
        return self._scene.run(*rays, dists=_lengths(max_distance), query="INTERSECT", output=1)


def wall_thickness(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Estimate the thickness, measured along inward normals, below which a tenth of the surface falls.

    The faces are closed and show outward.
    """
    return float(np.quantile(cross_walls(vertices, faces)[1], THIN_SHARE))


def cross_walls(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cast rays inward from random points of a closed surface, along its normals.

    Returns the middles of their ways through the solid, (N, 3), and the lengths of these ways, (N,) float32.
    """
    caster, rng = RayCaster(vertices, faces), np.random.default_rng(0)
    vertices = np.asarray(vertices, np.float64)
    normal = area_vectors(vertices, faces)
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(faces), _RAYS, p=area / area.sum())
    share = rng.dirichlet(np.ones(3), _RAYS)
    inward = -normal[face] / area[face, None]
    points = np.einsum("pi,pid->pd", share, vertices[faces[face]])
    length, _ = caster.first_hit(points + _OFFSET * inward, inward)
    return points + length[:, None] / 2 * inward, length


def _lengths(max_distance: np.ndarray | None) -> np.ndarray | None:
    """Copy the distances: Embree's wrapper writes its results into them."""
    return None if max_distance is None else np.array(max_distance, np.float32)


def _rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Convert origins and directions to writable float32, as Embree's wrapper requires."""
    origins, directions = (np.require(v, np.float32, "W") for v in (origins, directions))
    if origins.ndim == 1:
        strides = 0, origins.strides[0]
        origins = np.lib.stride_tricks.as_strided(origins, directions.shape, strides)
    return origins, directions
