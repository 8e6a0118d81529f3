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
        triangles = np.ascontiguousarray(np.asarray(vertices, np.float32)[faces])
        # The Python object owns the buffers that Embree reads: keep it.
        self._mesh = TriangleMesh(self._scene, triangles)

    def first_hit(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the first triangle along each ray.

        Parameters
        ----------
        origins, directions : (N, 3) arrays
        max_distance : (N,) array, optional
            Rays end here; a short ray is a cheap ray.

        Returns
        -------
        distance : (N,) float32, ``inf`` where nothing is hit
        face : (N,) int64, -1 where nothing is hit
        """
        hit = self._scene.run(
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            dists=_lengths(max_distance),
            query="INTERSECT",
            output=1,
        )
        face = hit["primID"].astype(np.int64)
        # Embree reports 1e37 on a miss.
        return np.where(face >= 0, hit["tfar"], np.float32(np.inf)).astype(np.float32), face

    def intersect(
        self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where rays first meet a triangle; H of N rays do.

        Parameters
        ----------
        origins, directions : (N, 3) arrays
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
        hit = self._scene.run(
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            dists=_lengths(max_distance),
            query="INTERSECT",
            output=1,
        )
        ray = np.flatnonzero(hit["primID"] >= 0)
        u, v = hit["u"][ray], hit["v"][ray]
        weights = np.stack([1 - u - v, u, v], 1).astype(np.float32)
        return ray, hit["tfar"][ray].astype(np.float32), hit["primID"][ray].astype(np.int64), weights

    def first_crossing(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the first triangle along each ray, and from which side the ray meets it.

        Parameters
        ----------
        origins, directions : (N, 3) arrays

        Returns
        -------
        distance : (N,) float32, ``inf`` where nothing is hit
        leaving : (N,) bool
            The triangle's corners run clockwise as the ray sees them: of a closed surface, it comes from
            within.
        """
        directions = np.ascontiguousarray(directions, np.float32)
        hit = self._scene.run(
            np.ascontiguousarray(origins, np.float32), directions, query="INTERSECT", output=1
        )
        met = hit["primID"] >= 0
        leaving = met & (np.einsum("ni,ni->n", hit["Ng"], directions) > 0)
        return np.where(met, hit["tfar"], np.float32(np.inf)), leaving

    def occluded(self, origins: np.ndarray, directions: np.ndarray, max_distance: np.ndarray) -> np.ndarray:
        """Whether anything lies within ``max_distance`` along each ray; (N,) bool."""
        _, face = self.first_hit(origins, directions, max_distance)
        return face >= 0


def _lengths(max_distance: np.ndarray | None) -> np.ndarray | None:
    """A copy, because Embree's wrapper writes the distances it finds into it."""
    return None if max_distance is None else np.array(max_distance, np.float32)
