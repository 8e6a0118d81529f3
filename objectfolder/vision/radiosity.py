"""Radiosity: diffuse interreflection of a surface (Goral et al. 1984), with form factors by ray casting."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from objectfolder.base.recent import Recent
from objectfolder.mesh.gridcodec import BOUND
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.vision.lighting import toward
from objectfolder.vision.trace import SurfaceSamples, is_lit, nearest_corners, weighted_rows
from objectfolder.vision.vectors import column_major, dot, take_rows

if TYPE_CHECKING:
    import scipy.sparse as sp
    from scipy.spatial import cKDTree

PATCHES = 8192
SIDE = 9  # each patch casts SIDE x SIDE rays over its hemisphere
BOUNCES = 2  # later ones are fainter than the error of the patches
NEIGHBOURS = 4  # patches from which the light at a vertex is interpolated
START = 0.3  # voxels along the normal where rays start
BLOCKS = 16  # along a side of the cube; patches are sorted by block
CACHED_LIGHTS = 64  # lights whose solution is cached
TURN = 0.1  # distance in the unit frame equivalent to one radian between normals


class Radiosity:
    """Diffuse interreflection of a stored surface under any light.

    The surface is represented by random points, the patches. Form factors between patches are estimated once,
    by cosine-weighted rays from each patch. A light then costs one shadow ray per patch and one sparse
    product per bounce. Points and unit normals (P, 3), float32 tensors in the unit frame, have the diffuse
    reflectance (P, 3), linear.
    """

    def __init__(self, surface: Isosurface, reflectance: Callable[[Tensor, Tensor], Tensor]):
        from scipy.spatial import cKDTree

        rng = np.random.default_rng(0)
        points = sample_surface(surface.vertices, surface.faces, PATCHES, rng).astype(np.float32)
        normals = surface.grid.normals(torch.from_numpy(points)).numpy()
        directions = _hemispheres(normals, rng)
        # Sorted, so that consecutive rays hit the same triangles.
        order = _blockwise(points)
        points, normals, directions = points[order], normals[order], directions[order]
        self._surface = surface
        self._reflectance = reflectance(*map(torch.from_numpy, (points, normals))).numpy().T.copy()
        tree, shading = cKDTree(_oriented(points, normals)), surface.shading
        distance, index = tree.query(_oriented(shading.vertices, shading.normals), k=NEIGHBOURS)
        weights = 1 / (distance**2 + 1e-6)
        self._patches = torch.from_numpy(index.astype(np.int32))
        self._weights = torch.from_numpy((weights / weights.sum(1, keepdims=True)).astype(np.float32))
        self._seen = self._form_factors(tree, points, normals, directions)
        sees = np.diff(self._seen.indptr) > 0
        self._sees = torch.from_numpy(sees[index].any(1))
        # The light on all others reaches no patch: most of a convex object.
        self._involved = np.flatnonzero(sees | (np.bincount(self._seen.indices, minlength=PATCHES) > 0))
        involved = (torch.from_numpy(v[self._involved]) for v in (points, normals))
        self._points, self._normals = map(column_major, involved)
        self._solved: Recent[tuple[Tensor, Tensor]] = Recent(CACHED_LIGHTS)

    def gather(self, samples: SurfaceSamples, light: Tensor) -> Tensor:
        """Return the diffuse light of the surface that a white Lambertian one reflects at samples; (S, 3).

        Float32 radiance on the device of the light, see `objectfolder.vision.lighting.toward`: a white
        surface that faces it at distance 1, or at any, has a radiance of 1.
        """
        gathered, _ = self._under(light)
        return self._at(gathered, samples.nearest_corner.cpu()).to(light.device)

    def mirror(self, samples: SurfaceSamples, normals: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
        """Return the diffuse light of the surface that a mirror with normals (S, 3) reflects at samples.

        The indices (K,) of samples whose mirrored rays hit the surface, and the radiance (K, 3) that these
        see, on the device of the samples. No rays are cast from where no patch sees the surface, as on a
        convex object.
        """
        _, outgoing = self._under(light)
        some = self._sees.index_select(0, samples.nearest_corner.cpu()).nonzero()[:, 0]
        of_samples = samples.points, samples.normals, normals, samples.directions
        points, outward, mirror, view = (take_rows(v.detach().cpu(), some) for v in of_samples)
        starts = points + START * self._surface.grid.spacing * outward
        away = view - 2 * dot(mirror, view) * mirror
        ray, _, face, weights = self._surface.caster.intersect(starts.numpy(), away.numpy())
        corners = torch.from_numpy(self._surface.corners(face))
        shown = self._at(outgoing, nearest_corners(corners, torch.from_numpy(weights)))
        return some[torch.from_numpy(ray)].to(normals.device), shown.to(normals.device)

    def _under(self, light: Tensor) -> tuple[Tensor, Tensor]:
        """Return light gathered by each patch, as if it were white, and its radiosity; (P, 3) each."""
        if light.requires_grad or light.dtype == torch.float64:
            return self._solve(light)
        lamp = tuple(light.tolist())
        return self._solved.of(lamp, lambda: self._solve_to_keep(lamp))

    @torch.inference_mode(False)  # what is kept may serve a gradient later
    @torch.no_grad()
    def _solve_to_keep(self, lamp: tuple[float, ...]) -> tuple[Tensor, Tensor]:
        return self._solve(lamp)

    def _solve(self, light: Tensor | tuple[float, ...]) -> tuple[Tensor, Tensor]:
        where = light if isinstance(light, Tensor) else torch.tensor(light, dtype=torch.float32)
        lit = is_lit(self._surface, self._points, self._normals, where.detach().float()).nonzero()[:, 0]
        to_light = toward(where, take_rows(self._points, lit))
        cosine = (to_light * take_rows(self._normals, lit)).sum(1).clamp(min=0)
        place = torch.from_numpy(self._involved).index_select(0, lit)
        falling = cosine / to_light.square().sum(1) ** 1.5
        received = falling.new_zeros(PATCHES).index_copy(0, place, falling)
        found: tuple[Tensor, Tensor] = Bounced.apply(received, self._seen, self._reflectance)
        return found

    def _at(self, values: Tensor, vertex: Tensor) -> Tensor:
        """Interpolate values (P, C) of patches at vertices (S,); (S, C)."""
        rows, weights = (table.index_select(0, vertex) for table in (self._patches, self._weights))
        return column_major(weighted_rows(values, rows, weights.to(values.dtype)))

    def _form_factors(
        self, tree: "cKDTree", points: np.ndarray, normals: np.ndarray, directions: np.ndarray
    ) -> "sp.csr_matrix":
        """Return the form factors between patches; (P, P) float32."""
        import scipy.sparse as sp

        starts = points + np.float32(START * self._surface.grid.spacing) * normals
        starts, directions = np.repeat(starts, SIDE**2, axis=0), directions.reshape(-1, 3)
        ray, distance, face, weights = self._surface.caster.intersect(starts, directions)
        hits = starts.take(ray, 0) + directions.take(ray, 0) * distance[:, None]
        corners = torch.from_numpy(self._surface.corners(face))
        met = weighted_rows(self._surface.shading.tensor, corners, torch.from_numpy(weights))
        patch = tree.query(_oriented(hits, met.numpy()))[1]
        share = np.full(len(ray), 1 / SIDE**2, np.float32)
        return sp.csr_matrix((share, (ray // SIDE**2, patch)), shape=(PATCHES, PATCHES))


class Bounced(torch.autograd.Function):
    """Light that patches gather and give off, linear in the light that they receive from outside."""

    @staticmethod
    def forward(
        ctx: Any, received: Tensor, seen: "sp.csr_matrix", reflectance: np.ndarray
    ) -> tuple[Tensor, Tensor]:
        """Return what patches gather, as if they were white, and give off; (P, 3) each.

        Of received light (P,), form factors (P, P) and reflectance (3, P).
        """
        ctx.patches = seen, reflectance
        direct = received.numpy()
        # One colour at a time: a sparse product of three takes twice as long.
        gathered = np.zeros((3, len(direct)), direct.dtype)
        for _ in range(BOUNCES):
            gathered = np.stack([seen @ c for c in reflectance * (direct + gathered)])
        given_off = reflectance * (direct + gathered)
        return torch.from_numpy(gathered.T.copy()), torch.from_numpy(given_off.T.copy())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor, None, None]:
        """Return the gradient of the received light, by the transposed bounces in reverse order."""
        seen, reflectance = ctx.patches
        of_gathered, of_given = (g.numpy().T for g in gradients)
        of_direct = reflectance * of_given
        of_gathered = of_gathered + of_direct
        for _ in range(BOUNCES):
            of_gathered = reflectance * np.stack([seen.T @ c for c in of_gathered])
            of_direct = of_direct + of_gathered
        return torch.from_numpy(of_direct.sum(0)).to(gradients[0].dtype), None, None


def _blockwise(points: np.ndarray) -> np.ndarray:
    """Return an order of points (P, 3) that keeps near ones together."""
    block = ((points + BOUND) * (BLOCKS / (2 * BOUND))).astype(int).clip(0, BLOCKS - 1)
    return np.ravel_multi_index(tuple(block.T), (BLOCKS,) * 3).argsort(kind="stable")


def _oriented(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Join points and scaled normals, (N, 6), to search for near points that face the same way."""
    return np.concatenate([points, TURN * normals], 1)


def _hemispheres(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return stratified cosine-weighted directions about each normal; (P, SIDE^2, 3)."""
    row, column = np.mgrid[:SIDE, :SIDE].reshape(2, -1)
    jitter = rng.random((2, len(normals), SIDE**2), np.float32)
    square, azimuth = (row + jitter[0]) / SIDE, 2 * np.pi * (column + jitter[1]) / SIDE
    radius = np.sqrt(square)
    # Duff et al. 2017: an orthonormal basis without a special case at the poles.
    x, y, z = normals.T[:, :, None]
    sign = np.copysign(np.float32(1), z)
    a, b = -1 / (sign + z), -x * y / (sign + z)
    across = np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    axes = across, np.stack([b, sign + y * y * a, -y], -1), normals[:, None]
    local = radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)
    return sum(c[..., None] * axis for c, axis in zip(local, axes)).astype(np.float32)
