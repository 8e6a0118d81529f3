"""Ray casting against triangles, with Embree."""

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh


class RayCaster:
    """Triangles in an Embree scene.

    Works in whatever frame the vertices are in; distances are in the units of that frame, times the
    length of the ray direction.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self._scene = rtcore_scene.EmbreeScene()
        # The Python object owns the buffers that Embree reads: keep it.
        self._mesh = TriangleMesh(self._scene, np.asarray(vertices, np.float32), np.asarray(faces))

    def first_hit(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the first triangle along each ray.

        Parameters
        ----------
        origins : (N, 3) or (3,) array
        directions : (N, 3) array
        max_distance : (N,) array, optional
            Rays end here; a short ray is a cheap ray.

        Returns
        -------
        distance : (N,) float32, ``inf`` where nothing is hit
        face : (N,) int64, -1 where nothing is hit
        """
        hit = self._run(origins, directions, max_distance)
        face = hit["primID"].astype(np.int64)
        # Embree reports 1e37 on a miss.
        return np.where(face >= 0, hit["tfar"], np.float32(np.inf)).astype(np.float32), face

    def intersect(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where rays first meet a triangle; H of N rays do.

        Parameters
        ----------
        origins : (N, 3) or (3,) array
        directions : (N, 3) array
        max_distance : (N,) array, optional
            Rays end here.

        Returns
        -------
        ray : (H,) int64
        distance : (H,) float32
        face : (H,) int64
        weights : (H, 3) float32
            Barycentric, of the face's corners.
        """
        hit = self._run(origins, directions, max_distance)
        ray = np.flatnonzero(hit["primID"] >= 0)
        u, v, distance, face = (hit[name].take(ray) for name in ("u", "v", "tfar", "primID"))
        return ray, distance, face.astype(np.int64), np.stack([1 - u - v, u, v], 1)

    def first_crossing(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the first triangle along each ray, and from which side the ray meets it.

        Parameters
        ----------
        origins : (N, 3) or (3,) array
        directions : (N, 3) array

        Returns
        -------
        distance : (N,) float32, ``inf`` where nothing is hit
        leaving : (N,) bool
            The triangle's corners run clockwise as the ray sees them: of a closed surface, it comes from
            within.
        """
        hit = self._run(origins, directions)
        met = hit["primID"] >= 0
        leaving = met & (np.einsum("ni,ni->n", hit["Ng"], directions) > 0)
        return np.where(met, hit["tfar"], np.float32(np.inf)), leaving

    def occluded(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> np.ndarray:
        """Whether anything lies along each ray, within ``max_distance`` if given; (N,) bool."""
        rays = _rays(origins, directions)
        return self._scene.run(*rays, dists=_lengths(max_distance), query="OCCLUDED") >= 0

    def _run(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        rays = _rays(origins, directions)
        return self._scene.run(*rays, dists=_lengths(max_distance), query="INTERSECT", output=1)


def _lengths(max_distance: np.ndarray | None) -> np.ndarray | None:
    """A copy, because Embree's wrapper writes the distances it finds into it."""
    return None if max_distance is None else np.array(max_distance, np.float32)


def _rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions in single precision, of any strides; Embree's wrapper wants to write to them."""
    origins, directions = (np.require(v, np.float32, "W") for v in (origins, directions))
    if origins.ndim == 1:
        strides = 0, origins.strides[0]
        origins = np.lib.stride_tricks.as_strided(origins, directions.shape, strides)
    return origins, directions
