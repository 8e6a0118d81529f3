"""Light that bounces between the diffuse parts of a surface (Goral et al. 1984), gathered with rays."""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import torch
from scipy.spatial import cKDTree

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.vision.trace import SurfaceSamples, is_lit, weighted_rows

PATCHES = 8192
SIDE = 9  # of the square of rays that each patch sends over its hemisphere
BOUNCES = 2  # later ones are fainter than what the patches get wrong
NEIGHBOURS = 4  # patches that the light at a vertex is interpolated from
START = 0.3  # voxels along the normal where rays start
TURN = 0.1  # distance in the unit frame that counts like a normal turned by one radian


class Radiosity:
    """Diffuse interreflection of a stored surface under any point light.

    Random points of the surface, the patches, stand for it. Rays that leave a patch with the density of
    Lambert's cosine find how much it sees of each other one. That is done once; under a light, a shadow ray
    of each patch and one sparse product for each bounce remain.

    Parameters
    ----------
    surface : Isosurface
    reflectance : callable
        Points and unit normals (P, 3), float32 tensors in the unit frame, -> diffuse reflectance (P, 3),
        linear.
    """

    def __init__(
        self, surface: Isosurface, reflectance: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
    ):
        rng = np.random.default_rng(0)
        self._surface = surface
        self._points = sample_surface(surface.vertices, surface.faces, PATCHES, rng).astype(np.float32)
        normals = surface.grid.normals(torch.from_numpy(self._points))
        self._normals = normals.numpy()
        self._reflectance = reflectance(torch.from_numpy(self._points), normals).numpy()
        tree = cKDTree(_oriented(self._points, self._normals))
        self._seen = self._form_factors(tree, rng)
        distance, index = tree.query(_oriented(surface.vertices, surface.normals), k=NEIGHBOURS)
        weights = 1 / (distance**2 + 1e-6)
        self._patches = torch.from_numpy(index)
        self._weights = torch.from_numpy((weights / weights.sum(1, keepdims=True)).astype(np.float32))

    def around(
        self, samples: SurfaceSamples, normals: torch.Tensor, light: np.ndarray
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Diffuse light that samples receive from the rest of the surface, in units of radiance.

        Parameters
        ----------
        samples : SurfaceSamples
        normals : (S, 3) float32 tensor
            Unit shading normals.
        light : (3,) array
            A point light, unit frame; it gives a white surface at distance 1 radiance 1.

        Returns
        -------
        gathered : (S, 3) float32 tensor
            What a white Lambertian surface would reflect of it.
        mirrored : (S, 3) float32 tensor
            What a mirror would show, 0 where it shows nothing.
        """
        gathered, outgoing = self._solve(light)
        view = samples.directions
        away = view - 2 * (view * normals).sum(1, keepdim=True) * normals
        starts = samples.points + START * self._surface.grid.spacing * samples.normals
        ray, _, face, weights = self._surface.caster.intersect(starts.numpy(), away.numpy())
        corners = torch.from_numpy(self._surface.faces[face])
        mirrored = torch.zeros_like(view)
        mirrored[torch.from_numpy(ray)] = self._at(outgoing, corners, torch.from_numpy(weights))
        return self._at(gathered, samples.corners, samples.weights), mirrored

    def _solve(self, light: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance that each patch would reflect of the others' if it were white, and gives off; (P, 3)."""
        lit = np.flatnonzero(is_lit(self._surface, torch.from_numpy(self._points), torch.from_numpy(self._normals), torch.from_numpy(np.asarray(light,np.float32))).numpy())
        to_light = np.asarray(light, np.float32) - self._points[lit]
        distance = np.linalg.norm(to_light, axis=1)
        received = np.zeros((PATCHES, 1), np.float32)
        received[lit, 0] = (to_light * self._normals[lit]).sum(1) / distance**3
        gathered = np.zeros((PATCHES, 3), np.float32)
        for _ in range(BOUNCES):
            gathered = self._seen @ (self._reflectance * (received + gathered))
        return torch.from_numpy(gathered), torch.from_numpy(self._reflectance * (received + gathered))

    def _at(self, values: torch.Tensor, corners: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Values (P, C) of patches within triangles, as at the nearest corner; (S, C)."""
        vertex = corners.gather(1, weights.argmax(1, keepdim=True))[:, 0]
        return weighted_rows(values, self._patches[vertex], self._weights[vertex])

    def _form_factors(self, tree: cKDTree, rng: np.random.Generator) -> sp.csr_matrix:
        """Share of each patch's view that each other one fills; (P, P) float32."""
        starts = self._points + np.float32(START * self._surface.grid.spacing) * self._normals
        starts, directions = np.repeat(starts, SIDE**2, axis=0), _hemispheres(self._normals, rng)
        ray, distance, face, weights = self._surface.caster.intersect(starts, directions)
        hits = starts[ray] + directions[ray] * distance[:, None]
        corners = torch.from_numpy(self._surface.faces[face])
        normals = weighted_rows(torch.from_numpy(self._surface.normals), corners, torch.from_numpy(weights))
        met = tree.query(_oriented(hits, normals.numpy()))[1]
        share = np.full(len(ray), 1 / SIDE**2, np.float32)
        return sp.csr_matrix((share, (ray // SIDE**2, met)), shape=(PATCHES, PATCHES))


def _oriented(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Points with normals; (N, 6), to find near ones that face the same way."""
    return np.concatenate([points, TURN * normals], 1)


def _hemispheres(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Stratified directions about each normal with the density of Lambert's cosine; (P * SIDE^2, 3)."""
    row, column = np.mgrid[:SIDE, :SIDE].reshape(2, -1)
    jitter = rng.random((2, len(normals), SIDE**2), np.float32)
    square, azimuth = (row + jitter[0]) / SIDE, 2 * np.pi * (column + jitter[1]) / SIDE
    radius = np.sqrt(square)
    # Duff et al. 2017: an orthonormal basis without a special case at the poles.
    x, y, z = normals.T[:, :, None]
    sign = np.copysign(np.float32(1), z)
    a, b = -1 / (sign + z), -x * y / (sign + z)
    axes = (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1),
        np.stack([b, sign + y * y * a, -y], -1),
        normals[:, None],
    )
    local = radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)
    return sum(c[..., None] * axis for c, axis in zip(local, axes)).reshape(-1, 3).astype(np.float32)
