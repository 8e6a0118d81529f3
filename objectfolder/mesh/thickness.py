"""Wall thickness of a solid."""

import numpy as np

from objectfolder.mesh.normals import area_vectors
from objectfolder.mesh.raycast import RayCaster

THIN_SHARE = 0.1  # quantile: thin parts with less surface than this do not count
_RAYS = 4096
_OFFSET = 1e-5  # start of the rays below the surface


def wall_thickness(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Estimate the thickness, measured along inward normals, below which a tenth of the surface falls.

    Parameters
    ----------
    vertices : (V, 3) array
    faces : (F, 3) int array
        Closed, outward.
    """
    caster, rng = RayCaster(vertices, faces), np.random.default_rng(0)
    vertices = np.asarray(vertices, np.float64)
    normal = area_vectors(vertices, faces)
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(faces), _RAYS, p=area / area.sum())
    share = rng.dirichlet(np.ones(3), _RAYS)
    inward = -normal[face] / area[face, None]
    points = np.einsum("pi,pid->pd", share, vertices[faces[face]])
    distance, _ = caster.first_hit(points + _OFFSET * inward, inward)
    return float(np.quantile(distance, THIN_SHARE))
