"""Light that bounces between the diffuse parts of a surface (Goral et al. 1984), gathered with rays."""

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch

from objectfolder.mesh.grid import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.vision.trace import SurfaceSamples, is_lit, weighted_rows
from objectfolder.vision.vectors import columns, select

if TYPE_CHECKING:
    import scipy.sparse as sp
    from scipy.spatial import cKDTree

PATCHES = 8192
SIDE = 9  # of the square of rays that each patch sends over its hemisphere
BOUNCES = 2  # later ones are fainter than what the patches get wrong
NEIGHBOURS = 4  # patches that the light at a vertex is interpolated from
START = 0.3  # voxels along the normal where rays start
BLOCKS = 16  # along a side of the cube, in whose order the patches are kept
SOLVED = 8  # lights whose solution is kept
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
        from scipy.spatial import cKDTree

        rng = np.random.default_rng(0)
        points = sample_surface(surface.vertices, surface.faces, PATCHES, rng).astype(np.float32)
        normals = surface.grid.normals(torch.from_numpy(points)).numpy()
        directions = _hemispheres(normals, rng)
        # Rays of near patches, one after the other, meet the same triangles.
        order = _blockwise(points)
        points, normals, directions = points[order], normals[order], directions[order]
        self._surface = surface
        self._reflectance = reflectance(*map(torch.from_numpy, (points, normals))).numpy().T.copy()
        tree = cKDTree(_oriented(points, normals))
        distance, index = tree.query(_oriented(surface.vertices, surface.normals), k=NEIGHBOURS)
        weights = 1 / (distance**2 + 1e-6)
        self._patches = torch.from_numpy(index.astype(np.int32))
        self._weights = torch.from_numpy((weights / weights.sum(1, keepdims=True)).astype(np.float32))
        self._seen = self._form_factors(tree, points, normals, directions)
        self._points, self._normals = (columns(torch.from_numpy(v)) for v in (points, normals))
        self._solution = lru_cache(SOLVED)(self._solve)

    def around(
        self, samples: SurfaceSamples, away: torch.Tensor, light: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Diffuse light that samples receive from the rest of the surface, in units of radiance.

        Parameters
        ----------
        samples : SurfaceSamples
        away : (S, 3) float32 tensor
            Where a mirror would look.
        light : (3,) float32 tensor
            A point light, unit frame; it gives a white surface at distance 1 radiance 1.

        Returns
        -------
        gathered : (S, 3) float32 tensor
            What a white Lambertian surface would reflect of it.
        mirrored : (S, 3) float32 tensor
            What a mirror would show, 0 where it shows nothing.
        """
        device, samples = away.device, samples.to("cpu")
        gathered, outgoing = self._solution(tuple(light.tolist()))
        starts = samples.points + START * self._surface.grid.spacing * samples.normals
        ray, _, face, weights = self._surface.caster.intersect(starts.numpy(), away.cpu().numpy())
        mirrored = torch.zeros(3, len(starts))
        shown = self._at(
            outgoing, torch.from_numpy(self._surface.faces.take(face, 0)), torch.from_numpy(weights)
        )
        mirrored.index_copy_(1, torch.from_numpy(ray), shown.mT)
        return self._at(gathered, samples.corners, samples.weights).to(device), mirrored.mT.to(device)

    def _solve(self, light: tuple[float, float, float]) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance that each patch would reflect of the others' if it were white, and gives off; (P, 3)."""
        where = torch.tensor(light)
        lit = is_lit(self._surface, self._points, self._normals, where).nonzero()[:, 0]
        to_light = where - select(self._points, lit)
        cosine = (to_light * select(self._normals, lit)).sum(1)
        received = np.zeros(PATCHES, np.float32)
        received[lit.numpy()] = (cosine / to_light.square().sum(1) ** 1.5).numpy()
        # One colour after the other: the sparse product of three at once takes twice as long.
        gathered = np.zeros((3, PATCHES), np.float32)
        for _ in range(BOUNCES):
            gathered = np.stack([self._seen @ c for c in self._reflectance * (received + gathered)])
        given_off = self._reflectance * (received + gathered)
        return torch.from_numpy(gathered.T.copy()), torch.from_numpy(given_off.T.copy())

    def _at(self, values: torch.Tensor, corners: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Values (P, C) of patches within triangles, as at the nearest corner; (S, C)."""
        vertex = corners.gather(1, weights.argmax(1, keepdim=True))[:, 0]
        rows = (table.index_select(0, vertex) for table in (self._patches, self._weights))
        return columns(weighted_rows(values, *rows))

    def _form_factors(
        self, tree: "cKDTree", points: np.ndarray, normals: np.ndarray, directions: np.ndarray
    ) -> "sp.csr_matrix":
        """Share of each patch's view that each other one fills; (P, P) float32."""
        import scipy.sparse as sp

        starts = points + np.float32(START * self._surface.grid.spacing) * normals
        starts, directions = np.repeat(starts, SIDE**2, axis=0), directions.reshape(-1, 3)
        ray, distance, face, weights = self._surface.caster.intersect(starts, directions)
        hits = starts.take(ray, 0) + directions.take(ray, 0) * distance[:, None]
        corners = torch.from_numpy(self._surface.faces.take(face, 0))
        met = weighted_rows(torch.from_numpy(self._surface.normals), corners, torch.from_numpy(weights))
        patch = tree.query(_oriented(hits, met.numpy()))[1]
        share = np.full(len(ray), 1 / SIDE**2, np.float32)
        return sp.csr_matrix((share, (ray // SIDE**2, patch)), shape=(PATCHES, PATCHES))


def _blockwise(points: np.ndarray) -> np.ndarray:
    """Order of points (P, 3) in which near ones follow each other."""
    block = ((points + BOUND) * (BLOCKS / (2 * BOUND))).astype(int).clip(0, BLOCKS - 1)
    return np.ravel_multi_index(tuple(block.T), (BLOCKS,) * 3).argsort(kind="stable")


def _oriented(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Points with normals; (N, 6), to find near ones that face the same way."""
    return np.concatenate([points, TURN * normals], 1)


def _hemispheres(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Stratified directions about each normal with the density of Lambert's cosine; (P, SIDE^2, 3)."""
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
    return sum(c[..., None] * axis for c, axis in zip(local, axes)).astype(np.float32)
